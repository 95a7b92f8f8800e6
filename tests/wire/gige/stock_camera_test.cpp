// The production camera class against the distribution's own fake camera (aravis-tools): an
// independent check that the class is not fitted to our device. That camera has no hardware line,
// sequencer, chunks or counters, so it streams by software trigger at one exposure.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <net/if.h>
#include <sched.h>
#include <signal.h>
#include <spawn.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstring>

#include "rig/devices/aravis_camera.h"
#include "rig/event.h"

namespace {

using std::chrono::microseconds;

// A network of this test's own: the stock camera can only have the address of an interface, and
// 127.0.0.1:3956 may be taken. Where that is not permitted, the test shares the host's.
void enter_own_network() {
  if (unshare(CLONE_NEWNET) != 0 && unshare(CLONE_NEWUSER | CLONE_NEWNET) != 0) return;
  ifreq loopback{};
  std::strncpy(loopback.ifr_name, "lo", IFNAMSIZ - 1);
  const int probe = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  loopback.ifr_flags = IFF_UP | IFF_LOOPBACK | IFF_RUNNING;
  ioctl(probe, SIOCSIFFLAGS, &loopback);
  close(probe);
}

// The camera's process; ended with this object.
class StockCamera {
 public:
  StockCamera() {
    std::string program = "arv-fake-gv-camera-0.8";
    std::string interface_flag = "-i";
    std::string interface = "127.0.0.1";
    char* const arguments[] = {program.data(), interface_flag.data(), interface.data(), nullptr};
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
    is_running_ =
        posix_spawnp(&process_, program.c_str(), &actions, nullptr, arguments, environ) == 0;
    posix_spawn_file_actions_destroy(&actions);
  }
  ~StockCamera() {
    if (!is_running_) return;
    kill(process_, SIGTERM);
    waitpid(process_, nullptr, 0);
  }
  StockCamera(const StockCamera&) = delete;
  StockCamera& operator=(const StockCamera&) = delete;
  bool is_running() const { return is_running_; }

 private:
  pid_t process_ = 0;
  bool is_running_ = false;
};

TEST(StockCamera, StreamsBySoftwareTriggerThroughTheProductionClass) {
  enter_own_network();
  const StockCamera stock;
  ASSERT_TRUE(stock.is_running()) << "install aravis-tools (scripts/setup)";
  rig::CameraSettings settings;
  settings.address = "127.0.0.1";
  settings.width_px = 320;
  settings.height_px = 240;
  settings.pixel_format = "Mono8";
  settings.packet_size_bytes = 1500;
  settings.trigger_line = "Software";
  rig::EventQueue queue;
  // Its process takes a moment to bind; each attempt waits for an answer itself.
  auto camera = rig::AravisCamera::open(settings, queue);
  for (int attempt = 0; !camera && attempt < 3; ++attempt)
    camera = rig::AravisCamera::open(settings, queue);
  ASSERT_TRUE(camera.has_value()) << camera.error().detail;
  EXPECT_EQ((*camera)->identity().vendor, "Aravis");
  EXPECT_FALSE((*camera)->identity().serial.empty());

  for (int round = 0; round < 2; ++round) {
    SCOPED_TRACE(round);
    const auto armed = (*camera)->arm({microseconds(5000)}, 4);
    ASSERT_TRUE(armed.has_value()) << armed.error().detail;
    for (std::uint64_t number = 1; number <= 3; ++number) {
      ASSERT_TRUE((*camera)->trigger_software().has_value());
      const auto event = queue.wait(rig::HostClock::now() + std::chrono::seconds(5), {});
      ASSERT_TRUE(event.has_value());
      const auto* arrived = std::get_if<rig::FrameArrived>(&*event);
      ASSERT_NE(arrived, nullptr);
      EXPECT_EQ(arrived->frame.block_id, number);
      EXPECT_EQ(arrived->frame.pixels.size(), 320U * 240U);
      EXPECT_EQ(arrived->frame.exposure, std::nullopt);
      EXPECT_EQ(arrived->frame.trigger_count, std::nullopt);
    }
    const auto counters = (*camera)->counters();
    ASSERT_TRUE(counters.has_value());
    EXPECT_EQ(counters->trigger_count, -1);
    EXPECT_EQ(counters->missed_trigger_count, -1);
    EXPECT_EQ(counters->delivered_frame_count, 3);
    (*camera)->disarm();
  }
  const auto bracketed = (*camera)->arm({microseconds(1000), microseconds(2000)}, 4);
  ASSERT_FALSE(bracketed.has_value());
  EXPECT_EQ(bracketed.error().fault, rig::Fault::kUnsupported);
  EXPECT_NE(bracketed.error().detail.find("Sequencer"), std::string::npos);
}

}  // namespace
