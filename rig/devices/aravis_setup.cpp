#include "rig/devices/aravis_setup.h"

#include <arpa/inet.h>
#include <arv.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <memory>
#include <optional>
#include <vector>

#include "rig/devices/aravis_trigger.h"

namespace rig {
namespace {

constexpr std::array<const char*, 2> kFirmwareNames{"DeviceFirmwareVersion", "DeviceVersion"};
constexpr std::uint32_t kPrimaryApplicationAddress = 0x0A14;  // GigE Vision bootstrap register

// The MTU of the interface that has this IPv4 address; nullopt where none has.
std::optional<int> interface_mtu(const std::string& address) {
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) != 0) return std::nullopt;
  const std::unique_ptr<ifaddrs, void (*)(ifaddrs*)> owner(list, freeifaddrs);
  for (const ifaddrs* at = list; at != nullptr; at = at->ifa_next) {
    if (at->ifa_addr == nullptr || at->ifa_addr->sa_family != AF_INET) continue;
    std::array<char, INET_ADDRSTRLEN> text{};
    sockaddr_in name;
    std::memcpy(&name, at->ifa_addr, sizeof name);
    inet_ntop(AF_INET, &name.sin_addr, text.data(), text.size());
    if (address != text.data()) continue;
    ifreq request{};
    std::strncpy(request.ifr_name, at->ifa_name, IFNAMSIZ - 1);
    const int probe = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    const bool is_known = ioctl(probe, SIOCGIFMTU, &request) == 0;
    close(probe);
    if (is_known) return request.ifr_mtu;
  }
  return std::nullopt;
}

std::string inet_text(GSocketAddress* address) {
  GInetAddress* inet = g_inet_socket_address_get_address(G_INET_SOCKET_ADDRESS(address));
  gchar* text = g_inet_address_to_string(inet);
  std::string copy(text);
  g_free(text);
  return copy;
}

// One call of set_up(): the camera in the making.
class Setting {
 public:
  Setting(ArvCamera* camera, const CameraSettings& settings, const std::optional<CameraPast>& past)
      : camera_(camera), features_(camera), settings_(settings), past_(past) {}

  Result<AravisSetup> run() && {
    const Result<void> done =
        in_order([&] { return check_controller(); }, [&] { return read_identity(); },
                 [&] { return stop_whatever_runs(); },
                 [&] { return past_ ? restore_shape(features_, past_->look) : Result<void>{}; },
                 [&] { return set_pixel_format(); }, [&] { return set_region(); },
                 [&] { return past_ ? restore_levels(features_, past_->look) : Result<void>{}; },
                 [&] { return set_packet_size(); }, [&] { return set_chunks(); },
                 [&] { return set_trigger(features_, settings_, setup_); },
                 [&] { return take_look(); }, [&] { return features_.answered(); });
    if (!done) return tl::unexpected(done.error());
    return std::move(setup_);
  }

 private:
  Result<void> check_controller();
  Result<void> read_identity();
  Result<void> stop_whatever_runs();
  Result<void> set_region();
  Result<void> set_extent(const char* name, int value_px, const char* key);
  Result<void> set_pixel_format();
  Result<void> set_packet_size();
  Result<void> set_chunks();
  Result<void> take_look();

  ArvCamera* camera_;  // borrowed
  AravisFeatures features_;
  const CameraSettings& settings_;
  const std::optional<CameraPast>& past_;
  AravisSetup setup_;
};

Result<void> Setting::check_controller() {
  ArvDevice* device = arv_camera_get_device(camera_);
  if (!arv_camera_is_gv_device(camera_))
    return failure(Fault::kUnsupported, settings_.address + " is no GigE Vision camera");
  if (arv_gv_device_is_controller(ARV_GV_DEVICE(device))) return {};
  guint32 address = 0;
  GError* error = nullptr;
  arv_device_read_register(device, kPrimaryApplicationAddress, &address, &error);
  g_clear_error(&error);
  const in_addr owner{htonl(address)};
  std::array<char, INET_ADDRSTRLEN> text{};
  inet_ntop(AF_INET, &owner, text.data(), text.size());
  const std::string who =
      address == 0 ? "another program" : "a program at " + std::string(text.data());
  return failure(Fault::kAccessDenied, who + " controls " + name_of(settings_) +
                                           "; close it, or wait 3 s if it has just crashed");
}

Result<void> Setting::read_identity() {
  const auto text = [&](const char* name) { return features_.text(name).value_or(""); };
  const Result<std::string> vendor = features_.text("DeviceVendorName");
  if (!vendor) return tl::unexpected(vendor.error());
  setup_.identity.vendor = *vendor;
  setup_.identity.model = text("DeviceModelName");
  GError* error = nullptr;
  const char* serial = arv_camera_get_device_serial_number(camera_, &error);
  if (auto read = take_error(&error, "reading the serial number"); !read) return read;
  setup_.identity.serial = serial == nullptr ? "" : serial;
  for (const char* name : kFirmwareNames)
    if (setup_.identity.firmware.empty()) setup_.identity.firmware = text(name);
  const auto kind = [](const CameraIdentity& identity) {
    return identity.vendor + " " + identity.model + " " + identity.serial;
  };
  if (past_ && kind(past_->identity) != kind(setup_.identity))
    return failure(Fault::kNotFound, name_of(settings_) + " is " + kind(setup_.identity) +
                                         ", and no longer " + kind(past_->identity) +
                                         "; connect that one again, or start anew with this one");
  if (settings_.serial.empty() || settings_.serial == setup_.identity.serial) return {};
  return failure(Fault::kNotFound, name_of(settings_) + " has serial number " +
                                       setup_.identity.serial + ", the rig file asks for " +
                                       settings_.serial +
                                       "; correct camera.serial or camera.address");
}

// A program that ended badly may have left the camera running.
Result<void> Setting::stop_whatever_runs() {
  return in_order(
      [&] { return features_.execute("AcquisitionStop"); },
      [&] { return features_.set_text_if_present("SequencerMode", "Off"); },
      [&] { return features_.set_text_if_present("SequencerConfigurationMode", "Off"); },
      [&] { return features_.set_text_if_present("AcquisitionMode", "Continuous"); },
      [&] { return features_.set_text_if_present("ExposureAuto", "Off"); },
      [&] { return features_.set_text_if_present("GainAuto", "Off"); },
      [&] { return features_.keep_text("BalanceWhiteAuto", "Off"); },
      [&] { return features_.keep_text("BlackLevelAuto", "Off"); },
      [&] { return features_.keep_text("TestPattern", "Off"); },
      [&] { return features_.keep_text("TestImageSelector", "Off"); });
}

Result<void> Setting::set_region() {
  const auto set_offset = [&](const char* name, int offset_px, const char* key) {
    return offset_px == 0 && !features_.has(name) ? Result<void>{}
                                                  : set_extent(name, offset_px, key);
  };
  // Offsets first go to zero, so that any width fits.
  const Result<void> result =
      in_order([&] { return set_offset("OffsetX", 0, "offset_x_px"); },
               [&] { return set_offset("OffsetY", 0, "offset_y_px"); },
               [&] { return set_extent("Width", settings_.width_px, "width_px"); },
               [&] { return set_extent("Height", settings_.height_px, "height_px"); },
               [&] { return set_offset("OffsetX", settings_.offset_x_px, "offset_x_px"); },
               [&] { return set_offset("OffsetY", settings_.offset_y_px, "offset_y_px"); });
  setup_.format.width_px = settings_.width_px;
  setup_.format.height_px = settings_.height_px;
  return result;
}

// A number of pixels; `key` is the rig file's.
Result<void> Setting::set_extent(const char* name, int value_px, const char* key) {
  const std::string remedy = std::string("correct camera.") + key + " in the rig file";
  const auto bounds = features_.integer_bounds(name);
  if (bounds && (value_px < bounds->first || value_px > bounds->second))
    return failure(Fault::kOutOfRange, name_of(settings_) + " takes " + name + " from " +
                                           std::to_string(bounds->first) + " to " +
                                           std::to_string(bounds->second) + " px here, not " +
                                           std::to_string(value_px) + "; " + remedy);
  return advising(features_.set_integer(name, value_px), remedy);
}

Result<void> Setting::set_pixel_format() {
  if (!features_.has_entry("PixelFormat", settings_.pixel_format))
    return failure(Fault::kUnsupported, name_of(settings_) + " has no pixel format " +
                                            settings_.pixel_format + " but " +
                                            joined(features_.entries("PixelFormat")) +
                                            "; correct camera.pixel_format in the rig file");
  if (auto set = features_.set_text("PixelFormat", settings_.pixel_format); !set) return set;
  GError* error = nullptr;
  setup_.format.pixel_format_code = arv_camera_get_pixel_format(camera_, &error);
  if (auto read = take_error(&error, "reading PixelFormat"); !read) return read;
  setup_.format.pixel_format = settings_.pixel_format;
  if (setup_.format.bits_per_pixel() % 8 == 0) return {};
  return failure(Fault::kUnsupported, "pixel format " + settings_.pixel_format +
                                          " is packed; choose one of 8 or 16 bits a sample");
}

Result<void> Setting::set_packet_size() {
  GError* error = nullptr;
  int wanted_bytes = settings_.packet_size_bytes;
  if (wanted_bytes == 0) {
    wanted_bytes = static_cast<int>(arv_camera_gv_auto_packet_size(camera_, &error));
    if (auto done = take_error(&error, "negotiating the packet size"); !done) return done;
    // Above the MTU packets are fragmented, which the packet socket cannot put together.
    GSocketAddress* interface =
        arv_gv_device_get_interface_address(ARV_GV_DEVICE(arv_camera_get_device(camera_)));
    if (const auto mtu = interface_mtu(inet_text(interface)))
      wanted_bytes = std::min(wanted_bytes, *mtu);
  }
  constexpr const char* kRemedy =
      "correct camera.packet_size_bytes in the rig file, or leave it out to have it negotiated";
  arv_camera_gv_set_packet_size(camera_, wanted_bytes, &error);
  const std::string what = "setting the packet size to " + std::to_string(wanted_bytes) + " bytes";
  if (auto written = advising(take_error(&error, what), kRemedy); !written) return written;
  setup_.packet_size_bytes = static_cast<int>(arv_camera_gv_get_packet_size(camera_, &error));
  if (auto read = take_error(&error, "reading the packet size"); !read) return read;
  if (settings_.packet_size_bytes == 0 || setup_.packet_size_bytes == wanted_bytes) return {};
  return failure(Fault::kReadBackMismatch,
                 "packet size was set to " + std::to_string(wanted_bytes) + " but reads " +
                     std::to_string(setup_.packet_size_bytes) + "; " + kRemedy);
}

Result<void> Setting::set_chunks() {
  Result<ChunkFeatures> chunks = enable_chunks(features_, settings_);
  if (!chunks) return tl::unexpected(chunks.error());
  setup_.chunks = std::move(*chunks);
  setup_.identity.tells_line_level = !setup_.chunks.line_status.empty();
  return {};
}

// The same as before, if there was a before: what was set since may have changed it.
Result<void> Setting::take_look() {
  Result<CameraLook> look = read_look(features_);
  if (!look) return tl::unexpected(look.error());
  setup_.look = std::move(*look);
  if (!past_) return {};
  const std::optional<std::string> difference = look_difference(past_->look, setup_.look);
  if (!difference) return {};
  return failure(Fault::kReadBackMismatch,
                 name_of(settings_) + " came back changed and does not take what it had: " +
                     *difference + "; set that with its maker's program, or start anew with it");
}

}  // namespace

Result<AravisSetup> set_up(ArvCamera* camera, const CameraSettings& settings,
                           const std::optional<CameraPast>& past) {
  return Setting(camera, settings, past).run();
}

std::string name_of(const CameraSettings& settings) {
  return std::string("the camera at ").append(settings.address);
}

}  // namespace rig
