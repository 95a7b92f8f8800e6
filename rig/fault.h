// What hardware can do wrong, as ordinary values. rig reports; capture decides
// (capture/reaction.h).
#pragma once

#include <string>
#include <string_view>
#include <tl/expected.hpp>

namespace rig {

enum class Fault {
  kNotFound,          // no such device, monitor, address
  kAccessDenied,      // somebody else controls it, or permissions are missing
  kBusy,              // called in the wrong state
  kOutOfRange,        // the device cannot do what was asked
  kReadBackMismatch,  // a setting did not take
  kUnsupported,       // the device lacks a feature that the rig file asks for
  kTimeout,           // nothing came before the deadline
  kDeviceLost,        // terminal: destroy and open anew
  kFrameIncomplete,   // packets missing
  kFrameMalformed,    // wrong size, geometry, format or chunks
  kSequenceGap,       // the device's own counter skipped: data were lost
  kProtocol,          // an answer that the protocol does not allow
  kDisplayChanged,    // monitor gone, or its mode or gamma changed
  kConfiguration      // the rig file is wrong
};

std::string_view to_string(Fault fault);  // "device lost"

struct Error {
  Fault fault = Fault::kTimeout;
  std::string detail;  // one sentence with the place and the remedy
};

template <typename T>
using Result = tl::expected<T, Error>;

inline tl::unexpected<Error> failure(Fault fault, std::string detail) {
  return tl::unexpected<Error>(Error{fault, std::move(detail)});
}

}  // namespace rig
