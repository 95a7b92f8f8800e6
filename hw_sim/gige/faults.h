// What the simulated camera and its cable can be told to do wrong, while it runs.
#pragma once

#include <atomic>

namespace hw_sim {

// Thread-safe: every knob is an atomic that takes effect at the next packet, frame or pulse. A
// count works that many times and then stands at zero again.
struct GigeFaults {
  // The network.
  std::atomic<double> packet_loss_frac{0};  // of stream packets, resent ones included
  std::atomic<bool> is_mute{false};         // cable pulled: neither answers nor packets
  std::atomic<bool> is_resend_ignored{false};
  std::atomic<bool> are_packets_duplicated{false};
  std::atomic<int> lost_leaders{0};
  std::atomic<int> lost_trailers{0};
  std::atomic<int> lost_frames{0};       // a block id is used up, no packet leaves
  std::atomic<int> truncated_frames{0};  // the second half is never sent, not even on request
  std::atomic<int> late_frames{0};       // held back by late_frame_ms
  std::atomic<int> late_frame_ms{300};
  // The camera.
  std::atomic<bool> is_control_kicked{false};  // control privilege revoked, once
  std::atomic<bool> is_control_taken{false};   // by another program: nobody else gets it
  std::atomic<bool> is_exposure_stuck{false};  // every exposure as long as the one before
  std::atomic<int> sequencer_slips{0};         // steps on without a pulse
  std::atomic<int> unseen_pulses{0};           // a pulse that the line does not carry
  std::atomic<int> wrong_size_frames{0};       // the leader tells half the height
  std::atomic<int> padded_frames{0};           // the leader tells of bytes behind each row
  std::atomic<int> wrong_format_frames{0};     // the leader tells Mono8
  std::atomic<int> timestamp_jumps{0};         // the clock jumps ahead by a second, for good
};

// Takes one from a count knob; false when it stands at zero.
inline bool take_one(std::atomic<int>& count) {
  int present = count.load();
  while (present > 0)
    if (count.compare_exchange_weak(present, present - 1)) return true;
  return false;
}

}  // namespace hw_sim
