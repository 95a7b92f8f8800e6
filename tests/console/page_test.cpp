// The operator's page in a real browser, with a session thread of the test's own behind the API.
#include <gmock/gmock.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <thread>

#include "capture/daemon/http_server.h"
#include "tests/console/browser.h"
#include "tests/temporary_folder.h"

namespace console {
namespace {

using capture::CaptureOutcome;
using capture::DaemonPhase;
using capture::DaemonSnapshot;
using std::chrono::seconds;
using std::chrono::steady_clock;

constexpr auto kLimit = seconds(30);

class Page : public testing::Test {
 protected:
  Page() {
    board_.update([](DaemonSnapshot& snapshot) {
      snapshot.phase = DaemonPhase::kReady;
      snapshot.rig_name = "virtual rig";
      snapshot.message = "Press capture.";
      snapshot.notes = {"DUMMY1: 60.0 Hz, interval 16.67 ms +- 0.10 ms"};
    });
    server_ = *capture::HttpServer::start(0, board_, desk_);
    browser_.open("http://127.0.0.1:" + std::to_string(server_->port()) + "/");
  }

  bool page_shows(const std::string& expression) { return browser_.wait_until(expression, kLimit); }

  capture::StateBoard board_;
  capture::CommandDesk desk_{board_};
  std::unique_ptr<capture::HttpServer> server_;
  Browser browser_;
};

TEST_F(Page, WarnsOfFlickerBeforeAnythingElse) {
  EXPECT_TRUE(page_shows(
      "document.querySelector('.warning').innerText.includes('photosensitive epilepsy')"));
}

TEST_F(Page, CaptureIsOneClickWithTheSubject) {
  ASSERT_TRUE(page_shows("!document.getElementById('capture').disabled"));
  browser_.type("#subject", "Ada");
  browser_.click("#capture");
  const auto request = desk_.next_capture(steady_clock::now() + kLimit, {});
  ASSERT_TRUE(request.has_value());
  EXPECT_EQ(request->subject, "Ada");
}

TEST_F(Page, ShowsProgressThenThePictures) {
  const test_support::TemporaryFolder folder;
  const std::filesystem::path& session = folder.path();
  // A 1 x 1 px PNG.
  const unsigned char png[] = {137, 80, 78,  71,  13, 10, 26,  10,  0,   0,   0,   13,  73,  72,
                               68,  82, 0,   0,   0,  1,  0,   0,   0,   1,   8,   0,   0,   0,
                               0,   58, 126, 155, 85, 0,  0,   0,   10,  73,  68,  65,  84,  120,
                               156, 99, 104, 0,   0,  0,  130, 0,   129, 119, 205, 114, 182, 0,
                               0,   0,  0,   73,  69, 78, 68,  174, 66,  96,  130};
  std::ofstream(session / "sigma_a.png", std::ios::binary)
      .write(reinterpret_cast<const char*>(png), sizeof png);
  board_.update([](DaemonSnapshot& snapshot) {
    snapshot.phase = DaemonPhase::kCapturing;
    snapshot.slots_filled = 44;
    snapshot.slots_total = 176;
  });
  EXPECT_TRUE(page_shows("document.getElementById('count').textContent === '44 of 176 frames'"));
  EXPECT_TRUE(page_shows("document.getElementById('progress').value === 44"));
  EXPECT_TRUE(page_shows("document.getElementById('capture').disabled"));
  board_.update([&](DaemonSnapshot& snapshot) {
    snapshot.phase = DaemonPhase::kReady;
    snapshot.last = CaptureOutcome{.request_id = "a",
                                   .session = session.string(),
                                   .state = "complete",
                                   .exit_code = 0,
                                   .message = "176 of 176 frames",
                                   .pictures = {"sigma_a.png"},
                                   .notes = {}};
  });
  EXPECT_TRUE(
      page_shows("document.querySelector('#pictures img') && document.querySelector('#pictures "
                 "img').naturalWidth === 1"));
  EXPECT_TRUE(page_shows("document.querySelector('figcaption').textContent === 'sigma a'"));
}

TEST_F(Page, AbortIsOneClickWithoutAQuestion) {
  ASSERT_TRUE(page_shows("!document.getElementById('capture').disabled"));
  EXPECT_EQ(browser_.value_of("document.getElementById('abort').disabled"), true);
  browser_.click("#capture");
  ASSERT_TRUE(desk_.next_capture(steady_clock::now() + kLimit, {}).has_value());
  board_.update([](DaemonSnapshot& snapshot) { snapshot.phase = DaemonPhase::kCapturing; });
  ASSERT_TRUE(page_shows("!document.getElementById('abort').disabled"));
  browser_.click("#abort");
  EXPECT_TRUE(page_shows("document.getElementById('phase').textContent === 'Aborting'"));
  EXPECT_TRUE(desk_.capture_stop().stop_requested());
}

TEST_F(Page, SaysWhyTheRigCannotCapture) {
  board_.update([](DaemonSnapshot& snapshot) {
    snapshot.phase = DaemonPhase::kFault;
    snapshot.message = "camera <b>127.0.0.1</b> does not answer";
  });
  EXPECT_TRUE(
      page_shows("document.getElementById('message').textContent.includes('<b>127.0.0.1</b>')"))
      << "text is shown as text, never as markup";
  EXPECT_EQ(browser_.value_of("document.getElementById('capture').disabled"), true);
}

TEST_F(Page, GreysOutWhenTheDaemonFallsSilent) {
  ASSERT_TRUE(page_shows("!document.getElementById('capture').disabled"));
  server_.reset();
  EXPECT_TRUE(page_shows("document.body.classList.contains('stale')"));
  EXPECT_EQ(browser_.value_of("document.getElementById('capture').disabled"), true);
}

}  // namespace
}  // namespace console
