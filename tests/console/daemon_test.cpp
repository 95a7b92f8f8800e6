// The daemon's API over real HTTP, with a session thread of the test's own behind the desk.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <httplib.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>
#include <vector>

#include "capture/daemon/daemon_client.h"
#include "capture/daemon/http_server.h"
#include "tests/temporary_folder.h"

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

// A client that says and leaves out what it likes.
class RawClient {
 public:
  explicit RawClient(int port) : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const timeval patience{.tv_sec = 30, .tv_usec = 0};
    ::setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    EXPECT_EQ(::connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  }
  ~RawClient() { ::close(socket_); }
  RawClient(const RawClient&) = delete;
  RawClient& operator=(const RawClient&) = delete;

  // What the server makes of it does not matter: it may have hung up.
  void send(const std::string& text) const {
    (void)::send(socket_, text.data(), text.size(), MSG_NOSIGNAL);
  }
  // What comes, until it holds `end` or the server hangs up.
  std::string receive_until(const std::string& end) const {
    std::string received;
    std::array<char, 4096> part{};
    while (received.find(end) == std::string::npos) {
      const ssize_t size = ::recv(socket_, part.data(), part.size(), 0);
      if (size <= 0) break;
      received.append(part.data(), static_cast<std::size_t>(size));
    }
    return received;
  }

 private:
  int socket_;
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
  for (const auto& [status, response] :
       {std::pair(413, rig.post("/api/capture", std::string(100000, ' '))),
        std::pair(404, rig.client().Get("/nothing"))}) {
    ASSERT_TRUE(response);
    EXPECT_EQ(response->status, status);
    EXPECT_TRUE(nlohmann::json::parse(response->body).contains("error")) << response->body;
  }
  EXPECT_EQ(rig.capture_count, 0);
}

// Else the page of another site would write a request, headers and all, into a body of its own.
TEST(Daemon, TheBodyOfARefusedRequestIsNoRequest) {
  Rig rig;
  const std::string host = "Host: 127.0.0.1:" + std::to_string(rig.server->port()) + "\r\n";
  const std::string command = R"({"request_id":"hidden"})";
  const std::string body =
      "POST /api/capture HTTP/1.1\r\n" + host +
      "Content-Type: application/json\r\nContent-Length: " + std::to_string(command.size()) +
      "\r\n\r\n" + command;
  const RawClient page(rig.server->port());
  page.send("POST /api/state HTTP/1.1\r\n" + host +
            "Origin: http://evil.example\r\nContent-Type: text/plain\r\nContent-Length: " +
            std::to_string(body.size()) + "\r\n\r\n");
  EXPECT_THAT(page.receive_until("}"), HasSubstr("HTTP/1.1 403"));
  page.send(body);
  EXPECT_EQ(page.receive_until("HTTP/1.1 202"), "") << "hung up before the body came";
  EXPECT_EQ(rig.capture_count, 0);
}

TEST(Daemon, ABodyWithoutALengthIsRefused) {
  Rig rig;
  const auto response = rig.client().Post(
      "/api/capture", {},
      [](std::size_t, httplib::DataSink& sink) {
        const std::string command = R"({"request_id":"a"})";
        sink.write(command.data(), command.size());
        sink.done();
        return true;
      },
      "application/json");
  ASSERT_TRUE(response);
  EXPECT_EQ(response->status, 411);
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

TEST(Daemon, PagesThatWereClosedMakeRoomForOthers) {
  Rig rig;
  const std::string host = "Host: 127.0.0.1:" + std::to_string(rig.server->port()) + "\r\n\r\n";
  for (int i = 0; i < 20; ++i)
    EXPECT_EQ(rig.client().Head("/api/events")->status, 200) << "asked for no stream: " << i;
  {
    std::vector<std::unique_ptr<RawClient>> pages;
    for (int i = 0; i < 12; ++i) {
      pages.push_back(std::make_unique<RawClient>(rig.server->port()));
      pages.back()->send("GET /api/events HTTP/1.1\r\n" + host);
      EXPECT_THAT(pages.back()->receive_until("event: state"), HasSubstr("HTTP/1.1 200")) << i;
    }
    EXPECT_EQ(rig.client().Get("/api/events")->status, 503);
    EXPECT_EQ(rig.client().Get("/api/state")->status, 200) << "commands have threads of their own";
  }
  // The server notices at its next heartbeats.
  const auto deadline = steady_clock::now() + seconds(30);
  std::string answer;
  while (answer.find("HTTP/1.1 200") == std::string::npos && steady_clock::now() < deadline) {
    const RawClient page(rig.server->port());
    page.send("GET /api/events HTTP/1.1\r\n" + host);
    answer = page.receive_until("data: ");
  }
  EXPECT_THAT(answer, HasSubstr("HTTP/1.1 200"));
}

TEST(Daemon, OnlyListedPicturesAreServed) {
  const test_support::TemporaryFolder folder;
  Rig rig;
  rig.session_folder = folder.path();
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
  const auto head = rig.client().Head("/api/last/report/sigma_a.png");
  EXPECT_EQ(head->get_header_value("Content-Length"), "7");

  // What stands in a picture's place since.
  const std::filesystem::path picture = rig.session_folder / "report/sigma_a.png";
  const auto expect_moved_away = [&](const char* what) {
    const auto response = rig.client().Get("/api/last/report/sigma_a.png");
    ASSERT_TRUE(response) << what;
    EXPECT_EQ(response->status, 404) << what;
    EXPECT_THAT(response->body, HasSubstr("moved away")) << what;
    std::filesystem::remove_all(picture);
  };
  std::filesystem::remove(picture);
  expect_moved_away("nothing");
  std::filesystem::create_directory(picture);
  expect_moved_away("a folder");
  ASSERT_EQ(::mkfifo(picture.c_str(), 0600), 0);
  expect_moved_away("a pipe");
}

TEST(Daemon, AnAbortThatComesAfterALossLeavesTheLossStanding) {
  StateBoard board;
  CommandDesk desk(board);
  board.update([](DaemonSnapshot& snapshot) { snapshot.phase = DaemonPhase::kReady; });
  ASSERT_EQ(desk.request_capture({.request_id = "a"}), Answer::kAccepted);
  board.update([](DaemonSnapshot& snapshot) { snapshot.phase = DaemonPhase::kFault; });
  EXPECT_EQ(desk.request_abort("b"), Answer::kAccepted);
  EXPECT_EQ(board.snapshot().phase, DaemonPhase::kFault);
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

// As after the daemon was killed and started anew; ten seconds, most of this test's time.
TEST(DaemonClient, DoesNotFollowACaptureThatTheDaemonDoesNotKnow) {
  Rig rig;
  const auto client = DaemonClient::find(rig.server->port(), "/rigs/a.toml");
  EXPECT_FALSE(client->follow("of another process", [](const DaemonSnapshot&) {}, {}).has_value());
}

}  // namespace
}  // namespace capture
