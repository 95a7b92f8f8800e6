// The daemon's HTTP API and page on 127.0.0.1.
//   GET  /                 the operator's page
//   GET  /api/state        the snapshot (state_board.h) as JSON
//   GET  /api/events       Server-Sent Events: `state` on each change (id: revision), `heartbeat`
//                          each second
//   POST /api/capture      {"request_id": "...", "subject": "...", "directory": "...",
//                          "resume": "..."} -> 202; idempotent by request_id
//   POST /api/abort        {"request_id": "..."} -> 202; acts at once
//   GET  /api/last/NAME    a quick-look picture of the last capture
//   GET  /healthz, /readyz the process is alive; a capture can be started
// Errors are JSON {"error": "..."} with 400 (malformed), 403 (foreign Host or Origin), 404, 409
// (busy), 411 (no length), 413, 415, 503 (not ready). One request a connection.
#pragma once

#include <memory>

#include "capture/daemon/command_desk.h"
#include "capture/daemon/state_board.h"
#include "rig/fault.h"

namespace capture {

// Runs its own threads from start() until destruction; board and desk outlive it.
class HttpServer {
 public:
  // Port 0 picks a free one. Errors: kBusy if the port is taken.
  static rig::Result<std::unique_ptr<HttpServer>> start(int port, StateBoard& board,
                                                        CommandDesk& desk);
  virtual ~HttpServer() = default;
  virtual int port() const = 0;
};

}  // namespace capture
