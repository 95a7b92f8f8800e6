#include "hw_sim/faults/fault_plan.h"

#include <algorithm>
#include <array>

#include "estimation/base/check.h"

namespace hw_sim {
namespace {

using std::chrono::milliseconds;

struct KindFacts {
  FaultKind kind;
  std::string_view name;
  FaultSite site;
  bool is_possible_idle;
  milliseconds duration;
};

using enum FaultKind;
using enum FaultSite;
constexpr std::array<KindFacts, kFaultKindCount> kFacts{{
    {kPacketLoss, "packet_loss", kShot, false, milliseconds(0)},
    {kLeaderLost, "leader_lost", kShot, false, milliseconds(0)},
    {kTrailerLost, "trailer_lost", kShot, false, milliseconds(0)},
    {kFrameLost, "frame_lost", kShot, false, milliseconds(0)},
    {kFrameDuplicated, "frame_duplicated", kShot, false, milliseconds(0)},
    {kFrameTruncated, "frame_truncated", kShot, false, milliseconds(0)},
    {kFrameLate, "frame_late", kShot, false, milliseconds(300)},
    {kTriggerMissed, "trigger_missed", kShot, false, milliseconds(0)},
    {kTriggerDoubled, "trigger_doubled", kShot, true, milliseconds(0)},
    {kTriggerBounced, "trigger_bounced", kShot, false, milliseconds(0)},
    {kSequencerSlip, "sequencer_slip", kShot, false, milliseconds(0)},
    {kExposureStuck, "exposure_stuck", kShot, false, milliseconds(0)},
    {kClockStep, "clock_step", kShot, true, milliseconds(1000)},
    {kVblankSkipped, "vblank_skipped", kFlip, false, milliseconds(0)},
    {kFlipLate, "flip_late", kFlip, false, milliseconds(33)},
    {kEdgeMissed, "edge_missed", kFlip, false, milliseconds(0)},
    {kPhotodiodeSlowFall, "photodiode_slow_fall", kFlip, false, milliseconds(4)},
    {kPhotodiodeStuck, "photodiode_stuck", kTrain, true, milliseconds(1000)},
    {kPhotodiodeDim, "photodiode_dim", kTrain, true, milliseconds(1000)},
    {kLightFlash, "light_flash", kTrain, true, milliseconds(0)},
    {kEdgeBounced, "edge_bounced", kTrain, false, milliseconds(0)},
    {kUsbStall, "usb_stall", kTrain, true, milliseconds(0)},
    {kUsbGap, "usb_gap", kTrain, true, milliseconds(0)},
    {kUsbSilent, "usb_silent", kTrain, true, milliseconds(1000)},
    {kUsbUnplugged, "usb_unplugged", kTrain, true, milliseconds(2000)},
    {kCameraRebooted, "camera_rebooted", kTrain, true, milliseconds(2000)},
    {kCablePulled, "cable_pulled", kTrain, true, milliseconds(3000)},
    {kControlStolen, "control_stolen", kTrain, true, milliseconds(2000)},
    {kProjectorGone, "projector_gone", kTrain, true, milliseconds(2000)},
    {kGammaWrong, "gamma_wrong", kTrain, true, milliseconds(1000)},
}};

const KindFacts& facts(FaultKind kind) {
  const KindFacts& found = kFacts[static_cast<std::size_t>(kind)];
  estimation::check(found.kind == kind, "the table of fault kinds is out of order");
  return found;
}

}  // namespace

std::string_view to_string(FaultKind kind) { return facts(kind).name; }

std::optional<FaultKind> parse_fault_kind(std::string_view name) {
  const auto found = std::find_if(kFacts.begin(), kFacts.end(),
                                  [name](const KindFacts& each) { return each.name == name; });
  if (found == kFacts.end()) return std::nullopt;
  return found->kind;
}

FaultSite site_of(FaultKind kind) { return facts(kind).site; }

bool is_possible_idle(FaultKind kind) { return facts(kind).is_possible_idle; }

PlannedFault default_fault(FaultKind kind) {
  PlannedFault fault;
  fault.kind = kind;
  fault.duration = facts(kind).duration;
  return fault;
}

}  // namespace hw_sim
