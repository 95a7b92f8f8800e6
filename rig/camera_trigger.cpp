#include "rig/camera_trigger.h"

#include <algorithm>
#include <string>
#include <utility>

namespace rig {
namespace {

// Round trips to the camera's clock; the quickest counts.
constexpr int kClockReadCount = 8;

Result<CameraClockSample> read_clock(Camera& camera) {
  Result<CameraClockSample> best = camera.read_clock();
  for (int i = 1; best && i < kClockReadCount; ++i) {
    const Result<CameraClockSample> sample = camera.read_clock();
    if (!sample) return sample;
    if (sample->uncertainty < best->uncertainty) best = sample;
  }
  return best;
}

}  // namespace

Result<void> CameraTrigger::arm(const std::vector<std::chrono::microseconds>& pulse_widths,
                                std::uint32_t /*run_id*/) {
  const Result<CameraClockSample> sample = read_clock(*camera_);
  if (!sample) return tl::unexpected(sample.error());
  const std::lock_guard lock(mutex_);
  if (is_armed_) return failure(Fault::kBusy, "the camera's trigger is armed; disarm it first");
  exposures_ = pulse_widths;
  clock_ = {};
  // The uncertainty is only a weight, and one sample needs none.
  clock_.add(sample->device, sample->host,
             std::max(sample->uncertainty, std::chrono::nanoseconds(1)));
  last_count_ = 0;
  last_block_ = 0;
  is_armed_ = true;
  return {};
}

void CameraTrigger::disarm() noexcept {
  const std::lock_guard lock(mutex_);
  is_armed_ = false;
}

Result<TriggerCounters> CameraTrigger::counters() {
  const Result<CameraCounters> camera = camera_->counters();
  if (!camera) return tl::unexpected(camera.error());
  const auto count = static_cast<std::uint32_t>(std::max<std::int64_t>(camera->trigger_count, 0));
  const auto missed =
      static_cast<std::uint32_t>(std::max<std::int64_t>(camera->missed_trigger_count, 0));
  return TriggerCounters{count, count - missed, missed, 0};
}

void CameraTrigger::post(Event event) {
  const std::lock_guard lock(mutex_);  // one frame's events stay together
  if (const auto* arrived = std::get_if<FrameArrived>(&event); arrived != nullptr && is_armed_)
    account_for(arrived->frame);
  if (const auto* damaged = std::get_if<FrameDamaged>(&event); damaged != nullptr && is_armed_) {
    if (damaged->block_id > last_block_) tell_of_lost(damaged->block_id);
    last_block_ = std::max(last_block_, damaged->block_id);
  }
  sink_.post(std::move(event));
}

void CameraTrigger::account_for(const Frame& frame) {
  const std::uint64_t count = frame.trigger_count.value_or(frame.block_id);
  if (count <= last_count_) return;  // it came twice
  tell_of_lost(frame.block_id);
  last_block_ = std::max(last_block_, frame.block_id);
  last_count_ = count;
  const auto number = static_cast<std::uint32_t>(count);
  const HostTime started = clock_.to_host(frame.timestamp);
  const auto exposure = frame.exposure.value_or(exposures_[(count - 1) % exposures_.size()]);
  sink_.post(EdgeSeen{number, frame.is_line_high.value_or(count % 2 == 1), started});
  sink_.post(PulseEnded{number, 0, number, started, started + exposure});
}

void CameraTrigger::tell_of_lost(std::uint64_t up_to_block) {
  for (std::uint64_t lost = last_block_ + 1; lost < up_to_block; ++lost)
    sink_.post(FrameDamaged{
        lost, {Fault::kSequenceGap, "block " + std::to_string(lost) + " never arrived"}});
}

}  // namespace rig
