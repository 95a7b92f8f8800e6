// A plan of faults while it is carried out: devices ask it at every occasion what goes wrong now.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "hw_sim/faults/fault_plan.h"

namespace hw_sim {

// Of one pulse and the frame that it makes.
struct ShotFaults {
  bool is_trigger_missed = false, is_trigger_doubled = false, is_trigger_bounced = false;
  bool is_sequencer_slipping = false, is_exposure_stuck = false;
  std::chrono::milliseconds clock_step{0};
  double loss_frac = 0;
  std::uint64_t loss_seed = 0;  // of the draws of lost packets
  bool is_leader_lost = false, is_trailer_lost = false;
  bool is_lost = false, is_duplicated = false, is_truncated = false;
  std::chrono::milliseconds delay{0};
};

// Of one change of the sync square, from the swap to the photodiode.
struct FlipFaults {
  std::chrono::milliseconds delay{0};
  bool is_edge_missed = false;
  std::chrono::milliseconds fall_time{0};
};

// Thread-safe. The trigger box tells it how far the capture is; the same calls in the same order
// get the same answers.
class FaultSchedule {
 public:
  explicit FaultSchedule(const FaultPlan& plan = {});

  // The devices are open, and at rest.
  void opened();
  // A rig without a trigger box flips the square for each bracket.
  void set_flips_per_showing(int flip_count);
  // The box's account.
  void armed();
  void disarmed();
  void train_started();  // an edge is answered: the next showing
  void pulse_started(int bracket);

  ShotFaults take_shot();  // of the pulse that has started
  FlipFaults take_flip();  // of the showing to come; nothing goes wrong while disarmed
  // Is one of this kind due now? Of kinds at FaultSite::kTrain, or any that can happen idle.
  std::optional<PlannedFault> take(FaultKind kind);
  // Is the next flip's swap to miss its refresh? For who must know ahead.
  bool take_skipped_blank();

  // One line a fault that has happened: "frame_lost at slot 17, bracket 1".
  std::vector<std::string> happened() const;
  // Those that are still to come: "frame_lost".
  std::vector<std::string> outstanding() const;

  bool is_armed() const;
  int showing() const;
  // Waits until a train starts, or the arming changes; at most until `deadline`.
  void wait_for_progress(std::chrono::steady_clock::time_point deadline,
                         const std::stop_token& stop);

 private:
  struct Entry {
    PlannedFault fault;
    int taken_count = 0;
    std::uint64_t occasion_count = 0;
  };

  std::optional<PlannedFault> take_at(FaultKind kind, FaultPlace place);  // mutex_ is held
  FaultPlace next_flip() const;                                           // mutex_ is held
  std::uint64_t draw(std::size_t entry, std::uint64_t occasion) const;
  void note_progress();

  const std::uint64_t seed_;
  mutable std::mutex mutex_;
  std::condition_variable_any progressed_;
  std::vector<Entry> entries_;  // guarded by mutex_, as all below
  FaultPlace place_;
  int flips_per_showing_ = 1;
  bool is_train_started_ = false;  // since arming
  bool is_armed_ = false;
  std::uint64_t progress_count_ = 0;
  std::uint64_t seen_progress_ = 0;  // by wait_for_progress()
  std::uint64_t shot_count_ = 0;
  std::vector<std::string> happened_;
};

}  // namespace hw_sim
