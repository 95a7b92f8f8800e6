// Which of the devices on USB is the trigger box, and what libusb hands out, each freed by its
// owner.
#pragma once

#include <memory>
#include <string>

#include "rig/fault.h"
#include "rig/trigger.h"

struct libusb_context;
struct libusb_device_handle;
struct libusb_transfer;

namespace rig {

struct UsbContextExit {
  void operator()(libusb_context* context) const;
};
struct UsbHandleClose {
  void operator()(libusb_device_handle* handle) const;
};
struct UsbTransferFree {
  void operator()(libusb_transfer* transfer) const;
};
using UsbContext = std::unique_ptr<libusb_context, UsbContextExit>;
using UsbHandle = std::unique_ptr<libusb_device_handle, UsbHandleClose>;
using UsbTransfer = std::unique_ptr<libusb_transfer, UsbTransferFree>;

// Errors: kNotFound on a computer without USB.
Result<UsbContext> start_libusb();

// A box that is open, but not claimed. The context outlives it.
struct UsbBox {
  UsbHandle handle;
  std::string serial;  // empty if it has none
};

// The box of these ids, and of this serial if one is wanted. Errors: kNotFound; kConfiguration
// (several boxes and no serial); kAccessDenied (permissions); kDeviceLost (it does not open).
Result<UsbBox> find_usb_box(libusb_context* context, const TriggerSettings& settings);

}  // namespace rig
