// What a command says: one line of progress on a terminal, nothing in a log; failures on stderr.
#pragma once

#include <chrono>
#include <string>

#include "capture/exit_code.h"

namespace capture {

// Not thread-safe.
class ProgressLine {
 public:
  ProgressLine();
  ~ProgressLine();  // leaves the last text standing
  ProgressLine(const ProgressLine&) = delete;
  ProgressLine& operator=(const ProgressLine&) = delete;

  // Replaces the line, at most ten times a second unless `is_important`.
  void show(const std::string& text, bool is_important = false);

 private:
  bool is_terminal_;
  bool is_shown_ = false;
  std::chrono::steady_clock::time_point last_;
};

// Before a file is opened: one that got the number of a stream that whoever started us has closed
// would have our messages written into it.
void open_standard_streams();

// After the last word on stdout: `exit_code`, but kFailed in place of kDone, and the reason told,
// where what was said could not be written; a reader that has gone needs no more of it.
ExitCode finish_output(ExitCode exit_code);

// "ssrig: TEXT" on stderr.
void complain(const std::string& text);

}  // namespace capture
