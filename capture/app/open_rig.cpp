#include "capture/app/open_rig.h"

#include <utility>

namespace capture {
namespace {

// What was opened, or nullptr and one more problem.
template <typename Device>
std::unique_ptr<Device> take(rig::Result<std::unique_ptr<Device>> opened, rig::Device device,
                             std::vector<std::string>& problems) {
  if (opened) return std::move(*opened);
  problems.push_back(std::string(to_string(device)) + ": " + opened.error().detail);
  return nullptr;
}

}  // namespace

OpenRig::OpenRig(const rig::RigFile& rig_file) : rig_file_(rig_file) {
  if (rig_file.sequence.sync != rig::SyncMode::kTriggerBox) camera_trigger_.emplace(*events_);
}

rig::Trigger& OpenRig::trigger() {
  if (camera_trigger_) return *camera_trigger_;
  return *trigger_;
}

rig::EventSink& OpenRig::camera_sink() {
  if (camera_trigger_) return *camera_trigger_;
  return *events_;
}

std::unique_ptr<OpenRig> OpenRig::open(const rig::RigFile& rig_file,
                                       std::vector<std::string>& problems) {
  std::unique_ptr<OpenRig> rig(new OpenRig(rig_file));
  rig::EventQueue& events = *rig->events_;
  auto camera = rig::AravisCamera::open(rig_file.camera, rig->camera_sink());
  const bool is_others = !camera && camera.error().fault == rig::Fault::kAccessDenied;
  rig->camera_.emplace(take(std::move(camera), rig::Device::kCamera, problems));
  if (is_others) return nullptr;  // a second window would cover the other program's patterns
  if (rig->camera_trigger_)
    rig->camera_trigger_->watch(*rig->camera_);
  else
    rig->trigger_.emplace(
        take(rig::LibusbTrigger::open(rig_file.trigger, events), rig::Device::kTrigger, problems));
  rig->projector_ =
      take(rig::GlfwProjector::open(rig_file.projector, events), rig::Device::kProjector, problems);
  if (!problems.empty()) return nullptr;
  return rig;
}

void OpenRig::close(rig::Device device) {
  if (device == rig::Device::kCamera) camera_->set(nullptr);
  if (device == rig::Device::kTrigger) trigger_->set(nullptr);
}

rig::Result<void> OpenRig::open(rig::Device device) {
  switch (device) {
    case rig::Device::kProjector:
      return projector_->check();
    case rig::Device::kTrigger: {
      auto trigger = rig::LibusbTrigger::open(rig_file_.trigger, *events_);
      if (!trigger) return tl::unexpected(trigger.error());
      trigger_->set(std::move(*trigger));
      return {};
    }
    case rig::Device::kCamera: {
      auto camera = rig::AravisCamera::open(rig_file_.camera, camera_sink());
      if (!camera) return tl::unexpected(camera.error());
      camera_->set(std::move(*camera));
      return {};
    }
  }
  return {};
}

}  // namespace capture
