// What a command says: one line of progress on a terminal, nothing in a log; failures on stderr.
#pragma once

#include <chrono>
#include <string>

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

// "ssrig: TEXT" on stderr.
void complain(const std::string& text);

}  // namespace capture
