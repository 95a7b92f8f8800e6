// Every fault at the first, a middle and the last slot and at rest, over the real wires, one
// capture each: a line a fault, and failure if a frame is in a wrong slot, if a session is not what
// its exit code says, or if a capture hangs.
// usage: wire_fault_places [FIRST_FAULT [LAST_FAULT [SYNC [PACE [without-line-status]]]]] (numbers,
// then a rig file's words)
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <utility>

#include "hw_sim/faults/fault_plan.h"
#include "tests/wire/rig/wire_capture.h"

namespace {

constexpr int kDone = 0, kDevice = 3, kIncomplete = 4;

struct Tally {
  int capture_count = 0, complete_count = 0, broken_count = 0;
};

std::string try_at(const WireMode& mode, hw_sim::FaultKind kind, const std::string& place,
                   Tally& tally) {
  if (place == "at = \"idle\"" && !hw_sim::is_possible_idle(kind)) return "-";
  WireCapture wire;
  wire.set_mode(mode);
  const auto start = std::chrono::steady_clock::now();
  const int code =
      wire.run("faults = [{fault = \"" + std::string(to_string(kind)) + "\", " + place + "}]\n");
  const double duration_s =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  ++tally.capture_count;
  bool is_kept = code == kDone || code == kDevice || code == kIncomplete;
  for (const auto& path : wire.sessions()) {
    const LedgerSession session = wire.judge(path);
    for (const std::string& wrong : session.wrong_frames) std::printf("WRONG: %s\n", wrong.c_str());
    is_kept = is_kept && session.wrong_frames.empty() &&
              (session.state == "complete") == (code == kDone) &&
              (code != kDone || session.frame_count == 176);
  }
  if (code == kDone) ++tally.complete_count;
  if (!is_kept) {
    ++tally.broken_count;
    std::printf("BROKEN: %s %s: exit code %d\n%s\n", std::string(to_string(kind)).c_str(),
                place.c_str(), code, wire.output().c_str());
  }
  char text[64];
  std::snprintf(text, sizeof text, "%s %.0f s", code == kDone ? "complete" : "failed", duration_s);
  return text;
}

}  // namespace

int main(int argc, char** argv) {
  const int first = argc > 1 ? std::atoi(argv[1]) : 0;
  const int last = argc > 2 ? std::atoi(argv[2]) : hw_sim::kFaultKindCount - 1;
  const WireMode mode = WireMode::of(argc - 3, argv + 3);
  Tally tally;
  std::printf("Sync mode %s, %s.\n\n", mode.sync.c_str(), mode.pace.c_str());
  std::printf(
      "| fault | at rest | first slot | middle slot | last slot |\n|---|---|---|---|---|\n");
  for (int number = first; number <= last; ++number) {
    const auto kind = static_cast<hw_sim::FaultKind>(number);
    if (!mode.has_part_for(kind)) continue;
    std::string row = "| " + std::string(to_string(kind)) + " |";
    for (const char* place : {"at = \"idle\"", "slot = 0", "slot = 43", "slot = 87"})
      row.append(" ").append(try_at(mode, kind, place, tally)).append(" |");
    std::printf("%s\n", row.c_str());
    std::fflush(stdout);
  }
  std::printf("%d captures over the wires, %d complete; promise broken: %d\n", tally.capture_count,
              tally.complete_count, tally.broken_count);
  return tally.broken_count == 0 ? 0 : 1;
}
