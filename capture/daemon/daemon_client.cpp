#include "capture/daemon/daemon_client.h"

#include <httplib.h>

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <nlohmann/json.hpp>

namespace capture {
namespace {

using std::chrono::steady_clock;

constexpr auto kPollInterval = std::chrono::milliseconds(100);
constexpr auto kUnheardLimit = std::chrono::seconds(10);

httplib::Client connect(int port) {
  httplib::Client client("127.0.0.1", port);
  client.set_connection_timeout(5);
  client.set_read_timeout(5);
  return client;
}

std::string text(const nlohmann::json& json, const char* key) {
  const auto found = json.find(key);
  return found != json.end() && found->is_string() ? found->get<std::string>() : std::string();
}

// Waits between polls, but not after a stop.
void pause(const std::stop_token& stop) {
  std::mutex mutex;
  std::condition_variable_any waker;
  std::unique_lock lock(mutex);
  waker.wait_for(lock, stop, kPollInterval, [] { return false; });
}

}  // namespace

std::unique_ptr<DaemonClient> DaemonClient::find(int port, const std::string& rig_file) {
  std::unique_ptr<DaemonClient> client(new DaemonClient(port));
  const auto snapshot = client->state();
  if (!snapshot || snapshot->rig_file != rig_file) return nullptr;
  return client;
}

std::optional<DaemonSnapshot> DaemonClient::state() const {
  httplib::Client client = connect(port_);
  const auto response = client.Get("/api/state");
  if (!response || response->status != 200) return std::nullopt;
  return parse_snapshot(response->body);
}

DaemonClient::Reply DaemonClient::post(const std::string& path, const std::string& body) const {
  httplib::Client client = connect(port_);
  const auto response = client.Post(path, body, "application/json");
  if (!response) return {false, "the daemon on port " + std::to_string(port_) + " does not answer"};
  if (response->status == 202) return {true, ""};
  const nlohmann::json json = nlohmann::json::parse(response->body, nullptr, false);
  return {false, json.is_object() ? text(json, "error")
                                  : "the daemon answered " + std::to_string(response->status)};
}

DaemonClient::Reply DaemonClient::request_capture(const CaptureRequest& request) {
  const nlohmann::json body{{"request_id", request.request_id},
                            {"subject", request.subject},
                            {"directory", request.directory},
                            {"resume", request.resume}};
  return post("/api/capture", body.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
}

DaemonClient::Reply DaemonClient::request_abort(const std::string& request_id) {
  return post("/api/abort", nlohmann::json{{"request_id", request_id}}.dump());
}

std::optional<CaptureOutcome> DaemonClient::follow(
    const std::string& request_id, const std::function<void(const DaemonSnapshot&)>& on_change,
    const std::stop_token& stop) {
  std::uint64_t seen_revision = 0;
  bool is_abort_sent = false;
  auto last_heard = steady_clock::now();
  while (steady_clock::now() - last_heard < kUnheardLimit) {
    if (stop.stop_requested() && !is_abort_sent)
      is_abort_sent = request_abort(request_id + "-abort").is_accepted;
    if (const auto snapshot = state()) {
      if (snapshot->last && snapshot->last->request_id == request_id) return snapshot->last;
      // A daemon that was started anew answers, but knows nothing of this capture.
      if (snapshot->request_id == request_id) last_heard = steady_clock::now();
      if (snapshot->revision != seen_revision) on_change(*snapshot);
      seen_revision = snapshot->revision;
    }
    pause(is_abort_sent ? std::stop_token() : stop);
  }
  return std::nullopt;
}

}  // namespace capture
