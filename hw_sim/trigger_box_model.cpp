#include "hw_sim/trigger_box_model.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace hw_sim {
namespace {

using rig::HostTime;
using rig::tb1::Config;
using rig::tb1::Edges;
using rig::tb1::RecordType;
using rig::tb1::Request;

constexpr std::uint16_t kFirmwareVersion = 1;

template <std::size_t Size>
std::vector<std::uint8_t> to_vector(const std::array<std::uint8_t, Size>& bytes) {
  return {bytes.begin(), bytes.end()};
}

std::optional<std::vector<std::uint8_t>> acknowledge(bool is_accepted) {
  if (!is_accepted) return std::nullopt;
  return std::vector<std::uint8_t>{};
}

}  // namespace

TriggerBoxModel::TriggerBoxModel(HostTime power_up, double drift_ppm)
    : power_up_(power_up),
      drift_frac_(drift_ppm * 1e-6),
      now_(power_up),
      next_heartbeat_(power_up + rig::tb1::kHeartbeatPeriod) {}

std::optional<std::vector<std::uint8_t>> TriggerBoxModel::control(
    std::uint8_t request, std::uint16_t value, const std::vector<std::uint8_t>& data,
    HostTime now) {
  run_due(now);
  now = std::max(now, now_);
  switch (static_cast<Request>(request)) {
    case Request::kGetInfo:
      return to_vector(rig::tb1::encode(rig::tb1::Info{.firmware_version = kFirmwareVersion}));
    case Request::kSetConfig:
      return acknowledge(set_config(data));
    case Request::kGetConfig:
      if (!config_) return std::nullopt;
      return to_vector(rig::tb1::encode(*config_));
    case Request::kArm:
      now_ = now;
      return acknowledge(arm(value));
    case Request::kDisarm:
      now_ = now;
      disarm();
      return acknowledge(true);
    case Request::kGetStatus:
      return to_vector(rig::tb1::encode(status_));
    case Request::kGetTime:
      return to_vector(rig::tb1::encode_time(time_us(now)));
    case Request::kSoftTrigger:
      now_ = now;
      return acknowledge(soft_trigger());
    case Request::kGetLevel:
      return to_vector(rig::tb1::encode(take_levels()));
  }
  return std::nullopt;
}

bool TriggerBoxModel::set_config(const std::vector<std::uint8_t>& data) {
  if (status_.is_armed) return false;
  const rig::Result<Config> config = rig::tb1::decode_config(data);
  if (!config) return false;
  config_ = *config;
  return true;
}

bool TriggerBoxModel::arm(std::uint16_t run_id) {
  if (!config_) return false;
  train_.reset();
  last_edge_.reset();
  output_.records.clear();
  owes_overflow_ = false;
  next_seq_ = 0;
  status_ = {.run_id = run_id, .is_armed = true};
  record(RecordType::kArmed);
  return true;
}

void TriggerBoxModel::disarm() {
  if (!status_.is_armed) return;
  train_.reset();
  status_.is_armed = false;
  record(RecordType::kDisarmed, std::min<std::size_t>(status_.ignored_edge_count,
                                                      std::numeric_limits<std::uint16_t>::max()));
}

bool TriggerBoxModel::soft_trigger() {
  if (!status_.is_armed || train_) return false;
  ++status_.edge_count;
  record(RecordType::kEdge);
  start_train(std::chrono::microseconds(0));
  return true;
}

rig::tb1::Levels TriggerBoxModel::take_levels() {
  const rig::tb1::Levels levels{static_cast<std::uint16_t>(minimum_adc_),
                                static_cast<std::uint16_t>(maximum_adc_)};
  minimum_adc_ = maximum_adc_ = level_adc_;
  return levels;
}

void TriggerBoxModel::light(HostTime time, int level_adc) {
  step_to(time);
  level_adc_ = std::clamp(level_adc, 0, rig::tb1::kAdcMax);
  minimum_adc_ = std::min(minimum_adc_, level_adc_);
  maximum_adc_ = std::max(maximum_adc_, level_adc_);
  const Config thresholds = config_.value_or(Config{});
  const bool was_light = is_light_;
  if (level_adc_ > thresholds.threshold_high) is_light_ = true;
  if (level_adc_ < thresholds.threshold_low) is_light_ = false;
  if (is_light_ != was_light && status_.is_armed) edge(is_light_);
}

// Debounce restarts with every edge, ignored or not: a flickering diode triggers once at most and
// is reported, where a fixed dead time would trigger again and again.
void TriggerBoxModel::edge(bool is_light) {
  const std::optional<HostTime> previous = std::exchange(last_edge_, now_);
  if (!wants_edge(is_light)) return;
  const bool is_bounce =
      previous && now_ - *previous < std::chrono::microseconds(config_->debounce_us);
  if (train_ || is_bounce) {
    ++status_.ignored_edge_count;
    record(RecordType::kIgnoredEdge);
    return;
  }
  ++status_.edge_count;
  record(RecordType::kEdge);
  start_train(
      std::chrono::microseconds(is_light ? config_->delay_rise_us : config_->delay_fall_us));
}

bool TriggerBoxModel::wants_edge(bool is_light) const {
  return config_->edges == Edges::kBoth ||
         config_->edges == (is_light ? Edges::kRise : Edges::kFall);
}

void TriggerBoxModel::start_train(std::chrono::microseconds delay) {
  Train train;
  train.pulse_count = config_->pulse_count;
  HostTime start = now_ + delay;
  for (std::size_t i = 0; i < train.pulse_count; ++i) {
    train.pulses[i] = {start, std::chrono::microseconds(config_->width_us[i]), static_cast<int>(i)};
    start += train.pulses[i].width + std::chrono::microseconds(config_->gap_us);
  }
  train_ = train;
  run_due(now_);  // without delay the first pulse starts at the edge itself
}

HostTime TriggerBoxModel::Train::due() const {
  const LinePulse& pulse = pulses[pulse_index];
  return is_up ? pulse.start + pulse.width : pulse.start;
}

void TriggerBoxModel::step_train() {
  const std::size_t index = train_->pulse_index;
  if (!train_->is_up) {
    train_->is_up = true;
    ++status_.pulse_count;
    output_.pulses.push_back(train_->pulses[index]);
    record(RecordType::kPulseStart, index);
    return;
  }
  record(RecordType::kPulseEnd, index);
  train_->is_up = false;
  ++train_->pulse_index;
  if (train_->pulse_index == train_->pulse_count) train_.reset();
}

std::optional<HostTime> TriggerBoxModel::next_due() const {
  return train_ ? std::min(train_->due(), next_heartbeat_) : next_heartbeat_;
}

void TriggerBoxModel::run_due(HostTime time) {
  while (*next_due() <= time) {
    now_ = std::max(now_, *next_due());
    if (train_ && train_->due() <= next_heartbeat_) {
      step_train();
    } else {
      next_heartbeat_ += rig::tb1::kHeartbeatPeriod;
      record(RecordType::kHeartbeat);
    }
  }
}

void TriggerBoxModel::step_to(HostTime time) {
  run_due(time);
  now_ = std::max(now_, time);
}

BoxOutput TriggerBoxModel::advance(HostTime now) {
  run_due(now);
  return std::exchange(output_, {});
}

void TriggerBoxModel::record(RecordType type, std::size_t pulse_index) {
  if (is_queue_full_) {
    ++next_seq_;
    ++status_.dropped_record_count;
    owes_overflow_ = true;
    return;
  }
  if (std::exchange(owes_overflow_, false)) record(RecordType::kOverflow);
  output_.records.push_back({.type = type,
                             .level = static_cast<std::uint8_t>(is_light_ ? 1 : 0),
                             .pulse_index = static_cast<std::uint16_t>(pulse_index),
                             .seq = next_seq_++,
                             .edge_number = status_.edge_count,
                             .pulse_number = status_.pulse_count,
                             .time_us = time_us(now_),
                             .run_id = status_.run_id,
                             .dropped_count = status_.dropped_record_count});
}

std::uint64_t TriggerBoxModel::time_us(HostTime now) const {
  const auto elapsed =
      std::chrono::duration_cast<std::chrono::nanoseconds>(now - power_up_).count();
  const auto drift =
      static_cast<std::int64_t>(std::llround(static_cast<double>(elapsed) * drift_frac_));
  return static_cast<std::uint64_t>(std::max<std::int64_t>(elapsed + drift, 0)) / 1000;
}

}  // namespace hw_sim
