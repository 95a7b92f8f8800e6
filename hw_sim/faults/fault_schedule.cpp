#include "hw_sim/faults/fault_schedule.h"

#include <algorithm>

namespace hw_sim {
namespace {

// SplitMix64: a good draw from a counter, the same everywhere.
std::uint64_t mix(std::uint64_t value) {
  value += 0x9e3779b97f4a7c15;
  value = (value ^ (value >> 30)) * 0xbf58476d1ce4e5b9;
  value = (value ^ (value >> 27)) * 0x94d049bb133111eb;
  return value ^ (value >> 31);
}

constexpr int kClosed = kIdle - 1;

std::string describe(FaultKind kind, FaultPlace place) {
  std::string text(to_string(kind));
  if (place.showing <= kIdle) return text + " at rest";
  if (place.showing == kPrimingShowing)
    text += " at the priming";
  else
    text.append(" at slot ").append(std::to_string(place.showing - showing_of_slot(0)));
  if (site_of(kind) == FaultSite::kShot)
    text.append(", bracket ").append(std::to_string(place.bracket));
  return text;
}

bool is_reached(FaultPlace planned, FaultPlace present) {
  return present.showing > planned.showing ||
         (present.showing == planned.showing && present.bracket >= planned.bracket);
}

double to_frac(std::uint64_t draw) { return static_cast<double>(draw >> 11) * 0x1p-53; }

}  // namespace

FaultSchedule::FaultSchedule(const FaultPlan& plan) : seed_(plan.seed), place_{kClosed, 0} {
  for (const PlannedFault& fault : plan.faults) entries_.push_back({fault, 0, 0});
}

void FaultSchedule::opened() {
  const std::lock_guard lock(mutex_);
  if (place_.showing == kClosed) place_.showing = kIdle;
  note_progress();
}

void FaultSchedule::set_flips_per_showing(int flip_count) {
  const std::lock_guard lock(mutex_);
  flips_per_showing_ = flip_count;
}

FaultPlace FaultSchedule::next_flip() const {
  if (is_train_started_ && place_.bracket + 1 < flips_per_showing_)
    return {place_.showing, place_.bracket + 1};
  return {place_.showing + 1, 0};
}

void FaultSchedule::armed() {
  const std::lock_guard lock(mutex_);
  is_train_started_ = false;
  is_armed_ = true;
  place_.showing = std::max(place_.showing, kIdle);
  note_progress();
}

void FaultSchedule::disarmed() {
  const std::lock_guard lock(mutex_);
  is_armed_ = false;
  note_progress();
}

void FaultSchedule::train_started() {
  const std::lock_guard lock(mutex_);
  place_ = {place_.showing + 1, 0};
  is_train_started_ = true;
  note_progress();
}

void FaultSchedule::pulse_started(int bracket) {
  const std::lock_guard lock(mutex_);
  place_.bracket = bracket;
}

void FaultSchedule::note_progress() {
  ++progress_count_;
  progressed_.notify_all();
}

bool FaultSchedule::is_armed() const {
  const std::lock_guard lock(mutex_);
  return is_armed_;
}

int FaultSchedule::showing() const {
  const std::lock_guard lock(mutex_);
  return place_.showing;
}

void FaultSchedule::wait_for_progress(std::chrono::steady_clock::time_point deadline,
                                      const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  progressed_.wait_until(lock, stop, deadline,
                         [this] { return progress_count_ != seen_progress_; });
  seen_progress_ = progress_count_;
}

std::uint64_t FaultSchedule::draw(std::size_t entry, std::uint64_t occasion) const {
  return mix(mix(mix(seed_) ^ entry) ^ occasion);
}

std::optional<PlannedFault> FaultSchedule::take_at(FaultKind kind, FaultPlace place) {
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    Entry& entry = entries_[i];
    if (entry.fault.kind != kind || entry.taken_count >= entry.fault.count) continue;
    const bool is_due = entry.fault.place
                            ? is_reached(*entry.fault.place, place)
                            : to_frac(draw(i, entry.occasion_count++)) < entry.fault.rate_frac;
    if (!is_due) continue;
    ++entry.taken_count;
    happened_.push_back(describe(kind, place));
    return entry.fault;
  }
  return std::nullopt;
}

std::optional<PlannedFault> FaultSchedule::take(FaultKind kind) {
  const std::lock_guard lock(mutex_);
  return take_at(kind, place_);
}

bool FaultSchedule::take_skipped_blank() {
  const std::lock_guard lock(mutex_);
  return is_armed_ && take_at(FaultKind::kVblankSkipped, next_flip()).has_value();
}

std::vector<std::string> FaultSchedule::happened() const {
  const std::lock_guard lock(mutex_);
  return happened_;
}

std::vector<std::string> FaultSchedule::outstanding() const {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> names;
  for (const Entry& entry : entries_)
    if (entry.fault.place && entry.taken_count < entry.fault.count)
      names.emplace_back(to_string(entry.fault.kind));
  return names;
}

ShotFaults FaultSchedule::take_shot() {
  const std::lock_guard lock(mutex_);
  const auto take = [this](FaultKind kind) { return take_at(kind, place_); };
  ShotFaults shot;
  shot.loss_seed = mix(seed_ ^ mix(++shot_count_));
  shot.is_trigger_missed = take(FaultKind::kTriggerMissed).has_value();
  shot.is_trigger_doubled = take(FaultKind::kTriggerDoubled).has_value();
  shot.is_trigger_bounced = take(FaultKind::kTriggerBounced).has_value();
  shot.is_sequencer_slipping = take(FaultKind::kSequencerSlip).has_value();
  shot.is_exposure_stuck = take(FaultKind::kExposureStuck).has_value();
  if (const auto step = take(FaultKind::kClockStep)) shot.clock_step = step->duration;
  if (const auto loss = take(FaultKind::kPacketLoss)) shot.loss_frac = loss->loss_frac;
  shot.is_leader_lost = take(FaultKind::kLeaderLost).has_value();
  shot.is_trailer_lost = take(FaultKind::kTrailerLost).has_value();
  shot.is_lost = take(FaultKind::kFrameLost).has_value();
  shot.is_duplicated = take(FaultKind::kFrameDuplicated).has_value();
  shot.is_truncated = take(FaultKind::kFrameTruncated).has_value();
  if (const auto late = take(FaultKind::kFrameLate)) shot.delay = late->duration;
  return shot;
}

FlipFaults FaultSchedule::take_flip() {
  const std::lock_guard lock(mutex_);
  FlipFaults flip;
  if (!is_armed_) return flip;
  const auto take = [this](FaultKind kind) { return take_at(kind, next_flip()); };
  if (const auto late = take(FaultKind::kFlipLate)) flip.delay = late->duration;
  flip.is_edge_missed = take(FaultKind::kEdgeMissed).has_value();
  if (const auto slow = take(FaultKind::kPhotodiodeSlowFall)) flip.fall_time = slow->duration;
  return flip;
}

}  // namespace hw_sim
