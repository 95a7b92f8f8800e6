#include "capture/doctor/doctor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace capture {
namespace {

using testing::AllOf;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

rig::RigFile rig_file() {
  rig::RigFile file;
  file.camera.address = "192.168.1.10";
  file.camera.width_px = 2352;
  file.camera.height_px = 1726;
  file.projector.monitor = "HDMI-1";
  return file;
}

// A host without fault.
HostFacts sound_host() {
  HostFacts host;
  host.receive_buffer_limit_bytes = 33'554'432;
  host.camera_interface = CameraInterface{.name = "enp3s0",
                                          .is_on_subnet = true,
                                          .has_carrier = true,
                                          .mtu_bytes = 9000,
                                          .speed_mbit = 1000};
  host.trigger_boxes = {{.serial = "A1", .node = "/dev/bus/usb/001/004", .is_permitted = true}};
  host.available_memory_bytes = 8'000'000'000;
  host.storage = "/data";
  host.storage_free_bytes = 100'000'000'000;
  host.is_storage_writable = true;
  host.realtime_priority_limit = 99;
  return host;
}

const CaptureNeeds kNeeds{
    .frame_count = 176, .frame_bytes = 8'119'104, .storage_bytes = 2'000'000'000};

std::vector<MonitorFacts> monitors() {
  return {{"DP-1", 2560, 1440, 144}, {"HDMI-1", 1024, 768, 60}};
}

auto is(Health health, const char* text, const char* remedy) {
  return AllOf(Field(&HostFinding::health, health), Field(&HostFinding::text, HasSubstr(text)),
               Field(&HostFinding::remedy, HasSubstr(remedy)));
}

TEST(Doctor, AHostWithoutFaultNeedsNothing) {
  const auto findings = examine(rig_file(), sound_host(), monitors(), kNeeds);
  EXPECT_EQ(findings.size(), 7U);
  for (const HostFinding& finding : findings) {
    EXPECT_EQ(finding.health, Health::kOk) << finding.subject << ": " << finding.text;
    EXPECT_THAT(finding.remedy, IsEmpty());
    EXPECT_THAT(finding.text, Not(IsEmpty()));
  }
  EXPECT_EQ(worst_of(findings), Health::kOk);
}

TEST(Doctor, StockDebianSocketLimitsAreAWarningWithTheCommand) {
  HostFacts host = sound_host();
  host.receive_buffer_limit_bytes = 212'992;
  EXPECT_THAT(check_receive_buffer(host, kNeeds),
              is(Health::kWarning, "212992", "sudo sysctl -w net.core.rmem_max=33554432"));
  EXPECT_EQ(worst_of(examine(rig_file(), host, monitors(), kNeeds)), Health::kWarning);
}

TEST(Doctor, ABufferThatHoldsTheDriversWishSufficesForAnyFrame) {
  HostFacts host = sound_host();
  host.receive_buffer_limit_bytes = 16 << 20;
  const CaptureNeeds large{.frame_count = 1, .frame_bytes = 100'000'000, .storage_bytes = 1};
  EXPECT_EQ(check_receive_buffer(host, large).health, Health::kOk);
}

TEST(Doctor, TheCamerasNetworkIsJudgedByLinkSubnetAndMtu) {
  rig::CameraSettings camera = rig_file().camera;
  HostFacts host = sound_host();
  host.camera_interface->mtu_bytes = 1500;
  EXPECT_THAT(check_camera_interface(host, camera),
              is(Health::kWarning, "1500", "sudo ip link set dev enp3s0 mtu 9000"));
  camera.packet_size_bytes = 8000;
  EXPECT_THAT(check_camera_interface(host, camera),
              is(Health::kFailure, "8000 bytes do not fit", "mtu 8000"));
  host.camera_interface->is_on_subnet = false;
  EXPECT_THAT(check_camera_interface(host, camera),
              is(Health::kFailure, "gateway", "ip address add"));
  host.camera_interface->has_carrier = false;
  EXPECT_THAT(check_camera_interface(host, camera), is(Health::kFailure, "no link", "cable"));
  host.camera_interface.reset();
  EXPECT_THAT(check_camera_interface(host, camera),
              is(Health::kFailure, "192.168.1.10", "camera.address"));
  host = sound_host();
  host.camera_interface->speed_mbit = 100;
  EXPECT_THAT(check_camera_interface(host, rig_file().camera),
              is(Health::kWarning, "100 Mbit/s", "cable"));
}

TEST(Doctor, ATriggerBoxIsThereAloneAndPermitted) {
  rig::TriggerSettings trigger;
  HostFacts host = sound_host();
  host.trigger_boxes.front().is_permitted = false;
  EXPECT_THAT(check_trigger_box(host, trigger),
              is(Health::kFailure, "/dev/bus/usb/001/004", "60-ssrig-trigger-box.rules"));
  host = sound_host();
  host.trigger_boxes.push_back(
      {.serial = "B2", .node = "/dev/bus/usb/001/005", .is_permitted = true});
  EXPECT_THAT(check_trigger_box(host, trigger),
              is(Health::kFailure, "2 trigger boxes", "trigger.serial"));
  trigger.serial = "B2";
  EXPECT_THAT(check_trigger_box(host, trigger), is(Health::kOk, "/dev/bus/usb/001/005", ""));
  trigger.serial = "C3";
  EXPECT_THAT(check_trigger_box(host, trigger), is(Health::kFailure, "C3", "lsusb -d 1209:0001"));
}

TEST(Doctor, ARigWithoutATriggerBoxNeedsNone) {
  rig::RigFile boxless = rig_file();
  boxless.sequence.sync = rig::SyncMode::kCameraLine;
  HostFacts host = sound_host();
  host.trigger_boxes.clear();
  for (const HostFinding& finding : examine(boxless, host, monitors(), kNeeds))
    EXPECT_EQ(finding.health, Health::kOk) << finding.subject << ": " << finding.text;
}

TEST(Doctor, TheProjectorIsThereInTheRigFilesMode) {
  rig::ProjectorSettings projector = rig_file().projector;
  auto seen = monitors();
  seen[1].refresh_hz = 0;
  EXPECT_THAT(check_monitor(seen, projector), is(Health::kWarning, "unknown rate", "xrandr"));
  projector.width_px = 1280;
  EXPECT_THAT(check_monitor(seen, projector),
              is(Health::kFailure, "1280 x 768", "xrandr --output HDMI-1 --mode 1280x768"));
  projector.monitor = "VGA-1";
  EXPECT_THAT(check_monitor(seen, projector),
              is(Health::kFailure, "DP-1, HDMI-1", "projector.monitor"));
  const rig::Result<std::vector<MonitorFacts>> no_server =
      rig::failure(rig::Fault::kNotFound, "the X server cannot be reached");
  EXPECT_THAT(check_monitor(no_server, projector), is(Health::kFailure, "X server", "DISPLAY"));
}

TEST(Doctor, StorageHoldsACaptureAndSomeMore) {
  HostFacts host = sound_host();
  host.storage_free_bytes = 1'999'000'000;
  EXPECT_THAT(check_storage_space(host, kNeeds), is(Health::kFailure, "2000 MB", "make room"));
  host.storage_free_bytes = 5'000'000'000;
  EXPECT_THAT(check_storage_space(host, kNeeds),
              is(Health::kWarning, "room for 2", "du -sh /data"));
  host.is_storage_writable = false;
  EXPECT_THAT(check_storage_space(host, kNeeds), is(Health::kFailure, "/data", "chown"));
}

TEST(Doctor, MemoryHoldsEveryFrameOfACapture) {
  HostFacts host = sound_host();
  host.available_memory_bytes = 1'000'000'000;
  EXPECT_THAT(check_memory(host, kNeeds), is(Health::kFailure, "184 frame buffers", "width_px"));
}

TEST(Doctor, AnOrdinaryUsersReceiverGoesBeforeNobody) {
  HostFacts host = sound_host();
  host.realtime_priority_limit = 0;
  EXPECT_THAT(check_priority(host), is(Health::kWarning, "as any thread", "setcap cap_sys_nice"));
}

}  // namespace
}  // namespace capture
