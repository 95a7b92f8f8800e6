// A USB device as the kernel's usbfs shows it to libusb: sysfs attributes, a node under
// /dev/bus/usb, and the ioctls on it, answered under umockdev. What the device does is a function
// given to it; here are its plug, its packets and its faults.
//
// poll() is the difficulty: libusb waits for POLLOUT on the node, and umockdev's plain file is
// always writable. Our node is a FIFO instead, kept full as long as no URB is done, and drained
// when one is: then it polls as a real node does.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "hw_sim/usb/usb_testbed.h"

namespace hw_sim {

struct UsbSetup {
  std::uint8_t request_type = 0;
  std::uint8_t request = 0;
  std::uint16_t value = 0;
  std::uint16_t index = 0;
  std::uint16_t length = 0;
  bool is_in() const { return (request_type & 0x80) != 0; }
};

struct UsbStall {};
struct UsbNoAnswer {};  // NAK for ever: the host gives up by its own timeout
// Bytes for the host: of an IN request, empty for an OUT request.
using UsbReply = std::variant<std::vector<std::uint8_t>, UsbStall, UsbNoAnswer>;

// Vendor class, one configuration, one interface, one bulk IN endpoint, full speed.
struct UsbDescription {
  std::uint16_t vendor_id = 0;
  std::uint16_t product_id = 0;
  std::uint8_t endpoint_in = 0x81;
  std::size_t packet_bytes = 64;
  std::string manufacturer, product, serial;
};

struct UsbAddress {
  int bus = 1;
  int device = 2;
};

// Thread-safe. Plugged in from construction to unplug(). A client must have closed the device
// before it is destroyed: a client whose device vanishes under an ioctl aborts.
class UsbfsDevice {
 public:
  // Called for vendor requests, on umockdev's thread and without a lock held; must not block, and
  // must not call unplug().
  using Control =
      std::function<UsbReply(const UsbSetup& setup, const std::vector<std::uint8_t>& data)>;

  UsbfsDevice(UsbTestbed& testbed, UsbAddress address, UsbDescription description, Control control);
  ~UsbfsDevice();
  UsbfsDevice(const UsbfsDevice&) = delete;
  UsbfsDevice& operator=(const UsbfsDevice&) = delete;

  // The endpoint sends one packet, as soon as the host asks. A transfer ends with a short packet
  // or when its buffer is full.
  void send(std::vector<std::uint8_t> packet);
  std::size_t waiting_packet_count() const;
  void discard_packets();

  // Every pending transfer comes back, the node and sysfs entry go, the hot-plug event is sent.
  // Final.
  void unplug();

  // Faults. The next IN transfer, if none is pending, ends as a stall.
  void stall_in();
  void refuse_claims(bool is_refusing);  // somebody else's driver holds the interface

 private:
  class Core;
  std::unique_ptr<Core> core_;
};

}  // namespace hw_sim
