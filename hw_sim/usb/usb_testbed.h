// The machine that simulated USB devices are plugged into: an umockdev testbed, a folder that
// stands for /sys and /dev in every process that has the umockdev preload library.
//
// This process needs that library too, linked in first (CMake target umockdev_preload), and so do
// the children that shall see the devices, by child_environment().
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "rig/fault.h"

// NOLINTNEXTLINE(bugprone-reserved-identifier): the name that umockdev gave it
struct _UMockdevTestbed;

namespace hw_sim {

// One in a process at a time. It outlives every device on it; those outlive every client that has
// them open. Thread-safe.
class UsbTestbed {
 public:
  // Errors: kUnsupported without the preload library.
  static rig::Result<std::unique_ptr<UsbTestbed>> open();
  ~UsbTestbed();
  UsbTestbed(const UsbTestbed&) = delete;
  UsbTestbed& operator=(const UsbTestbed&) = delete;

  // Variables to set in a child before exec(), with what this process already has in them.
  std::vector<std::pair<std::string, std::string>> child_environment() const;

  const std::string& root() const { return root_; }
  _UMockdevTestbed* get() const { return testbed_; }

 private:
  UsbTestbed();

  _UMockdevTestbed* testbed_;
  std::string root_;
};

}  // namespace hw_sim
