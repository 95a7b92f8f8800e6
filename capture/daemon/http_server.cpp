#include "capture/daemon/http_server.h"

#include <httplib.h>

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <thread>

#include "capture/daemon/http_request.h"
#include "capture/daemon/page.h"

namespace capture {
namespace {

constexpr std::size_t kBodyLimit_bytes = std::size_t{16} * 1024;
constexpr int kThreadCount = 16;  // each open page holds one for its event stream
constexpr int kStreamLimit = 12;  // the rest stay free for commands
constexpr auto kHeartbeat = std::chrono::seconds(1);

void reply_error(httplib::Response& response, int status, const std::string& text) {
  response.status = status;
  response.set_content(nlohmann::json{{"error", text}}.dump(
                           -1, ' ', false, nlohmann::json::error_handler_t::replace),
                       "application/json");
}

class HttplibServer final : public HttpServer {
 public:
  HttplibServer(StateBoard& board, CommandDesk& desk) : board_(board), desk_(desk) {}

  ~HttplibServer() override {
    stop_.request_stop();
    server_.stop();
  }

  rig::Result<void> listen(int port) {
    server_.new_task_queue = [] { return new httplib::ThreadPool(kThreadCount); };
    server_.set_payload_max_length(kBodyLimit_bytes);
    server_.set_read_timeout(5);
    server_.set_write_timeout(5);
    server_.set_tcp_nodelay(true);
    // One request a connection: of a refused one the library leaves the body unread, and would take
    // it for the next request, without the headers by which the first was refused. Nor does a
    // connection that waits for its next request hold one of the threads.
    server_.set_keep_alive_max_count(1);
    // The library sets SO_REUSEPORT too, which would let two daemons share one port.
    server_.set_socket_options([](socket_t socket) {
      const int yes = 1;
      setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    });
    add_routes();
    port_ = port == 0 ? server_.bind_to_any_port("127.0.0.1")
                      : (server_.bind_to_port("127.0.0.1", port) ? port : -1);
    if (port_ <= 0) {
      return rig::failure(rig::Fault::kBusy,
                          "port " + std::to_string(port) +
                              " on 127.0.0.1 is taken: is another ssrig serve running? "
                              "Choose another with --port");
    }
    thread_ = std::jthread([this] { server_.listen_after_bind(); });
    // stop() only ends a server that runs: wait the moment until it does.
    while (!server_.is_running()) std::this_thread::yield();
    return {};
  }

  int port() const override { return port_; }

 private:
  void add_routes() {
    server_.set_pre_routing_handler(
        [this](const httplib::Request& request, httplib::Response& response) {
          return refuse(request, response) ? httplib::Server::HandlerResponse::Handled
                                           : httplib::Server::HandlerResponse::Unhandled;
        });
    server_.set_default_headers(
        {{"Cache-Control", "no-store"}, {"X-Content-Type-Options", "nosniff"}});
    server_.set_error_handler(explain);
    server_.Get("/", [](const httplib::Request&, httplib::Response& response) {
      response.set_content(kPage, "text/html; charset=utf-8");
    });
    server_.Get("/api/state", [this](const httplib::Request&, httplib::Response& response) {
      response.set_content(to_json(board_.snapshot()), "application/json");
    });
    server_.Get("/healthz", [](const httplib::Request&, httplib::Response& response) {
      response.set_content("ok\n", "text/plain");
    });
    server_.Get("/readyz", [this](const httplib::Request&, httplib::Response& response) {
      const DaemonSnapshot snapshot = board_.snapshot();
      if (snapshot.phase != DaemonPhase::kReady) response.status = 503;
      response.set_content(
          nlohmann::json{{"phase", to_string(snapshot.phase)}, {"message", snapshot.message}}.dump(
              -1, ' ', false, nlohmann::json::error_handler_t::replace),
          "application/json");
    });
    server_.Get("/api/events", [this](const httplib::Request&, httplib::Response& response) {
      stream_events(response);
    });
    server_.Get(R"(/api/last/(.+))",
                [this](const httplib::Request& request, httplib::Response& response) {
                  send_picture(request.matches[1].str(), response);
                });
    server_.Post("/api/capture",
                 [this](const httplib::Request& request, httplib::Response& response) {
                   if (const auto command = read_command(request, response))
                     start_capture(*command, response);
                 });
    server_.Post("/api/abort",
                 [this](const httplib::Request& request, httplib::Response& response) {
                   if (const auto command = read_command(request, response)) {
                     const Answer answer = desk_.request_abort(command->request_id);
                     if (answer == Answer::kNothing)
                       return reply_error(response, 409, "there is no capture to abort");
                     response.status = 202;
                     response.set_content(to_json(board_.snapshot()), "application/json");
                   }
                 });
  }

  // What the library refuses by itself comes without a word.
  static void explain(const httplib::Request&, httplib::Response& response) {
    if (!response.body.empty()) return;
    const auto text = [&response]() -> std::string {
      switch (response.status) {
        case 404:
          return "nothing is served under this name";
        case 413:
          return "the body is longer than " + std::to_string(kBodyLimit_bytes) + " bytes";
        case 414:
          return "the address is too long";
        default:
          return response.status >= 500 ? "the daemon could not answer; ask again"
                                        : "the request cannot be read";
      }
    };
    reply_error(response, response.status, text());
  }

  // Before the body is read. True if it answered.
  bool refuse(const httplib::Request& request, httplib::Response& response) const {
    const std::string origin = request.get_header_value("Origin");
    if (!is_own_origin(request.get_header_value("Host"),
                       request.has_header("Origin") ? &origin : nullptr, port_)) {
      reply_error(response, 403,
                  "this address answers only pages of its own; open http://127.0.0.1:" +
                      std::to_string(port_));
      return true;
    }
    // The library bounds a body by its announced length only.
    if (request.has_header("Transfer-Encoding")) {
      reply_error(response, 411, "send the body with a Content-Length");
      return true;
    }
    return false;
  }

  // The request's command; else answers the error itself.
  static std::optional<CaptureRequest> read_command(const httplib::Request& request,
                                                    httplib::Response& response) {
    auto command = parse_command(request.get_header_value("Content-Type"), request.body);
    if (command) return *std::move(command);
    reply_error(response, command.error().status, command.error().text);
    return std::nullopt;
  }

  void start_capture(const CaptureRequest& request, httplib::Response& response) {
    switch (desk_.request_capture(request)) {
      case Answer::kAccepted:
        response.status = 202;
        break;
      case Answer::kBusy:
        return reply_error(response, 409, "a capture is under way; wait for it or abort it");
      default:
        return reply_error(response, 503, "the rig is not ready: " + board_.snapshot().message);
    }
    response.set_content(to_json(board_.snapshot()), "application/json");
  }

  void stream_events(httplib::Response& response) {
    if (++stream_count_ > kStreamLimit) {
      --stream_count_;
      return reply_error(response, 503, "too many pages are open at once; close one");
    }
    auto seen =
        std::make_shared<std::optional<std::uint64_t>>();  // shared: std::function must be copyable
    response.set_chunked_content_provider(
        "text/event-stream",
        [this, seen](std::size_t, httplib::DataSink& sink) { return send_event(*seen, sink); },
        [this](bool) { --stream_count_; });
  }

  // One event: the present state first, then each change; a heartbeat when a second passes without
  // one.
  bool send_event(std::optional<std::uint64_t>& seen, httplib::DataSink& sink) {
    if (stop_.stop_requested()) return false;
    std::optional<DaemonSnapshot> snapshot = board_.snapshot();
    if (seen == snapshot->revision)
      snapshot = board_.wait_beyond(*seen, std::chrono::steady_clock::now() + kHeartbeat,
                                    stop_.get_token());
    std::string event = "event: heartbeat\ndata: {}\n\n";
    if (snapshot) {
      seen = snapshot->revision;
      event = "id: " + std::to_string(snapshot->revision) +
              "\nevent: state\ndata: " + to_json(*snapshot) + "\n\n";
    }
    return sink.write(event.data(), event.size());
  }

  // Only files that the last outcome lists: nothing else of the disk can be named.
  void send_picture(const std::string& name, httplib::Response& response) const {
    const DaemonSnapshot snapshot = board_.snapshot();
    const auto is_listed = snapshot.last && std::ranges::count(snapshot.last->pictures, name) > 0;
    if (!is_listed)
      return reply_error(response, 404, "the last capture has no picture of that name");
    const std::filesystem::path path = std::filesystem::path(snapshot.last->session) / name;
    std::error_code unknown;
    // Reading a folder throws; a pipe would be waited for.
    const bool is_file = std::filesystem::is_regular_file(path, unknown);
    std::ifstream file;
    if (is_file) file.open(path, std::ios::binary);
    if (!file.is_open()) return reply_error(response, 404, "the picture has been moved away");
    response.set_content(std::string(std::istreambuf_iterator<char>(file), {}), "image/png");
  }

  StateBoard& board_;
  CommandDesk& desk_;
  httplib::Server server_;
  std::atomic<int> stream_count_{0};
  int port_ = 0;
  std::stop_source stop_;
  std::jthread thread_;
};

}  // namespace

rig::Result<std::unique_ptr<HttpServer>> HttpServer::start(int port, StateBoard& board,
                                                           CommandDesk& desk) {
  auto server = std::make_unique<HttplibServer>(board, desk);
  if (auto listening = server->listen(port); !listening) return tl::unexpected(listening.error());
  return server;
}

}  // namespace capture
