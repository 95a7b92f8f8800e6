// What the daemon knows, as one snapshot with a revision: the only truth that pages and clients
// see.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

namespace capture {

enum class DaemonPhase {
  kStarting,    // devices are being opened
  kReady,       // waiting for the operator
  kCapturing,   // patterns are projected
  kEstimating,  // the last frame has landed, maps are being computed
  kAborting,    // abort was pressed; the projector is or becomes black
  kFault        // the rig cannot capture; `message` says why and what to do
};
std::string to_string(DaemonPhase phase);

// How the last capture ended.
struct CaptureOutcome {
  std::string request_id;
  std::string session;  // folder; empty if none was made
  std::string state;    // "complete", "failed", "aborted"
  int exit_code = 0;    // of the table in architecture.md
  std::string message;
  std::string motion{};               // has anything moved, one sentence; empty: not watched
  std::vector<std::string> pictures;  // quick-look files, relative to `session`
  std::vector<std::string> notes;     // what could not be computed, and why
};

// A take that a crash has left unfinished.
struct InterruptedSession {
  std::string session;  // absolute
  std::string text;     // one sentence: what is there
};

struct DaemonSnapshot {
  std::uint64_t revision = 0;  // grows with every change
  DaemonPhase phase = DaemonPhase::kStarting;
  std::string rig_file;  // absolute
  std::string rig_name;
  std::string message;     // one sentence for the operator
  std::string request_id;  // of the capture under way
  int slots_filled = 0;
  int slots_total = 0;
  int retake_count = 0;
  std::string motion{};            // of the capture under way, once it is known
  std::vector<std::string> notes;  // what the start-up checks found
  std::vector<InterruptedSession> interrupted{};
  std::optional<CaptureOutcome> last;
};

// The snapshot as the JSON object that GET /api/state returns.
std::string to_json(const DaemonSnapshot& snapshot);

// The snapshot of such an object; what is missing or of another type keeps its default. nullopt
// where the text is none: whatever else answers on the daemon's port.
std::optional<DaemonSnapshot> parse_snapshot(std::string_view body);

// Thread-safe.
class StateBoard {
 public:
  DaemonSnapshot snapshot() const;
  // Changes the snapshot under the lock; the revision grows by one.
  void update(const std::function<void(DaemonSnapshot&)>& change);
  // Waits until the revision differs from `seen`; nullopt at `deadline` or on stop.
  std::optional<DaemonSnapshot> wait_beyond(std::uint64_t seen,
                                            std::chrono::steady_clock::time_point deadline,
                                            const std::stop_token& stop) const;

 private:
  mutable std::mutex mutex_;
  mutable std::condition_variable_any changed_;
  DaemonSnapshot snapshot_;  // guarded by mutex_
};

}  // namespace capture
