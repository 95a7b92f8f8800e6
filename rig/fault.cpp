#include "rig/fault.h"

namespace rig {

std::string_view to_string(Fault fault) {
  switch (fault) {
    case Fault::kNotFound:
      return "not found";
    case Fault::kAccessDenied:
      return "access denied";
    case Fault::kBusy:
      return "busy";
    case Fault::kOutOfRange:
      return "out of range";
    case Fault::kReadBackMismatch:
      return "read-back mismatch";
    case Fault::kUnsupported:
      return "unsupported";
    case Fault::kTimeout:
      return "timeout";
    case Fault::kDeviceLost:
      return "device lost";
    case Fault::kFrameIncomplete:
      return "frame incomplete";
    case Fault::kFrameMalformed:
      return "frame malformed";
    case Fault::kSequenceGap:
      return "sequence gap";
    case Fault::kProtocol:
      return "protocol";
    case Fault::kDisplayChanged:
      return "display changed";
    case Fault::kConfiguration:
      return "configuration";
  }
  return "unknown fault";
}

}  // namespace rig
