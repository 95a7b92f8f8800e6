#include "hw_sim/devices/in_process_rig.h"

#include <utility>

namespace hw_sim {

namespace {

constexpr int kStrayIndex = -1;  // of a pulse that is in no train

DisplayTiming lagged(DisplayTiming timing, const World& world) {
  timing.input_lag_refreshes += world.lamp_timing().input_lag_refreshes;
  return timing;
}

}  // namespace

InProcessRig::InProcessRig(const World& world, InProcessOptions options)
    : world_(world),
      options_(std::move(options)),
      faults_(options_.faults),
      camera_(options_.camera, options_.camera_timing, faults_, timeline_, world_, light_),
      camera_trigger_(timeline_),
      trigger_(options_.trigger, faults_, timeline_,
               [this](const LinePulse& each) { pulse(each); }),
      photodiode_(timeline_, [this](int level_adc) { level(level_adc); }),
      projector_(options_.projector, lagged(options_.display_timing, world_), faults_, timeline_,
                 [this](const std::shared_ptr<const Picture>& picture, bool is_square_light,
                        const FlipFaults& faults) { light(picture, is_square_light, faults); }) {
  camera_trigger_.watch(camera_);
  if (!has_box()) camera_.be_the_trigger(camera_trigger_, [this] { pulse_without_box(); });
  photodiode_.square(false);
  // What the plan has for a rig at rest.
  faults_.opened();
  take_device_faults();
  photodiode_.take_faults(faults_);
  if (has_box()) trigger_.take_train_faults();
  if (faults_.take(FaultKind::kTriggerDoubled)) camera_.disturb_line();
  if (const auto step = faults_.take(FaultKind::kClockStep)) camera_.step_clock(step->duration);
}

void InProcessRig::light(const std::shared_ptr<const Picture>& picture, bool is_square_light,
                         const FlipFaults& faults) {
  light_.show(timeline_.now(), picture);
  world_.prepare(picture);
  const auto delay = square_delay(world_.lamp_timing(), options_.projector.sync_square,
                                  options_.projector.height_px);
  if (delay.count() == 0) return photodiode_.square(is_square_light, faults);
  timeline_.schedule(timeline_.now() + delay, [this, is_square_light, faults] {
    photodiode_.square(is_square_light, faults);
  });
}

rig::Trigger& InProcessRig::trigger() {
  if (has_box()) return trigger_;
  return camera_trigger_;
}

void InProcessRig::level(int level_adc) {
  if (has_box()) return trigger_.photodiode(level_adc);
  const bool is_edge = comparator_.look(level_adc);
  camera_.set_line(comparator_.is_high());
  if (is_edge && options_.sync == rig::SyncMode::kCameraLine) pulse_without_box();
}

void InProcessRig::pulse(const LinePulse& pulse) {
  if (pulse.index == 0) {
    photodiode_.take_faults(faults_);
    take_device_faults();
  }
  camera_.pulse(pulse);
}

// What the box tells the schedule of faults, told by what the camera makes of the pulse.
void InProcessRig::pulse_without_box() {
  const int bracket = camera_.next_bracket();
  if (!camera_.is_waiting())  // one too many
    return camera_.pulse({timeline_.now(), {}, kStrayIndex});
  if (bracket == 0) faults_.train_started();
  faults_.pulse_started(bracket);
  pulse({timeline_.now(), {}, bracket});
}

void InProcessRig::take_device_faults() {
  if (const auto stuck = faults_.take(FaultKind::kPhotodiodeStuck)) {
    photodiode_.stick(true);
    undo_after(stuck->duration, [this] { photodiode_.stick(false); });
  }
  if (const auto dim = faults_.take(FaultKind::kPhotodiodeDim)) {
    photodiode_.dim(dim->level_frac);
    undo_after(dim->duration, [this] { photodiode_.dim(1); });
  }
  if (const auto out = has_box() ? faults_.take(FaultKind::kUsbUnplugged) : std::nullopt) {
    trigger_.unplug();
    undo_after(out->duration, [this] { trigger_.plug_in(); });
  }
  if (const auto off = faults_.take(FaultKind::kCameraRebooted)) {
    camera_.power_off();
    undo_after(off->duration, [this] { camera_.power_on(); });
  }
  if (const auto pulled = faults_.take(FaultKind::kCablePulled)) {
    camera_.pull_cable();
    undo_after(pulled->duration, [this] { camera_.plug_cable_in(); });
  }
  if (const auto stolen = faults_.take(FaultKind::kControlStolen)) {
    camera_.steal_control();
    undo_after(stolen->duration, [this] { camera_.give_control_back(); });
  }
  if (const auto gone = faults_.take(FaultKind::kProjectorGone)) {
    projector_.unplug();
    undo_after(gone->duration, [this] { projector_.plug_in(); });
  }
  if (const auto gamma = faults_.take(FaultKind::kGammaWrong)) {
    projector_.set_gamma(gamma->gamma_exponent);
    undo_after(gamma->duration, [this] { projector_.set_gamma(1); });
  }
}

void InProcessRig::reopen(rig::Device device) {
  if (device == rig::Device::kCamera) camera_.disarm();
  if (device == rig::Device::kTrigger) trigger_.disarm();
  if (!openings_.insert(device).second) return;
  timeline_.schedule(timeline_.now() + options_.opening_time, [this, device] {
    openings_.erase(device);
    opened_.insert_or_assign(device, open(device));
    timeline_.post(rig::DeviceOpened{device});
  });
}

std::optional<rig::Result<void>> InProcessRig::finish(rig::Device device) {
  const auto opened = opened_.extract(device);
  if (opened.empty()) return std::nullopt;
  return opened.mapped();
}

rig::Result<void> InProcessRig::open(rig::Device device) {
  switch (device) {
    case rig::Device::kProjector:
      return projector_.check();
    case rig::Device::kTrigger:
      return trigger_.open_again();
    case rig::Device::kCamera:
      return camera_.open_again();
  }
  return {};
}

void InProcessRig::undo_after(std::chrono::milliseconds duration, std::function<void()> undo) {
  if (duration.count() > 0) timeline_.schedule(timeline_.now() + duration, std::move(undo));
}

std::shared_ptr<const Picture> InProcessRig::picture_now() const {
  const auto segments =
      light_.between(timeline_.now(), timeline_.now() + std::chrono::nanoseconds(1));
  return segments.empty() ? nullptr : segments.front().picture;
}

}  // namespace hw_sim
