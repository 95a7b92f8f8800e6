#include "hw_sim/exposure_engine.h"

namespace hw_sim {

void ExposureEngine::start() {
  busy_until_ = rig::HostTime::min();
  trigger_count_ = 0;
  missed_count_ = 0;
  active_set_ = start_set;
}

std::optional<ExposureJob> ExposureEngine::trigger(rig::HostTime time,
                                                   std::chrono::microseconds width) {
  ++trigger_count_;
  if (time < busy_until_) {
    ++missed_count_;
    return std::nullopt;
  }
  ExposureJob job{.trigger_number = trigger_count_, .start = time, .duration = fixed_exposure};
  if (is_sequencer_on) {
    job.sequencer_set = active_set_;
    job.duration = sets[index(active_set_)].exposure;
    active_set_ = sets[index(active_set_)].next_set;
  } else if (bracketing == rig::Bracketing::kTriggerWidth) {
    job.duration = width;
  }
  busy_until_ = job.end() + readout;
  return job;
}

}  // namespace hw_sim
