// What this host offers a rig, read from the kernel's files and without touching a device.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "rig/rig_file.h"

namespace capture {

// Where the kernel's files are; another folder shows what another host says.
struct HostPlaces {
  std::filesystem::path proc = "/proc";
  std::filesystem::path sys = "/sys";
  std::filesystem::path dev = "/dev";
};

// The network interface that packets to the camera leave by.
struct CameraInterface {
  std::string name;           // "enp3s0"
  bool is_on_subnet = false;  // the camera's address is one of its network; else by a gateway
  bool has_carrier = false;
  int mtu_bytes = 0;   // 0: unknown
  int speed_mbit = 0;  // per second; 0: unknown (loopback, virtual)
};

// A USB device with the trigger box's vendor and product id.
struct UsbDevice {
  std::string serial;          // empty where the kernel has not read it
  std::filesystem::path node;  // "/dev/bus/usb/001/004"
  bool is_permitted = false;   // this user may open it
};

struct HostFacts {
  std::optional<std::uint64_t> receive_buffer_limit_bytes;  // net.core.rmem_max
  std::optional<CameraInterface> camera_interface;          // nullopt: no route, or no IPv4 address
  std::vector<UsbDevice> trigger_boxes;
  std::optional<std::uint64_t> available_memory_bytes;
  std::filesystem::path storage;                    // nearest folder that exists
  std::optional<std::uint64_t> storage_free_bytes;  // nullopt: cannot be told
  bool is_storage_writable = false;
  int realtime_priority_limit = 0;  // 99 where the user may have any
};

HostFacts read_host(const rig::RigFile& rig_file, const HostPlaces& places = {});

}  // namespace capture
