// The operator's day at the rig, from the page, over all the wires: run inside `ssrig-sim run`, it
// starts `ssrig serve`, opens its page in Chromium, captures, looks at the maps, and aborts.
#include <gmock/gmock.h>
#include <signal.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "hw_sim/display/child_process.h"
#include "hw_sim/display/screen_grabber.h"
#include "rig/rig_file.h"
#include "tests/console/browser.h"

namespace console {
namespace {

using std::chrono::seconds;

constexpr auto kCaptureLimit = seconds(240);
constexpr int kAbortCount = 5;

std::string text_of(const char* variable) {
  const char* value = std::getenv(variable);
  return value == nullptr ? "" : value;
}

double wall_clock_ms() {
  return std::chrono::duration<double, std::milli>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

// When the projector's screen was last seen to turn black.
class BlackWatch {
 public:
  BlackWatch() {
    auto started = hw_sim::ScreenGrabber::start(
        {.display = text_of("DISPLAY")}, light_,
        [this](const std::shared_ptr<const hw_sim::Picture>& picture) {
          const bool is_black = std::ranges::all_of(picture->brightness.samples(),
                                                    [](unsigned char value) { return value == 0; });
          black_since_ms_ = is_black ? wall_clock_ms() : 0;
        },
        [](rig::HostTime, int) {});
    EXPECT_TRUE(started) << started.error().detail;
    if (started) grabber_ = std::move(*started);
  }

  // On the wall clock, as the page's click is; zero while it is not black.
  double black_since_ms() const { return black_since_ms_; }

  // The same, given time to grab: on a busy machine the page can be ahead of this process.
  double wait_for_black_ms() const {
    const auto deadline = rig::HostClock::now() + seconds(10);
    while (black_since_ms_ == 0 && rig::HostClock::now() < deadline)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return black_since_ms_;
  }

 private:
  hw_sim::LightTimeline light_;
  std::atomic<double> black_since_ms_{0};
  std::unique_ptr<hw_sim::ScreenGrabber> grabber_;
};

class RigPage : public testing::Test {
 public:
  RigPage() {
    std::filesystem::remove_all(rig_file_->storage.directory);
    auto started = hw_sim::ChildProcess::start(
        {.argv = {SSRIG, "serve", "--rig", RIG_FILE}, .output = "serve.log"});
    EXPECT_TRUE(started) << started.error().detail;
    if (started) daemon_.emplace(std::move(*started));
    httplib::Client client("127.0.0.1", rig_file_->daemon.port);
    const auto deadline = rig::HostClock::now() + seconds(60);
    while (rig::HostClock::now() < deadline) {
      if (const auto answer = client.Get("/readyz"); answer && answer->status == 200) break;
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    browser_.open("http://127.0.0.1:" + std::to_string(rig_file_->daemon.port) + "/");
    EXPECT_TRUE(browser_.wait_until("!document.getElementById('capture').disabled", seconds(30)));
  }

  // SIGTERM is the daemon's ordinary end.
  ~RigPage() override {
    if (!daemon_) return;
    daemon_->send(SIGTERM);
    EXPECT_EQ(daemon_->wait(rig::HostClock::now() + seconds(30)), 0)
        << "the daemon ends with 0 on SIGTERM";
  }

 protected:
  void press_capture_and_wait_for(int slot_count) {
    ASSERT_TRUE(browser_.wait_until("!document.getElementById('capture').disabled", seconds(60)));
    browser_.click("#capture");
    ASSERT_TRUE(browser_.wait_until(
        "state.phase === 'capturing' && state.slots_filled >= " + std::to_string(slot_count),
        kCaptureLimit))
        << browser_.value_of("state");
  }

  rig::Result<rig::RigFile> rig_file_ = rig::read_rig_file(RIG_FILE);
  std::optional<hw_sim::ChildProcess> daemon_;
  Browser browser_;
};

TEST_F(RigPage, CaptureShowsProgressAndThenTheMaps) {
  press_capture_and_wait_for(1);
  EXPECT_TRUE(browser_.wait_until(
      "document.getElementById('count').textContent.includes('of 176 frames')", seconds(5)));
  browser_.save_screenshot("page_capturing.png");
  ASSERT_TRUE(browser_.wait_until("state.phase === 'ready' && state.last !== null", kCaptureLimit))
      << browser_.value_of("state");
  EXPECT_EQ(browser_.value_of("state.last.state"), "complete")
      << browser_.value_of("state.last.message");
  ASSERT_TRUE(browser_.wait_until(
      "[...document.querySelectorAll('#pictures img')].length > 4 && "
      "[...document.querySelectorAll('#pictures img')].every(i => i.naturalWidth > 100)",
      seconds(30)));
  browser_.save_screenshot("page_finished.png");
  const std::filesystem::path session = browser_.value_of("state.last.session").get<std::string>();
  EXPECT_TRUE(std::filesystem::exists(session / "maps" / "sigma_a.exr"));
}

TEST_F(RigPage, CommandLineAsksTheDaemonThatHoldsTheRig) {
  auto command = hw_sim::ChildProcess::start(
      {.argv = {SSRIG, "capture", "--rig", RIG_FILE, "--subject", "cli"}, .output = "capture.log"});
  ASSERT_TRUE(command) << command.error().detail;
  EXPECT_TRUE(browser_.wait_until("state.phase === 'capturing'", seconds(60)))
      << "the page follows";
  EXPECT_EQ(command->wait(rig::HostClock::now() + kCaptureLimit), 0);
  ASSERT_TRUE(browser_.wait_until("state.last !== null", seconds(10)));
  EXPECT_TRUE(browser_.value_of("state.last.session").get<std::string>().ends_with("-cli"));
  EXPECT_EQ(browser_.value_of("state.last.state"), "complete");
}

TEST_F(RigPage, AbortTurnsTheScreenBlackAndTheNextCaptureStarts) {
  BlackWatch watch;
  browser_.value_of(
      "document.getElementById('abort').addEventListener('click', () => "
      "{ window.clicked_ms = performance.timeOrigin + performance.now(); }, true)");
  std::vector<double> delays_ms;
  for (int i = 0; i < kAbortCount; ++i) {
    press_capture_and_wait_for(10 + 7 * i);
    EXPECT_EQ(watch.black_since_ms(), 0) << "the screen is black while patterns are shown";
    browser_.click("#abort");
    ASSERT_TRUE(browser_.wait_until("state.last !== null && state.phase === 'ready'", seconds(60)));
    EXPECT_EQ(browser_.value_of("state.last.state"), "aborted");
    const double black_ms = watch.wait_for_black_ms();
    ASSERT_NE(black_ms, 0) << "the screen is not black after an abort";
    delays_ms.push_back(black_ms - browser_.value_of("window.clicked_ms").get<double>());
    browser_.value_of("(state.last = null)");
  }
  std::ranges::sort(delays_ms);
  std::printf(
      "abort: from the click in the page to a black screen: median %.1f ms, %.1f to %.1f ms, %d "
      "aborts\n",
      delays_ms[delays_ms.size() / 2], delays_ms.front(), delays_ms.back(), kAbortCount);
}

}  // namespace
}  // namespace console
