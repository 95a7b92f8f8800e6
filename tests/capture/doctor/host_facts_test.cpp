#include "capture/doctor/host_facts.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <string>

#include "capture/doctor/needs.h"
#include "tests/temporary_folder.h"

namespace capture {
namespace {

namespace fs = std::filesystem;

// A host's files in a folder of their own.
class HostFolder {
 public:
  void put(const std::string& name, const std::string& text) const {
    fs::create_directories((path() / name).parent_path());
    std::ofstream(path() / name) << text;
  }
  const fs::path& path() const { return folder_.path(); }
  HostPlaces places() const {
    return {.proc = path() / "proc", .sys = path() / "sys", .dev = path() / "dev"};
  }

 private:
  test_support::TemporaryFolder folder_;
};

rig::RigFile rig_in(const HostFolder& host) {
  rig::RigFile file;
  file.camera.address = "127.43.0.1";
  file.storage.directory = host.path() / "sessions" / "of" / "today";
  return file;
}

// The first 18 bytes of the file: the device descriptor, little-endian.
std::string descriptor(unsigned vendor, unsigned product) {
  std::string bytes(18, '\0');
  bytes[0] = 18;
  bytes[1] = 1;
  bytes[8] = static_cast<char>(vendor & 255U);
  bytes[9] = static_cast<char>(vendor >> 8U);
  bytes[10] = static_cast<char>(product & 255U);
  bytes[11] = static_cast<char>(product >> 8U);
  return bytes;
}

TEST(HostFacts, AreReadFromTheKernelsFiles) {
  const HostFolder host;
  host.put("proc/sys/net/core/rmem_max", "212992\n");
  host.put("proc/meminfo", "MemTotal:  16000000 kB\nMemFree: 1 kB\nMemAvailable:  2000 kB\n");
  host.put("proc/self/status", "Name:\tssrig\nCapEff:\t0000000000800000\n");
  host.put("sys/class/net/lo/speed", "2500\n");
  host.put("sys/bus/usb/devices/1-1/descriptors", descriptor(0x1209, 0x0001));
  host.put("sys/bus/usb/devices/1-1/serial", "A1\n");
  host.put("sys/bus/usb/devices/1-1/busnum", "1\n");
  host.put("sys/bus/usb/devices/1-1/devnum", "14\n");
  host.put("sys/bus/usb/devices/1-2/descriptors", descriptor(0x046d, 0x0001));
  host.put("dev/bus/usb/001/014", "");
  const HostFacts facts = read_host(rig_in(host), host.places());
  EXPECT_EQ(facts.receive_buffer_limit_bytes, 212992U);
  EXPECT_EQ(facts.available_memory_bytes, 2000U * 1024);
  EXPECT_EQ(facts.realtime_priority_limit, 99);
  ASSERT_TRUE(facts.camera_interface);
  EXPECT_EQ(facts.camera_interface->name, "lo");
  EXPECT_GT(facts.camera_interface->mtu_bytes, 0);
  EXPECT_EQ(facts.camera_interface->speed_mbit, 2500);
  EXPECT_TRUE(facts.camera_interface->has_carrier);
  EXPECT_TRUE(facts.camera_interface->is_on_subnet);
  ASSERT_EQ(facts.trigger_boxes.size(), 1U);
  EXPECT_EQ(facts.trigger_boxes[0].serial, "A1");
  EXPECT_EQ(facts.trigger_boxes[0].node, host.path() / "dev/bus/usb/001/014");
  EXPECT_TRUE(facts.trigger_boxes[0].is_permitted);
}

TEST(HostFacts, StorageIsTheNearestFolderThatExistsAndNothingIsMade) {
  const HostFolder host;
  host.put("sessions/earlier", "");
  const HostFacts facts = read_host(rig_in(host), host.places());
  EXPECT_EQ(facts.storage, host.path() / "sessions");
  EXPECT_TRUE(facts.is_storage_writable);
  EXPECT_GT(facts.storage_free_bytes.value_or(0), 0U);
  EXPECT_FALSE(fs::exists(host.path() / "sessions" / "of"));
}

TEST(HostFacts, WhatCannotBeReadIsUnknown) {
  const HostFolder host;
  host.put("proc/sys/net/core/rmem_max", "many\n");
  host.put("sys/bus/usb/devices/1-1/descriptors", "\x12");
  rig::RigFile rig_file = rig_in(host);
  rig_file.camera.address = "Basler-21345678";
  const HostFacts facts = read_host(rig_file, host.places());
  EXPECT_FALSE(facts.receive_buffer_limit_bytes);
  EXPECT_FALSE(facts.available_memory_bytes);
  EXPECT_FALSE(facts.camera_interface);
  EXPECT_TRUE(facts.trigger_boxes.empty());
}

TEST(HostFacts, ABoxThatThisUserMayNotOpenIsSeenAllTheSame) {
  const HostFolder host;
  host.put("sys/bus/usb/devices/2-1/descriptors", descriptor(0x1209, 0x0001));
  host.put("sys/bus/usb/devices/2-1/busnum", "2\n");
  host.put("sys/bus/usb/devices/2-1/devnum", "3\n");
  const HostFacts facts = read_host(rig_in(host), host.places());
  ASSERT_EQ(facts.trigger_boxes.size(), 1U);
  EXPECT_FALSE(facts.trigger_boxes[0].is_permitted);
}

// Stock Debian: a capture says what the doctor says.
TEST(HostWarnings, ACaptureNamesTheSocketLimitAndItsCommand) {
  const HostFolder host;
  host.put("proc/sys/net/core/rmem_max", "212992\n");
  rig::RigFile rig_file = rig_in(host);
  rig_file.camera.width_px = 2352;
  rig_file.camera.height_px = 1726;
  rig_file.camera.pixel_format = "BayerRG12";
  rig_file.sequence.exposures = {std::chrono::microseconds(1000)};
  const std::vector<std::string> warnings = host_warnings(rig_file, host.places());
  ASSERT_EQ(warnings.size(), 1U);
  EXPECT_THAT(warnings[0], testing::HasSubstr("a frame has 8119104"));
  EXPECT_THAT(warnings[0], testing::HasSubstr("sysctl -w net.core.rmem_max=33554432"));
  host.put("proc/sys/net/core/rmem_max", "33554432\n");
  EXPECT_TRUE(host_warnings(rig_file, host.places()).empty());
}

}  // namespace
}  // namespace capture
