// The daemon's API over real HTTP, with a session thread of the test's own behind the desk.
#include <gmock/gmock.h>
#include <httplib.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>
#include <vector>

#include "capture/daemon/daemon_client.h"
#include "capture/daemon/http_server.h"

namespace capture {
namespace {

using std::chrono::seconds;
using std::chrono::steady_clock;
using testing::HasSubstr;

// Captures whatever is asked for; each lasts until finish() or until it is aborted.
class Rig {
 public:
  Rig() {
    board.update([](DaemonSnapshot& snapshot) {
      snapshot.phase = DaemonPhase::kReady;
      snapshot.rig_file = "/rigs/a.toml";
    });
    server = *HttpServer::start(0, board, desk);
    session_ = std::jthread([this](const std::stop_token& stop) { work(stop); });
  }

  void finish() { is_finishing_ = true; }
  httplib::Client client() const { return httplib::Client("127.0.0.1", server->port()); }
  httplib::Result post(const std::string& path, const std::string& body,
                       const httplib::Headers& headers = {}) const {
    return client().Post(path, headers, body, "application/json");
  }
  DaemonSnapshot wait_for(DaemonPhase phase) const {
    DaemonSnapshot snapshot = board.snapshot();
    while (snapshot.phase != phase) {
      const auto next = board.wait_beyond(snapshot.revision, steady_clock::now() + seconds(30), {});
      if (!next) {
        ADD_FAILURE() << "never " << to_string(phase);
        break;
      }
      snapshot = *next;
    }
    return snapshot;
  }

  StateBoard board;
  CommandDesk desk{board};
  std::atomic<int> capture_count{0};
  std::filesystem::path session_folder;
  std::unique_ptr<HttpServer> server;

 private:
  void work(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      const auto request = desk.next_capture(steady_clock::now() + seconds(1), stop);
      if (!request) continue;
      ++capture_count;
      board.update([&](DaemonSnapshot& snapshot) {
        snapshot.phase = DaemonPhase::kCapturing;
        snapshot.request_id = request->request_id;
        snapshot.slots_total = 176;
      });
      const std::stop_token abort = desk.capture_stop();
      while (!is_finishing_ && !abort.stop_requested() && !stop.stop_requested())
        std::this_thread::yield();
      is_finishing_ = false;
      const bool is_aborted = abort.stop_requested();
      desk.capture_finished();
      board.update([&](DaemonSnapshot& snapshot) {
        snapshot.phase = DaemonPhase::kReady;
        snapshot.last = CaptureOutcome{.request_id = request->request_id,
                                       .session = session_folder.string(),
                                       .state = is_aborted ? "aborted" : "complete",
                                       .exit_code = is_aborted ? 130 : 0,
                                       .message = is_aborted ? "aborted" : "176 of 176 frames",
                                       .pictures = {"report/sigma_a.png"},
                                       .notes = {"no row patterns"}};
      });
    }
  }

  std::atomic<bool> is_finishing_{false};
  std::jthread session_;
};

TEST(Daemon, StateIsOneSnapshotWithARevision) {
  Rig rig;
  const auto response = rig.client().Get("/api/state");
  ASSERT_TRUE(response);
  const auto state = nlohmann::json::parse(response->body);
  EXPECT_EQ(state["phase"], "ready");
  EXPECT_EQ(state["revision"], 1);
  EXPECT_EQ(response->get_header_value("Cache-Control"), "no-store");
}

TEST(Daemon, TheSameRequestTwiceIsOneCapture) {
  Rig rig;
  EXPECT_EQ(rig.post("/api/capture", R"({"request_id":"a"})")->status, 202);
  rig.wait_for(DaemonPhase::kCapturing);
  EXPECT_EQ(rig.post("/api/capture", R"({"request_id":"a"})")->status, 202);
  rig.finish();
  rig.wait_for(DaemonPhase::kReady);
  EXPECT_EQ(rig.post("/api/capture", R"({"request_id":"a"})")->status, 202);
  EXPECT_EQ(rig.capture_count, 1);
}

TEST(Daemon, AnotherCaptureMeanwhileIsRefusedAndMayBeAskedAgain) {
  Rig rig;
  ASSERT_EQ(rig.post("/api/capture", R"({"request_id":"a"})")->status, 202);
  rig.wait_for(DaemonPhase::kCapturing);
  const auto refused = rig.post("/api/capture", R"({"request_id":"b"})");
  EXPECT_EQ(refused->status, 409);
  EXPECT_THAT(refused->body, HasSubstr("under way"));
  rig.finish();
  rig.wait_for(DaemonPhase::kReady);
  EXPECT_EQ(rig.post("/api/capture", R"({"request_id":"b"})")->status, 202);
  rig.wait_for(DaemonPhase::kCapturing);
  EXPECT_EQ(rig.capture_count, 2);
  rig.finish();
}

TEST(Daemon, AbortStopsTheCaptureAndOnlyThat) {
  Rig rig;
  EXPECT_EQ(rig.post("/api/abort", R"({"request_id":"x"})")->status, 409);
  ASSERT_EQ(rig.post("/api/capture", R"({"request_id":"a"})")->status, 202);
  rig.wait_for(DaemonPhase::kCapturing);
  EXPECT_EQ(rig.post("/api/abort", R"({"request_id":"y"})")->status, 202);
  EXPECT_EQ(rig.wait_for(DaemonPhase::kReady).last->state, "aborted");
  ASSERT_EQ(rig.post("/api/capture", R"({"request_id":"b"})")->status, 202);
  rig.wait_for(DaemonPhase::kCapturing);
  EXPECT_EQ(rig.post("/api/abort", R"({"request_id":"y"})")->status, 202)
      << "a repeated abort changes nothing";
  rig.finish();
  EXPECT_EQ(rig.wait_for(DaemonPhase::kReady).last->state, "complete");
}

TEST(Daemon, NotReadyIsSaidWithTheReason) {
  Rig rig;
  rig.board.update([](DaemonSnapshot& snapshot) {
    snapshot.phase = DaemonPhase::kFault;
    snapshot.message = "the camera is gone";
  });
  const auto refused = rig.post("/api/capture", R"({"request_id":"a"})");
  EXPECT_EQ(refused->status, 503);
  EXPECT_THAT(refused->body, HasSubstr("the camera is gone"));
  EXPECT_EQ(rig.client().Get("/readyz")->status, 503);
  EXPECT_EQ(rig.client().Get("/healthz")->status, 200);
}

TEST(Daemon, PagesOfOthersAreRefused) {
  Rig rig;
  const std::string body = R"({"request_id":"a"})";
  EXPECT_EQ(rig.post("/api/capture", body, {{"Origin", "http://evil.example"}})->status, 403);
  EXPECT_EQ(rig.post("/api/capture", body, {{"Host", "evil.example"}})->status, 403);
  EXPECT_EQ(rig.client().Get("/api/state", {{"Host", "rebound.example:80"}})->status, 403);
  EXPECT_EQ(rig.client().Post("/api/capture", body, "text/plain")->status, 415);
  EXPECT_EQ(rig.capture_count, 0);
}

TEST(Daemon, MalformedRequestsAreAnsweredAndHarmless) {
  Rig rig;
  for (const std::string body :
       {"", "{", "[]", "null", "{}", R"({"request_id":7})", R"({"request_id":""})",
        R"({"request_id":"a","sbject":"s"})", R"({"request_id":"a","subject":7})",
        R"({"request_id":"a","directory":"relative"})", "\xff\xfe"}) {
    SCOPED_TRACE(body);
    const auto response = rig.post("/api/capture", body);
    ASSERT_TRUE(response);
    EXPECT_EQ(response->status, 400);
    EXPECT_TRUE(nlohmann::json::parse(response->body).contains("error"));
  }
  EXPECT_EQ(
      rig.post("/api/capture", R"({"request_id":")" + std::string(300, 'x') + R"("})")->status,
      400);
  EXPECT_EQ(rig.post("/api/capture", std::string(100000, ' '))->status, 413);
  EXPECT_EQ(rig.client().Get("/nothing")->status, 404);
  EXPECT_EQ(rig.capture_count, 0);
}

TEST(Daemon, EventsCarryTheStateThenHeartbeats) {
  Rig rig;
  std::string received;
  httplib::Client client = rig.client();
  client.Get("/api/events", [&](const char* data, std::size_t size) {
    received.append(data, size);
    const bool has_state = received.find("event: state") != std::string::npos;
    if (has_state && rig.capture_count == 0 && received.find("heartbeat") != std::string::npos)
      rig.post("/api/capture", R"({"request_id":"a"})");
    return received.find("\"capturing\"") == std::string::npos;
  });
  EXPECT_THAT(received, HasSubstr("id: 1\nevent: state\ndata: {\"revision\":1,"));
  EXPECT_THAT(received, HasSubstr("event: heartbeat"));
  EXPECT_THAT(received, HasSubstr("\"phase\":\"capturing\""));
  rig.finish();
}

TEST(Daemon, OnlyListedPicturesAreServed) {
  Rig rig;
  std::string pattern = (std::filesystem::temp_directory_path() / "ssrig-daemon.XXXXXX").string();
  rig.session_folder = mkdtemp(pattern.data());
  std::filesystem::create_directory(rig.session_folder / "report");
  std::ofstream(rig.session_folder / "report/sigma_a.png") << "picture";
  std::ofstream(rig.session_folder / "session.json") << "secret";
  EXPECT_EQ(rig.client().Get("/api/last/report/sigma_a.png")->status, 404) << "no capture yet";
  ASSERT_EQ(rig.post("/api/capture", R"({"request_id":"a"})")->status, 202);
  rig.wait_for(DaemonPhase::kCapturing);
  rig.finish();
  rig.wait_for(DaemonPhase::kReady);
  EXPECT_EQ(rig.client().Get("/api/last/report/sigma_a.png")->body, "picture");
  for (const char* name : {"session.json", "report/../session.json", "../../etc/passwd", "report/",
                           "%2e%2e/session.json"})
    EXPECT_EQ(rig.client().Get(std::string("/api/last/") + name)->status, 404) << name;
  std::filesystem::remove_all(rig.session_folder);
}

TEST(Daemon, ATakenPortIsAClearError) {
  Rig rig;
  CommandDesk desk(rig.board);
  const auto second = HttpServer::start(rig.server->port(), rig.board, desk);
  ASSERT_FALSE(second.has_value());
  EXPECT_THAT(second.error().detail, HasSubstr("is taken"));
}

TEST(DaemonClient, FindsTheDaemonOfItsRigFileOnly) {
  Rig rig;
  EXPECT_NE(DaemonClient::find(rig.server->port(), "/rigs/a.toml"), nullptr);
  EXPECT_EQ(DaemonClient::find(rig.server->port(), "/rigs/b.toml"), nullptr);
}

TEST(DaemonClient, FollowsACaptureToItsEnd) {
  Rig rig;
  const auto client = DaemonClient::find(rig.server->port(), "/rigs/a.toml");
  ASSERT_TRUE(client->request_capture({.request_id = "a", .subject = "subject"}).is_accepted);
  bool was_seen_capturing = false;
  const auto outcome = client->follow("a",
                                      [&](const DaemonSnapshot& snapshot) {
                                        if (snapshot.phase != DaemonPhase::kCapturing) return;
                                        was_seen_capturing = true;
                                        rig.finish();
                                      },
                                      {});
  ASSERT_TRUE(outcome.has_value());
  EXPECT_TRUE(was_seen_capturing);
  EXPECT_EQ(outcome->state, "complete");
  EXPECT_THAT(outcome->pictures, testing::ElementsAre("report/sigma_a.png"));
  EXPECT_THAT(outcome->notes, testing::ElementsAre("no row patterns"));
}

TEST(DaemonClient, AStopAbortsTheCapture) {
  Rig rig;
  const auto client = DaemonClient::find(rig.server->port(), "/rigs/a.toml");
  ASSERT_TRUE(client->request_capture({.request_id = "a"}).is_accepted);
  std::stop_source stop;
  stop.request_stop();
  const auto outcome = client->follow(
      "a", [](const DaemonSnapshot&) {}, stop.get_token());
  ASSERT_TRUE(outcome.has_value());
  EXPECT_EQ(outcome->exit_code, 130);
}

}  // namespace
}  // namespace capture
