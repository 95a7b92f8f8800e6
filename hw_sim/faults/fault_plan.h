// What goes wrong with a rig, where and how often: a written plan. One type for the in-process
// devices and for the far ends of the wires, so that a fault is the same wherever it is tried.
//
// A place is a showing: the how manieth picture the photodiode has answered since the rig was
// started. The first is the capture's priming; the pattern that is projected as number `slot` (from
// 0) is the one after, as long as nothing before it was retaken. A planned fault happens at the
// first occasion at or after its place, `count` times in a row, and never again: a retake is
// spared.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string_view>
#include <vector>

#include "rig/fault.h"

namespace hw_sim {

enum class FaultKind {
  // The network between camera and host.
  kPacketLoss,       // loss_frac of a frame's packets, resent ones included
  kLeaderLost,       // the packet that announces a frame
  kTrailerLost,      // the packet that ends it
  kFrameLost,        // a block number is used up, nothing arrives
  kFrameDuplicated,  // everything arrives twice
  kFrameTruncated,   // the second half is never sent, not even on request
  kFrameLate,        // by duration
  // The camera.
  kTriggerMissed,   // a pulse that its line does not carry
  kTriggerDoubled,  // a second pulse, after the exposure
  kTriggerBounced,  // a second pulse during the exposure
  kSequencerSlip,   // the sequencer steps on without a pulse
  kExposureStuck,   // as long as the exposure before, by the camera's timer
  kClockStep,       // the camera's clock jumps by duration
  // The projector and the photodiode in front of it.
  kVblankSkipped,       // the buffer swap is a refresh late
  kFlipLate,            // the light comes duration after the reported swap
  kEdgeMissed,          // the photodiode does not see one change of the square
  kPhotodiodeSlowFall,  // light to dark with duration as time constant
  kPhotodiodeStuck,     // it keeps its level, for duration
  kPhotodiodeDim,       // light is level_frac of what it was, for duration
  // Between photodiode and host.
  kLightFlash,   // another light, while the shutter is open
  kEdgeBounced,  // the edge chatters within the debounce time
  kUsbStall,     // the endpoint stalls once
  kUsbGap,       // a record is lost
  kUsbSilent,    // nothing is sent for duration
  // Whole devices; back after duration. Here and above, a duration of 0 is for good.
  kUsbUnplugged,
  kCameraRebooted,
  kCablePulled,    // the camera runs on, but nothing passes
  kControlStolen,  // another program takes the camera
  kProjectorGone,
  kGammaWrong,  // another program sets the ramp to gamma_exponent
};
inline constexpr int kFaultKindCount = static_cast<int>(FaultKind::kGammaWrong) + 1;
std::string_view to_string(FaultKind kind);  // "frame_lost"
std::optional<FaultKind> parse_fault_kind(std::string_view name);

// What can happen at one occasion.
enum class FaultSite {
  kShot,   // a pulse and the frame that it makes
  kFlip,   // the square's change, ahead of its edge
  kTrain,  // an edge that was answered; whole devices fail here, too
};
FaultSite site_of(FaultKind kind);
// Can also happen while no capture is under way.
bool is_possible_idle(FaultKind kind);

inline constexpr int kIdle = -1;  // a showing number: opened, before the first arming
inline constexpr int kPrimingShowing = 0;
inline constexpr int showing_of_slot(int slot) { return slot + 1; }

struct FaultPlace {
  int showing = kPrimingShowing;
  int bracket = 0;  // of kShot only
  bool operator==(const FaultPlace&) const = default;
};

struct PlannedFault {
  FaultKind kind = FaultKind::kFrameLost;
  std::optional<FaultPlace> place{};  // nullopt: anywhere, by rate_frac
  double rate_frac = 0;               // of occasions
  int count = 1;                      // at most
  std::chrono::milliseconds duration{0};
  double loss_frac = 0.01;
  double level_frac = 0.5;
  double gamma_exponent = 2.2;
  bool operator==(const PlannedFault&) const = default;
};
// `kind` with the duration that it has when none is said.
PlannedFault default_fault(FaultKind kind);

struct FaultPlan {
  std::uint64_t seed = 1;
  std::vector<PlannedFault> faults;
};

// A TOML file as config/faults.example.toml documents it. Errors: kConfiguration with file, line,
// what is wrong and what to write.
rig::Result<FaultPlan> read_fault_plan(const std::filesystem::path& file);
rig::Result<FaultPlan> parse_fault_plan(std::string_view toml, const std::filesystem::path& file);

}  // namespace hw_sim
