#include "capture/app/open_rig.h"

#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <utility>

namespace capture {
namespace {

// A camera or box that lives is closed in some ms.
constexpr std::chrono::milliseconds kClosingPatience{400};

// A device as what it is to capture.
template <typename Device, typename Concrete>
rig::Result<std::unique_ptr<Device>> as(rig::Result<std::unique_ptr<Concrete>> opened) {
  if (!opened) return tl::unexpected(opened.error());
  return std::unique_ptr<Device>(std::move(*opened));
}

// nullopt: `stop` came first.
template <typename Device>
std::optional<rig::Result<std::unique_ptr<Device>>> open_by(rig::Opening<Device>& opening,
                                                            const std::stop_token& stop) {
  opening.reopen(nullptr);
  opening.wait(rig::HostTime::max(), stop);
  return opening.take();
}

template <typename Device, typename Replaceable>
std::optional<rig::Result<void>> take_over(rig::Opening<Device>& opening, Replaceable& device) {
  auto opened = opening.take();
  if (!opened) return std::nullopt;
  if (!*opened) return tl::unexpected(opened->error());
  device.set(std::move(**opened));
  return rig::Result<void>{};
}

void note(std::vector<std::string>& problems, rig::Device device, const rig::Error& error) {
  problems.push_back(std::string(to_string(device)) + ": " + error.detail);
}

}  // namespace

OpenRig::OpenRig(const rig::RigFile& rig_file)
    : rig_file_(rig_file),
      camera_opening_(
          [this] {
            auto camera = rig::AravisCamera::open(rig_file_.camera, camera_sink(), camera_past_);
            if (camera) camera_past_ = (*camera)->past();
            return as<rig::Camera>(std::move(camera));
          },
          [this] { events_->post(rig::DeviceOpened{rig::Device::kCamera}); }),
      trigger_opening_(
          [this] {
            return as<rig::Trigger>(rig::LibusbTrigger::open(rig_file_.trigger, *events_));
          },
          [this] { events_->post(rig::DeviceOpened{rig::Device::kTrigger}); }) {
  if (rig_file.sequence.sync == rig::SyncMode::kTriggerBox) return;
  camera_trigger_.emplace(*events_);
  camera_trigger_->watch(camera_);
}

rig::Trigger& OpenRig::trigger() {
  if (camera_trigger_) return *camera_trigger_;
  return trigger_;
}

rig::EventSink& OpenRig::camera_sink() {
  if (camera_trigger_) return *camera_trigger_;
  return *events_;
}

bool OpenRig::open(const std::stop_token& stop, std::vector<std::string>& problems) {
  auto camera = open_by(camera_opening_, stop);
  if (!camera) return false;
  if (*camera)
    camera_.set(std::move(**camera));
  else
    note(problems, rig::Device::kCamera, camera->error());
  // A second window would cover the other program's patterns.
  if (!*camera && camera->error().fault == rig::Fault::kAccessDenied) return false;
  if (!camera_trigger_) {
    auto trigger = open_by(trigger_opening_, stop);
    if (!trigger) return false;
    if (*trigger)
      trigger_.set(std::move(**trigger));
    else
      note(problems, rig::Device::kTrigger, trigger->error());
  }
  auto projector = rig::GlfwProjector::open(rig_file_.projector, *events_, stop);
  if (projector)
    projector_ = std::move(*projector);
  else
    note(problems, rig::Device::kProjector, projector.error());
  return problems.empty() && !stop.stop_requested();
}

bool OpenRig::close(rig::HostTime deadline, const std::stop_token& stop) {
  projector_.reset();
  if (!camera_opening_.wait(deadline, stop) || !trigger_opening_.wait(deadline, stop)) return false;
  camera_opening_.close(camera_.take());
  trigger_opening_.close(trigger_.take());
  return camera_opening_.wait(deadline, stop) && trigger_opening_.wait(deadline, stop);
}

void OpenRig::reopen(rig::Device device) {
  switch (device) {
    case rig::Device::kProjector:
      events_->post(rig::DeviceOpened{device});
      break;
    case rig::Device::kTrigger:
      trigger_opening_.reopen(trigger_.take());
      break;
    case rig::Device::kCamera:
      camera_opening_.reopen(camera_.take());
      break;
  }
}

std::optional<rig::Result<void>> OpenRig::finish(rig::Device device) {
  switch (device) {
    case rig::Device::kProjector:
      return projector_->check();
    case rig::Device::kTrigger:
      return take_over(trigger_opening_, trigger_);
    case rig::Device::kCamera:
      return take_over(camera_opening_, camera_);
  }
  return std::nullopt;
}

ExitCode leave(std::unique_ptr<OpenRig> rig, ExitCode exit_code) {
  if (rig == nullptr || rig->close(rig::HostClock::now() + kClosingPatience, {})) return exit_code;
  std::fflush(nullptr);
  ::_exit(static_cast<int>(exit_code));
}

}  // namespace capture
