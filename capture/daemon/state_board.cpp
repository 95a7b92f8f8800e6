#include "capture/daemon/state_board.h"

#include <limits>
#include <nlohmann/json.hpp>

namespace capture {
namespace {

std::string text(const nlohmann::json& json, const char* key) {
  const auto found = json.find(key);
  return found != json.end() && found->is_string() ? found->get<std::string>() : std::string();
}

// 0 for what is no whole number from 0 on that the type holds.
template <typename Number>
Number number(const nlohmann::json& json, const char* key) {
  const auto found = json.find(key);
  if (found == json.end() || !found->is_number_unsigned()) return 0;
  const auto value = found->get<std::uint64_t>();
  return value > static_cast<std::uint64_t>(std::numeric_limits<Number>::max())
             ? 0
             : static_cast<Number>(value);
}

std::vector<std::string> texts(const nlohmann::json& json, const char* key) {
  std::vector<std::string> values;
  const auto found = json.find(key);
  if (found == json.end() || !found->is_array()) return values;
  for (const nlohmann::json& value : *found)
    if (value.is_string()) values.push_back(value.get<std::string>());
  return values;
}

std::vector<InterruptedSession> interrupted_sessions(const nlohmann::json& json) {
  std::vector<InterruptedSession> sessions;
  const auto found = json.find("interrupted");
  if (found == json.end() || !found->is_array()) return sessions;
  for (const nlohmann::json& each : *found)
    if (each.is_object()) sessions.push_back({text(each, "session"), text(each, "text")});
  return sessions;
}

DaemonPhase phase_from(const std::string& word) {
  for (const DaemonPhase phase :
       {DaemonPhase::kStarting, DaemonPhase::kReady, DaemonPhase::kCapturing,
        DaemonPhase::kEstimating, DaemonPhase::kAborting})
    if (to_string(phase) == word) return phase;
  return DaemonPhase::kFault;
}

}  // namespace

std::string to_string(DaemonPhase phase) {
  switch (phase) {
    case DaemonPhase::kStarting:
      return "starting";
    case DaemonPhase::kReady:
      return "ready";
    case DaemonPhase::kCapturing:
      return "capturing";
    case DaemonPhase::kEstimating:
      return "estimating";
    case DaemonPhase::kAborting:
      return "aborting";
    case DaemonPhase::kFault:
      return "fault";
  }
  return "unknown";
}

std::string to_json(const DaemonSnapshot& snapshot) {
  nlohmann::ordered_json json = {{"revision", snapshot.revision},
                                 {"phase", to_string(snapshot.phase)},
                                 {"rig_file", snapshot.rig_file},
                                 {"rig_name", snapshot.rig_name},
                                 {"message", snapshot.message},
                                 {"request_id", snapshot.request_id},
                                 {"slots_filled", snapshot.slots_filled},
                                 {"slots_total", snapshot.slots_total},
                                 {"retake_count", snapshot.retake_count},
                                 {"motion", snapshot.motion},
                                 {"notes", snapshot.notes},
                                 {"interrupted", nlohmann::ordered_json::array()},
                                 {"last", nullptr}};
  for (const InterruptedSession& each : snapshot.interrupted)
    json["interrupted"].push_back({{"session", each.session}, {"text", each.text}});
  if (snapshot.last) {
    json["last"] = {
        {"request_id", snapshot.last->request_id}, {"session", snapshot.last->session},
        {"state", snapshot.last->state},           {"exit_code", snapshot.last->exit_code},
        {"message", snapshot.last->message},       {"motion", snapshot.last->motion},
        {"pictures", snapshot.last->pictures},     {"notes", snapshot.last->notes}};
  }
  // A camera's or a file's name may hold any bytes: replace what is not UTF-8 instead of throwing.
  return json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

std::optional<DaemonSnapshot> parse_snapshot(std::string_view body) {
  const nlohmann::json json = nlohmann::json::parse(body, nullptr, false);
  if (!json.is_object() || !json.contains("phase")) return std::nullopt;
  DaemonSnapshot snapshot{.revision = number<std::uint64_t>(json, "revision"),
                          .phase = phase_from(text(json, "phase")),
                          .rig_file = text(json, "rig_file"),
                          .rig_name = text(json, "rig_name"),
                          .message = text(json, "message"),
                          .request_id = text(json, "request_id"),
                          .slots_filled = number<int>(json, "slots_filled"),
                          .slots_total = number<int>(json, "slots_total"),
                          .retake_count = number<int>(json, "retake_count"),
                          .motion = text(json, "motion"),
                          .notes = texts(json, "notes"),
                          .interrupted = interrupted_sessions(json),
                          .last = std::nullopt};
  if (const auto last = json.find("last"); last != json.end() && last->is_object()) {
    snapshot.last = CaptureOutcome{.request_id = text(*last, "request_id"),
                                   .session = text(*last, "session"),
                                   .state = text(*last, "state"),
                                   .exit_code = number<int>(*last, "exit_code"),
                                   .message = text(*last, "message"),
                                   .motion = text(*last, "motion"),
                                   .pictures = texts(*last, "pictures"),
                                   .notes = texts(*last, "notes")};
  }
  return snapshot;
}

DaemonSnapshot StateBoard::snapshot() const {
  const std::lock_guard lock(mutex_);
  return snapshot_;
}

void StateBoard::update(const std::function<void(DaemonSnapshot&)>& change) {
  {
    const std::lock_guard lock(mutex_);
    change(snapshot_);
    ++snapshot_.revision;
  }
  changed_.notify_all();
}

std::optional<DaemonSnapshot> StateBoard::wait_beyond(
    std::uint64_t seen, std::chrono::steady_clock::time_point deadline,
    const std::stop_token& stop) const {
  std::unique_lock lock(mutex_);
  if (!changed_.wait_until(lock, stop, deadline, [&] { return snapshot_.revision != seen; }))
    return std::nullopt;
  return snapshot_;
}

}  // namespace capture
