// Where requests meet the session thread: each is answered once, however often it is sent.
#pragma once

#include <chrono>
#include <condition_variable>
#include <deque>
#include <map>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>

#include "capture/daemon/state_board.h"

namespace capture {

struct CaptureRequest {
  std::string request_id;  // chosen by the client: the same id is the same request
  std::string subject{};
  std::string directory{};  // absolute; empty: the rig file's
  std::string resume{};     // absolute: a session to be finished, in place of a new one; else empty
};

enum class Answer {
  kAccepted,  // under way (or done: the id was seen before)
  kBusy,      // another capture is under way
  kNotReady,  // the rig cannot capture now
  kNothing    // nothing to abort
};

// Thread-safe. HTTP threads call request_*, the session thread calls next_capture and capture_stop.
class CommandDesk {
 public:
  explicit CommandDesk(StateBoard& board) : board_(board) {}

  Answer request_capture(const CaptureRequest& request);

  // Stops the capture under way at once; without one, kNothing. An id that was seen before changes
  // nothing.
  Answer request_abort(const std::string& request_id);

  // The next capture to do; nullopt on stop or at the deadline.
  std::optional<CaptureRequest> next_capture(std::chrono::steady_clock::time_point deadline,
                                             const std::stop_token& stop);

  // Asked to stop when the operator aborts the capture that next_capture() returned last.
  std::stop_token capture_stop() const;

  // The session thread has finished the capture; the next may be requested.
  void capture_finished();

 private:
  static constexpr std::size_t kRememberedIds = 256;
  std::optional<Answer> remembered(const std::string& request_id) const;
  Answer remember(const std::string& request_id, Answer answer);

  StateBoard& board_;
  mutable std::mutex mutex_;
  std::condition_variable_any requested_;
  std::optional<CaptureRequest> pending_;  // guarded by mutex_
  bool is_capturing_ = false;      // guarded by mutex_; from the request until capture_finished()
  std::stop_source capture_stop_;  // guarded by mutex_; one a capture
  std::map<std::string, Answer> answers_;  // guarded by mutex_
  std::deque<std::string> answer_order_;   // guarded by mutex_
};

}  // namespace capture
