// The one table of what capture does about a fault. rig reports, capture decides, here.
#pragma once

#include <string_view>

#include "rig/camera.h"
#include "rig/fault.h"

namespace capture {

// Everything that can go wrong with one showing of a pattern, or with the rig under it.
enum class Incident {
  kPictureNotShown,     // no buffer swap before the deadline
  kPictureLate,         // swapped in late where only swaps tell what was shown
  kEdgeMissing,         // shown, but the photodiode saw nothing before the deadline
  kEdgeWrongLevel,      // an edge to the level that the square did not have
  kEdgeBeforeFlip,      // an edge more than a refresh before the swap: not made by our square
  kEdgeLate,            // later after its swap than in the priming: not made by our square, or slow
  kEdgeDuringExposure,  // the light changed while the shutter was open or about to open
  kEdgeOutOfOrder,      // edge numbers skipped, or an edge when none was due
  kPulseMissing,        // fewer pulses than brackets before the deadline
  kPulseOutOfOrder,     // pulse numbers skipped, or a pulse of another edge
  kFrameMissing,        // nothing before the deadline
  kFrameDamaged,        // arrived incomplete
  kFrameMisexposed,     // the camera exposed for another bracket's time
  kFrameMistimed,       // its number says one pulse, its timestamp another
  kFrameUnexpected,     // its number belongs to no pulse
  kFrameDuplicate,      // a second frame of one pulse
  kFrameLate,           // after its deadline, when a retake was already on its way
  kDataLost,            // a device's own account has a gap, or came late
  kDeviceRefused,       // a device did not take a command
  kDeviceLost,          // a device is gone, or is not what it was
  kStorage              // a frame could not be stored
};

enum class Reaction {
  kIgnore,   // the ledger is not touched; counted in the journal
  kRetake,   // project the pattern again in this run
  kRestart,  // disarm, arm anew with all counters at one, then retake what is open
  kReopen,   // wait for the device, open it anew, then as kRestart; without one to open: kFail
  kFail      // end the capture, black, with slots and cause named
};

std::string_view to_string(Incident incident);  // "frame missing"
std::string_view to_string(Reaction reaction);

Reaction reaction_to(Incident incident, rig::Bracketing bracketing);

// What a fault reported by a device, or by a refused command, means to a capture.
Incident incident_of(rig::Fault fault);

}  // namespace capture
