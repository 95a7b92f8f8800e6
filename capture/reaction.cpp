#include "capture/reaction.h"

namespace capture {

Reaction reaction_to(Incident incident, rig::Bracketing bracketing) {
  switch (incident) {
    case Incident::kPictureNotShown:
    case Incident::kPictureLate:
    case Incident::kPulseMissing:
      return Reaction::kRestart;  // what is still under way is unknown
    case Incident::kEdgeMissing:
    case Incident::kEdgeWrongLevel:
      // The box's idea of the level is no longer ours; showing the pattern again with the other
      // square may be no change to the box, and arming anew under a dark square is sure.
      return Reaction::kRestart;
    case Incident::kEdgeBeforeFlip:
    case Incident::kEdgeLate:
    case Incident::kEdgeOutOfOrder:
    case Incident::kPulseOutOfOrder:
    case Incident::kDataLost:
      return Reaction::kRestart;  // pulse numbers can no longer be trusted
    case Incident::kEdgeDuringExposure:
      return Reaction::kRetake;
    case Incident::kFrameMissing:
    case Incident::kFrameDamaged:
      return Reaction::kRetake;
    case Incident::kFrameMisexposed:
      // One lost trigger leaves a sequencer out of step for good; a pulse width is its own.
      return bracketing == rig::Bracketing::kSequencer ? Reaction::kRestart : Reaction::kRetake;
    case Incident::kFrameMistimed:
    case Incident::kFrameUnexpected:
      return Reaction::kRestart;  // the camera's count and the box's have parted
    case Incident::kFrameDuplicate:
    case Incident::kFrameLate:
      return Reaction::kIgnore;
    case Incident::kDeviceLost:
      return Reaction::kReopen;
    case Incident::kDeviceRefused:
    case Incident::kStorage:
      return Reaction::kFail;
  }
  return Reaction::kFail;
}

Incident incident_of(rig::Fault fault) {
  switch (fault) {
    case rig::Fault::kSequenceGap:
    case rig::Fault::kTimeout:   // an answer or a heartbeat came late: a lost device says so
    case rig::Fault::kProtocol:  // a read failed and was repeated
      return Incident::kDataLost;
    case rig::Fault::kFrameIncomplete:
    case rig::Fault::kFrameMalformed:
      return Incident::kFrameDamaged;
    case rig::Fault::kDeviceLost:
    case rig::Fault::kDisplayChanged:
    case rig::Fault::kNotFound:
      return Incident::kDeviceLost;
    case rig::Fault::kAccessDenied:
    case rig::Fault::kBusy:
    case rig::Fault::kOutOfRange:
    case rig::Fault::kReadBackMismatch:
    case rig::Fault::kUnsupported:
    case rig::Fault::kConfiguration:
      return Incident::kDeviceRefused;
  }
  return Incident::kDeviceRefused;
}

std::string_view to_string(Incident incident) {
  switch (incident) {
    case Incident::kPictureNotShown:
      return "picture not shown";
    case Incident::kPictureLate:
      return "picture late";
    case Incident::kEdgeMissing:
      return "edge missing";
    case Incident::kEdgeWrongLevel:
      return "edge to the wrong level";
    case Incident::kEdgeBeforeFlip:
      return "edge before the flip";
    case Incident::kEdgeLate:
      return "edge late";
    case Incident::kEdgeDuringExposure:
      return "edge during the exposure";
    case Incident::kEdgeOutOfOrder:
      return "edge out of order";
    case Incident::kPulseMissing:
      return "pulse missing";
    case Incident::kPulseOutOfOrder:
      return "pulse out of order";
    case Incident::kFrameMissing:
      return "frame missing";
    case Incident::kFrameDamaged:
      return "frame damaged";
    case Incident::kFrameMisexposed:
      return "frame misexposed";
    case Incident::kFrameMistimed:
      return "frame mistimed";
    case Incident::kFrameUnexpected:
      return "frame unexpected";
    case Incident::kFrameDuplicate:
      return "frame duplicate";
    case Incident::kFrameLate:
      return "frame late";
    case Incident::kDataLost:
      return "device data lost";
    case Incident::kDeviceRefused:
      return "device refused";
    case Incident::kDeviceLost:
      return "device lost";
    case Incident::kStorage:
      return "storage";
  }
  return "unknown incident";
}

std::string_view to_string(Reaction reaction) {
  switch (reaction) {
    case Reaction::kIgnore:
      return "ignore";
    case Reaction::kRetake:
      return "retake";
    case Reaction::kRestart:
      return "restart";
    case Reaction::kReopen:
      return "reopen";
    case Reaction::kFail:
      return "fail";
  }
  return "unknown reaction";
}

}  // namespace capture
