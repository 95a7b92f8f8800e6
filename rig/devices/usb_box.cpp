#include "rig/devices/usb_box.h"

#include <libusb-1.0/libusb.h>

#include <array>
#include <cstdio>
#include <optional>
#include <utility>
#include <vector>

namespace rig {
namespace {

std::string usb_id(const TriggerSettings& settings) {
  std::array<char, 16> text{};
  std::snprintf(text.data(), text.size(), "%04x:%04x", unsigned{settings.vendor_id},
                unsigned{settings.product_id});
  return text.data();
}

std::string place_of(libusb_device* device) {
  return "bus " + std::to_string(libusb_get_bus_number(device)) + " device " +
         std::to_string(libusb_get_device_address(device));
}

Error access_denied(libusb_device* device, const TriggerSettings& settings) {
  return {Fault::kAccessDenied,
          "trigger box " + usb_id(settings) + " at " + place_of(device) +
              " may not be opened by this user: copy config/60-ssrig-trigger-box.rules to "
              "/etc/udev/rules.d, run 'udevadm control --reload', and plug it in again"};
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

// Frees the list of libusb_get_device_list(), devices with it.
class DeviceList {
 public:
  explicit DeviceList(libusb_context* context)
      : count_(libusb_get_device_list(context, &devices_)) {}
  ~DeviceList() {
    if (devices_ != nullptr) libusb_free_device_list(devices_, 1);
  }
  DeviceList(const DeviceList&) = delete;
  DeviceList& operator=(const DeviceList&) = delete;

  std::vector<libusb_device*> of(const TriggerSettings& settings) const {
    std::vector<libusb_device*> found;
    for (ssize_t i = 0; i < count_; ++i) {
      libusb_device_descriptor descriptor{};
      const bool is_readable = libusb_get_device_descriptor(devices_[i], &descriptor) == 0;
      if (is_readable && descriptor.idVendor == settings.vendor_id &&
          descriptor.idProduct == settings.product_id) {
        found.push_back(devices_[i]);
      }
    }
    return found;
  }

 private:
  libusb_device** devices_ = nullptr;
  ssize_t count_;
};

std::string serial_of(libusb_device_handle* handle) {
  libusb_device_descriptor descriptor{};
  if (libusb_get_device_descriptor(libusb_get_device(handle), &descriptor) != 0) return {};
  std::array<unsigned char, 128> text{};
  const int size = libusb_get_string_descriptor_ascii(handle, descriptor.iSerialNumber, text.data(),
                                                      static_cast<int>(text.size()));
  return size > 0 ? std::string(text.begin(), text.begin() + size) : std::string();
}

}  // namespace

void UsbContextExit::operator()(libusb_context* context) const { libusb_exit(context); }
void UsbHandleClose::operator()(libusb_device_handle* handle) const { libusb_close(handle); }
void UsbTransferFree::operator()(libusb_transfer* transfer) const {
  libusb_free_transfer(transfer);
}

Result<UsbContext> start_libusb() {
  libusb_context* context = nullptr;
  const int code = libusb_init(&context);
  if (code != 0) {
    return failure(Fault::kNotFound, std::string("no USB on this computer: ") +
                                         libusb_strerror(code) +
                                         "; are /dev/bus/usb and /sys mounted?");
  }
  return UsbContext(context);
}

Result<UsbBox> find_usb_box(libusb_context* context, const TriggerSettings& settings) {
  const DeviceList list(context);
  const std::vector<libusb_device*> devices = list.of(settings);
  if (devices.empty()) {
    return failure(Fault::kNotFound, "no trigger box " + usb_id(settings) +
                                         " on USB: check its cable and power, and that 'lsusb -d " +
                                         usb_id(settings) + "' lists it");
  }
  std::vector<std::string> serials;
  std::optional<Error> open_error;
  UsbBox match;
  for (libusb_device* device : devices) {
    libusb_device_handle* raw = nullptr;
    const int code = libusb_open(device, &raw);
    if (code != 0) {
      open_error = code == LIBUSB_ERROR_ACCESS
                       ? access_denied(device, settings)
                       : Error{Fault::kDeviceLost, "trigger box at " + place_of(device) +
                                                       " does not open: " + libusb_strerror(code) +
                                                       "; plug it in again"};
      continue;
    }
    UsbBox found{UsbHandle(raw), serial_of(raw)};
    serials.push_back(found.serial.empty() ? "(none)" : found.serial);
    if (settings.serial.empty() || settings.serial == found.serial) match = std::move(found);
  }
  if (settings.serial.empty() && devices.size() > 1) {
    return failure(Fault::kConfiguration,
                   std::to_string(devices.size()) + " trigger boxes " + usb_id(settings) +
                       " on USB (serials " + joined(serials) +
                       "): say in the rig file which one, as trigger.serial");
  }
  if (!match.handle && open_error) return tl::unexpected(*open_error);
  if (!match.handle) {
    return failure(Fault::kNotFound, "no trigger box with serial " + settings.serial +
                                         " on USB, but " + joined(serials) +
                                         ": plug in the right one, or correct trigger.serial in "
                                         "the rig file");
  }
  return match;
}

}  // namespace rig
