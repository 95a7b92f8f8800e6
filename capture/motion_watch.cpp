#include "capture/motion_watch.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "estimation/base/check.h"

namespace capture {
namespace {

estimation::Axis axis_of(const estimation::PatternKind& kind) {
  if (const auto* stripes = std::get_if<estimation::Stripes>(&kind)) return stripes->axis;
  if (const auto* gray = std::get_if<estimation::GrayCode>(&kind)) return gray->axis;
  if (const auto* fringe = std::get_if<estimation::Fringe>(&kind)) return fringe->axis;
  return estimation::Axis::kColumn;
}

// In the projector's picture; 0: the pattern has none.
double period_px(const estimation::PatternKind& kind) {
  if (const auto* stripes = std::get_if<estimation::Stripes>(&kind)) return stripes->period_px;
  if (const auto* fringe = std::get_if<estimation::Fringe>(&kind)) return fringe->period_px;
  // A bit of Gray code is lit every other pair of runs.
  if (const auto* gray = std::get_if<estimation::GrayCode>(&kind))
    return std::ldexp(4.0, gray->bit);
  return 0;
}

const estimation::PatternKind& kind_of(const estimation::Manifest& manifest, int pattern) {
  const estimation::Pattern* repeated = manifest.find_pattern(pattern);
  estimation::check(repeated != nullptr, "the pattern that is repeated is none of the session's");
  return repeated->kind;
}

// Showings so close to each other are one, under both levels of the square.
constexpr std::chrono::seconds kTogether{2};

}  // namespace

MotionWatch::MotionWatch(const estimation::Manifest& manifest, int pattern,
                         std::vector<int> brackets, std::size_t frame_count)
    : camera_(manifest.camera),
      calibration_(manifest.calibration),
      axis_(axis_of(kind_of(manifest, pattern))),
      scale_(estimation::motion_scale(manifest.camera, manifest.calibration, axis_)),
      period_px_(period_px(kind_of(manifest, pattern)) / scale_.projector_px_per_px),
      patterns_(manifest.patterns),
      grid_(estimation::block_grid(camera_, axis_, period_px_)),
      brackets_(std::move(brackets)),
      queue_(frame_count),
      thread_([this] { run(); }) {}

MotionWatch::~MotionWatch() { queue_.close(); }

void MotionWatch::push(Use use, const CapturedFrame& frame) {
  last_arrival_ = std::max(last_arrival_.value_or(frame.frame->received), frame.frame->received);
  push(std::make_shared<const Item>(
      Item{use, frame.slot, frame.evidence.edge, frame.evidence.is_light, frame.frame, {}}));
}

void MotionWatch::push(SharedItem item) {
  {
    const std::lock_guard lock(mutex_);
    ++waiting_count_;
  }
  queue_.push(std::move(item));
}

void MotionWatch::add_first(const CapturedFrame& frame) { push(Use::kFirst, frame); }

void MotionWatch::add_any(const CapturedFrame& frame) { push(Use::kAny, frame); }

void MotionWatch::add_first(int bracket, rig::HostTime edge, estimation::Image<std::uint16_t> dn) {
  push(std::make_shared<const Item>(
      Item{Use::kFirst, {0, bracket}, edge, std::nullopt, nullptr, std::move(dn)}));
}

void MotionWatch::add_repeat(const CapturedFrame& frame) { push(Use::kRepeat, frame); }

void MotionWatch::forget_repeats(const std::vector<double>& edges_s) {
  wait_until_looked_at();
  changes_.clear();
  std::erase_if(repeats_, [&edges_s](const SharedItem& repeat) {
    const double edge_s = std::chrono::duration<double>(repeat->edge.time_since_epoch()).count();
    constexpr double kSameEdgeS = 1e-4;
    return std::any_of(edges_s.begin(), edges_s.end(), [edge_s](double wrong_s) {
      return std::abs(wrong_s - edge_s) < kSameEdgeS;
    });
  });
}

void MotionWatch::wait_until_looked_at() {
  std::unique_lock lock(mutex_);
  looked_at_.wait(lock, [this] { return waiting_count_ == 0; });
}

void MotionWatch::run() {
  while (auto item = queue_.pop()) {
    look_at(*item);
    item.reset();  // the buffer goes back to the camera
    {
      const std::lock_guard lock(mutex_);
      --waiting_count_;
    }
    looked_at_.notify_all();
  }
}

void MotionWatch::look_at(const SharedItem& item) {
  switch (item->use) {
    case Use::kAny:
      return keep_light(*item);
    case Use::kFirst:
      keep_first(item);
      break;
    case Use::kRepeat:
      if (bracket_ && item->slot.bracket != *bracket_) return;
      repeats_.insert(std::upper_bound(repeats_.begin(), repeats_.end(), item,
                                       [](const SharedItem& a, const SharedItem& b) {
                                         return a->edge < b->edge;
                                       }),
                      item);
      break;
  }
  tell_repeats();  // what is compared now need not be when the last frame has come
}

void MotionWatch::keep_light(const Item& item) {
  if (!first_seen_) first_seen_ = item.edge;
  const double elapsed_s = std::chrono::duration<double>(item.edge - *first_seen_).count();
  with_samples(item, [&](estimation::ImageView<const std::uint16_t> dn) {
    seen_.insert_or_assign({item.slot.pattern, item.slot.bracket},
                           estimation::SeenFrame{item.slot.pattern, item.slot.bracket, elapsed_s,
                                                 block_light(camera_, grid_, dn),
                                                 item.is_square_light.value_or(false)});
  });
}

template <typename Work>
void MotionWatch::with_samples(const Item& item, const Work& work) {
  if (!item.frame) return work(item.stored.view());
  const FrameSamples samples(*item.frame);
  work(samples.view());
}

bool MotionWatch::hardly_clips(const Item& item) const {
  if (!camera_.saturation_level_dn) return true;
  std::size_t clipped_count = 0, count = 0;
  with_samples(item, [&](estimation::ImageView<const std::uint16_t> dn) {
    for (int row = 0; row < dn.height_px; ++row) {
      for (const std::uint16_t sample : dn.row(row))
        if (sample >= *camera_.saturation_level_dn) ++clipped_count;
      count += dn.row(row).size();
    }
  });
  constexpr double kMostClippedFrac = 0.01;
  return static_cast<double>(clipped_count) <= kMostClippedFrac * static_cast<double>(count);
}

void MotionWatch::keep_first(const SharedItem& item) {
  const int bracket = item->slot.bracket;
  const bool is_watched =
      bracket_ ? bracket == *bracket_
               : std::find(brackets_.begin(), brackets_.end(), bracket) != brackets_.end();
  if (!is_watched) return;
  changes_.clear();
  firsts_[bracket] = item;
  if (!bracket_ && firsts_.size() == brackets_.size()) choose_bracket();
}

void MotionWatch::choose_bracket() {
  bracket_ = firsts_.begin()->first;
  for (const auto& [bracket, item] : firsts_)
    if (hardly_clips(*item)) bracket_ = bracket;
  begun_ = firsts_.at(*bracket_)->edge;
  std::erase_if(firsts_, [this](const auto& first) { return first.first != *bracket_; });
  std::erase_if(repeats_, [this](const auto& item) { return item->slot.bracket != *bracket_; });
}

const estimation::Result<estimation::FrameChange>& MotionWatch::change(const Item& before,
                                                                       const Item& after) {
  const std::pair key(&before, &after);
  const auto known = changes_.find(key);
  if (known != changes_.end()) return known->second;
  std::optional<estimation::Result<estimation::FrameChange>> measured;
  with_samples(before, [&](estimation::ImageView<const std::uint16_t> first) {
    with_samples(after, [&](estimation::ImageView<const std::uint16_t> second) {
      measured = estimation::measure_change(camera_, period_px_, first, second);
    });
  });
  return changes_.emplace(key, std::move(*measured)).first->second;
}

// The nearest repeat under that level that was shown together with `item`; none: nullptr.
const MotionWatch::Item* MotionWatch::shown_beside(const Item& item, bool is_light) const {
  const Item* nearest = nullptr;
  for (const SharedItem& repeat : repeats_) {
    const auto apart = std::chrono::abs(repeat->edge - item.edge);
    if (repeat.get() == &item || repeat->is_square_light != is_light || apart > kTogether) continue;
    if (nearest == nullptr || apart < std::chrono::abs(nearest->edge - item.edge))
      nearest = repeat.get();
  }
  return nearest;
}

// Of a frame from the disk nobody knows; then the more alike of two repeats had its level.
bool MotionWatch::is_first_light() {
  const Item& first = *firsts_.at(*bracket_);
  if (first.is_square_light || repeats_.empty()) return first.is_square_light.value_or(false);
  const Item* of_level[2] = {nullptr, nullptr};
  for (const SharedItem& repeat : repeats_) {
    const Item*& earliest = of_level[repeat->is_square_light.value_or(false) ? 1 : 0];
    if (earliest == nullptr) earliest = repeat.get();
  }
  if (of_level[0] == nullptr || of_level[1] == nullptr) return of_level[0] == nullptr;
  const auto& dark = change(first, *of_level[0]);
  const auto& light = change(first, *of_level[1]);
  if (!dark || !light) return light.has_value();
  return light->residual_frac < dark->residual_frac;
}

// Every repeat against the first showing under its level of the square.
std::vector<MotionWatch::Told> MotionWatch::tell_repeats() {
  std::vector<Told> all;
  if (!bracket_) return all;
  const Item& first = *firsts_.at(*bracket_);
  const bool is_light = is_first_light();
  const Item* const other_half = first.frame ? shown_beside(first, !is_light) : nullptr;
  for (const SharedItem& repeat : repeats_) {
    const bool is_same = repeat->is_square_light == is_light;
    if (repeat.get() == other_half) continue;
    // Shown under both levels, it is told by the one that can be compared.
    if (!is_same && other_half == nullptr && shown_beside(*repeat, is_light) != nullptr) continue;
    all.push_back(tell(*repeat, is_light, other_half));
  }
  return all;
}

MotionWatch::Told MotionWatch::tell(const Item& repeat, bool is_first_light,
                                    const Item* other_half) {
  const Item& first = *firsts_.at(*bracket_);
  const bool is_same = repeat.is_square_light == is_first_light;
  const Item* before = is_same || other_half == nullptr ? &first : other_half;
  Told told{{}, before, &repeat};
  // Frames from before the computer was started anew have a clock of their own.
  told.repeat.elapsed_s =
      std::max(0.0, std::chrono::duration<double>(repeat.edge - begun_).count());
  auto measured = change(*before, repeat);
  if (!is_same && other_half == nullptr) {
    // Only a restart at the very first showing leaves this: what changed in one place may be the
    // square, but for an earlier repeat under its level.
    if (measured) measured->local_changes.clear();
    const auto earlier =
        std::find_if(repeats_.begin(), repeats_.end(), [&repeat](const SharedItem& each) {
          return each->is_square_light == repeat.is_square_light;
        });
    if (earlier->get() != &repeat) {
      const auto& since = change(**earlier, repeat);
      if (since && measured) measured->local_changes = since->local_changes;
      if (since && !measured) measured = since, told.before = earlier->get();
    }
  }
  if (measured)
    told.repeat.change = *measured;
  else
    told.repeat.objection = measured.error().text();
  return told;
}

estimation::MotionReport MotionWatch::judge(const estimation::MotionRules& rules) {
  wait_until_looked_at();
  return judge(tell_repeats(), rules);
}

estimation::MotionReport MotionWatch::judge(const std::vector<Told>& told,
                                            const estimation::MotionRules& rules) const {
  std::vector<estimation::Repeat> repeats;
  repeats.reserve(told.size());
  for (const Told& each : told) repeats.push_back(each.repeat);
  std::vector<estimation::SeenFrame> seen;
  for (const auto& [slot, frame] : seen_) seen.push_back(frame);
  return estimation::judge_motion(std::move(repeats), scale_, rules,
                                  estimation::find_brief_changes(camera_, grid_, patterns_, seen));
}

estimation::MotionReport MotionWatch::judge_by(const estimation::Maps& maps,
                                               const estimation::MotionRules& rules) {
  wait_until_looked_at();
  std::vector<Told> told = tell_repeats();
  for (Told& each : told) {
    if (!each.repeat.change) continue;
    with_samples(*each.before, [&](estimation::ImageView<const std::uint16_t> before) {
      with_samples(*each.after, [&](estimation::ImageView<const std::uint16_t> after) {
        const auto motion = estimation::measure_surface_motion(camera_, calibration_, axis_,
                                                               period_px_, maps, before, after);
        if (motion) each.repeat.by_surface = *motion;  // else the calibrated distance must do
      });
    });
  }
  return judge(told, rules);
}

}  // namespace capture
