#include "hw_sim/app/virtual_rig.h"

#include <arpa/inet.h>

#include <array>
#include <condition_variable>
#include <cstdlib>
#include <filesystem>
#include <mutex>
#include <optional>
#include <stop_token>
#include <thread>
#include <utility>

#include "hw_sim/app/camera_socket.h"
#include "hw_sim/app/saboteur.h"
#include "hw_sim/display/photodiode_line.h"
#include "hw_sim/display/screen_grabber.h"
#include "hw_sim/display/virtual_screen.h"
#include "hw_sim/gige/gige_device.h"
#include "hw_sim/usb/usb_testbed.h"
#include "hw_sim/usb/usb_trigger_box.h"

namespace hw_sim {
namespace {

constexpr double kRefresh_hz = 60;

// Has the world compute a picture's light while it is on its way to the screen. Of pictures that
// come faster than that only the newest: an exposure computes what it misses itself.
class Preparer {
 public:
  explicit Preparer(const World& world)
      : world_(world), thread_([this](const std::stop_token& stop) { run(stop); }) {}

  void add(std::shared_ptr<const Picture> picture) {
    {
      const std::lock_guard lock(mutex_);
      newest_ = std::move(picture);
    }
    changed_.notify_one();
  }

 private:
  void run(const std::stop_token& stop) {
    while (true) {
      std::unique_lock lock(mutex_);
      if (!changed_.wait(lock, stop, [this] { return newest_ != nullptr; })) return;
      const std::shared_ptr<const Picture> picture = std::exchange(newest_, nullptr);
      lock.unlock();
      world_.prepare(picture);
    }
  }

  const World& world_;
  std::mutex mutex_;
  std::condition_variable_any changed_;
  std::shared_ptr<const Picture> newest_;  // guarded by mutex_
  std::jthread thread_;
};

VirtualScreenSettings screen_settings(const rig::RigFile& rig) {
  return {.projector_width_px = rig.projector.width_px,
          .projector_height_px = rig.projector.height_px,
          .refresh_hz = kRefresh_hz};
}

UsbTriggerBoxOptions box_options(const rig::RigFile& rig, FaultSchedule& faults) {
  UsbTriggerBoxOptions options;
  options.faults = &faults;
  options.vendor_id = rig.trigger.vendor_id;
  options.product_id = rig.trigger.product_id;
  if (!rig.trigger.serial.empty()) options.serial = rig.trigger.serial;
  return options;
}

GigeDeviceOptions camera_options(const rig::RigFile& rig, FaultSchedule& faults,
                                 bool has_line_status) {
  GigeDeviceOptions options;
  options.has_line_status = has_line_status;
  options.faults = &faults;
  options.is_the_trigger = rig.sequence.sync != rig::SyncMode::kTriggerBox;
  in_addr parsed{};  // a rig file may name its camera instead
  if (inet_pton(AF_INET, rig.camera.address.c_str(), &parsed) == 1)
    options.address = rig.camera.address;
  if (!rig.camera.serial.empty()) options.serial = rig.camera.serial;
  options.pixel_formats = {rig.camera.pixel_format};
  return options;
}

GrabberSettings grabber_settings(const rig::RigFile& rig, const std::string& display,
                                 const LampTiming& lamp, FaultSchedule& faults) {
  GrabberSettings settings;
  settings.faults = &faults;
  settings.display = display;
  settings.output = VirtualScreen::kProjectorOutput;
  settings.refresh_hz = kRefresh_hz;
  settings.input_lag_frames = lamp.input_lag_refreshes;
  settings.square_delay = square_delay(lamp, rig.projector.sync_square, rig.projector.height_px);
  settings.sync_square = rig.projector.sync_square;
  settings.photodiode.is_inverted = rig.projector.sync_square.is_inverted;
  return settings;
}

}  // namespace

struct VirtualRig::Parts {
  explicit Parts(const World& world) : preparer(world) {}

  std::string glx_shim;
  std::unique_ptr<VirtualScreen> screen;
  LightTimeline light;
  Preparer preparer;
  std::optional<CameraSocket> camera;
  std::unique_ptr<UsbTestbed> testbed;
  std::optional<UsbTriggerBox> box;  // one of the two, or in sync mode software none
  std::optional<PhotodiodeLine> line;
  std::unique_ptr<ScreenGrabber> grabber;  // it feeds all of them
  std::filesystem::path skip_file;
  std::optional<SharedCount> skipped_blanks;
  std::optional<Saboteur> saboteur;  // last: it meddles with all of them
};

// What the photodiode's level is told to.
ScreenGrabber::LevelCallback VirtualRig::wire_photodiode(const rig::RigFile& rig,
                                                         FaultSchedule& faults, Parts& parts) {
  CameraSocket& camera = *parts.camera;
  switch (rig.sequence.sync) {
    case rig::SyncMode::kTriggerBox:
      parts.box.emplace(*parts.testbed, box_options(rig, faults),
                        [&camera](LinePulse pulse) { camera.pulse(pulse.start, pulse.width); });
      return [&box = *parts.box](rig::HostTime time, int level_adc) { box.light(time, level_adc); };
    case rig::SyncMode::kCameraLine:
      parts.line.emplace(faults, [&camera](rig::HostTime time, bool is_high) {
        return camera.line(time, is_high);
      });
      return
          [&line = *parts.line](rig::HostTime time, int level_adc) { line.light(time, level_adc); };
    case rig::SyncMode::kSoftware:
      break;
  }
  return [](rig::HostTime, int) {};
}

rig::Result<std::unique_ptr<VirtualRig>> VirtualRig::start(const rig::RigFile& rig,
                                                           const World& world,
                                                           FaultSchedule& faults,
                                                           const VirtualRigOptions& options) {
  auto parts = std::make_unique<Parts>(world);
  rig::Result<std::string> shim = find_glx_shim();
  if (!shim) return tl::unexpected(shim.error());
  parts->glx_shim = *std::move(shim);

  rig::Result<std::unique_ptr<VirtualScreen>> screen = VirtualScreen::start(screen_settings(rig));
  if (!screen) return tl::unexpected(screen.error());
  parts->screen = *std::move(screen);

  parts->camera.emplace(
      [options = camera_options(rig, faults, options.has_line_status), &world,
       &light = parts->light] { return GigeDevice::start(options, world, light); });
  if (const rig::Result<void> powered = parts->camera->power_on(); !powered)
    return tl::unexpected(powered.error());

  rig::Result<std::unique_ptr<UsbTestbed>> testbed = UsbTestbed::open();
  if (!testbed) return tl::unexpected(testbed.error());
  parts->testbed = *std::move(testbed);
  ScreenGrabber::LevelCallback on_level = wire_photodiode(rig, faults, *parts);

  rig::Result<std::unique_ptr<ScreenGrabber>> grabber = ScreenGrabber::start(
      grabber_settings(rig, parts->screen->display(), world.lamp_timing(), faults), parts->light,
      [&preparer = parts->preparer](const auto& picture) { preparer.add(picture); },
      std::move(on_level));
  if (!grabber) return tl::unexpected(grabber.error());
  parts->grabber = *std::move(grabber);

  parts->skip_file = std::filesystem::temp_directory_path() / "skipped_blanks";
  parts->skipped_blanks.emplace(parts->skip_file);
  parts->saboteur.emplace(
      faults, Saboteur::Victims{*parts->camera, parts->box ? &*parts->box : nullptr, *parts->screen,
                                *parts->grabber, *parts->skipped_blanks});
  return std::unique_ptr<VirtualRig>(new VirtualRig(std::move(parts)));
}

VirtualRig::VirtualRig(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}

VirtualRig::~VirtualRig() = default;

std::map<std::string, std::string> VirtualRig::child_environment() const {
  std::map<std::string, std::string> environment;
  for (const auto& [name, value] : parts_->testbed->child_environment()) environment[name] = value;
  environment["LD_PRELOAD"] += ":" + parts_->glx_shim;
  environment["DISPLAY"] = parts_->screen->display();
  environment["SSRIG_SIM_REFRESH_HZ"] = std::to_string(kRefresh_hz);
  environment["SSRIG_SIM_SKIP_FILE"] = parts_->skip_file.string();
  return environment;
}

rig::Result<std::string> find_glx_shim() {
  std::error_code error;
  const std::filesystem::path folder =
      std::filesystem::read_symlink("/proc/self/exe", error).parent_path();
  std::string places;
  for (const char* place : {".", "../lib/ssrig"}) {
    const std::filesystem::path file = (folder / place / "libglxsim.so").lexically_normal();
    if (std::filesystem::exists(file, error)) return file.string();
    places += (places.empty() ? "" : ", ") + file.string();
  }
  return rig::failure(rig::Fault::kNotFound,
                      "libglxsim.so is at none of " + places + "; build target glxsim");
}

}  // namespace hw_sim
