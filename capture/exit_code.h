// What the programs return; the table is architecture.md's.
#pragma once

#include "estimation/session/error.h"

namespace capture {

enum class ExitCode {
  kDone = 0,
  kFailed = 1,
  kUsage = 2,  // or configuration
  kDevice = 3,
  kIncomplete = 4,
  kStorage = 5,
  kAborted = 130
};

// Of a command that reads or writes sessions.
inline ExitCode exit_code_of(const estimation::InputError& error) {
  return error.fault == estimation::InputFault::kUnwritable ? ExitCode::kStorage
                                                            : ExitCode::kFailed;
}

}  // namespace capture
