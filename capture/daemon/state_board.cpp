#include "capture/daemon/state_board.h"

#include <nlohmann/json.hpp>

namespace capture {

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
                                 {"notes", snapshot.notes},
                                 {"last", nullptr}};
  if (snapshot.last) {
    json["last"] = {{"request_id", snapshot.last->request_id},
                    {"session", snapshot.last->session},
                    {"state", snapshot.last->state},
                    {"exit_code", snapshot.last->exit_code},
                    {"message", snapshot.last->message},
                    {"pictures", snapshot.last->pictures},
                    {"notes", snapshot.last->notes}};
  }
  // A camera's or a file's name may hold any bytes: replace what is not UTF-8 instead of throwing.
  return json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
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
