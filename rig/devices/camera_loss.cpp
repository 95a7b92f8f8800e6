#include "rig/devices/camera_loss.h"

namespace rig {

void LossLatch::report(const std::string& cause) {
  const std::lock_guard lock(mutex_);
  if (is_lost_.exchange(true) || sink_ == nullptr) return;
  sink_->post(DeviceFault{
      Device::kCamera,
      {Fault::kDeviceLost, cause + "; check the camera's cable and power and open it anew"}});
}

void LossLatch::close() {
  const std::lock_guard lock(mutex_);
  sink_ = nullptr;
}

}  // namespace rig
