// `ssrig capture` as a client of a running daemon of the same rig file.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>

#include "capture/daemon/command_desk.h"
#include "capture/daemon/state_board.h"

namespace capture {

// Not thread-safe; each call is one HTTP request on loopback with a time limit of 5 s.
class DaemonClient {
 public:
  // The daemon on 127.0.0.1:`port` if one runs there with this rig file (absolute path); else
  // nullptr.
  static std::unique_ptr<DaemonClient> find(int port, const std::string& rig_file);

  struct Reply {
    bool is_accepted = false;
    std::string error;  // the daemon's sentence, or why it could not be reached
  };
  Reply request_capture(const CaptureRequest& request);
  Reply request_abort(const std::string& request_id);

  // Follows the capture `request_id` until it has ended and returns how. On stop it asks the daemon
  // to abort and goes on following. nullopt if for 10 s no daemon answers that knows of it.
  std::optional<CaptureOutcome> follow(const std::string& request_id,
                                       const std::function<void(const DaemonSnapshot&)>& on_change,
                                       const std::stop_token& stop);

 private:
  explicit DaemonClient(int port) : port_(port) {}
  std::optional<DaemonSnapshot> state() const;
  Reply post(const std::string& path, const std::string& body) const;

  int port_;
};

}  // namespace capture
