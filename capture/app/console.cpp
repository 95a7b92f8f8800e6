#include "capture/app/console.h"

#include <unistd.h>

#include <cstdio>

namespace capture {

ProgressLine::ProgressLine() : is_terminal_(::isatty(STDERR_FILENO) != 0) {}

ProgressLine::~ProgressLine() {
  if (is_shown_) std::fputc('\n', stderr);
}

void ProgressLine::show(const std::string& text, bool is_important) {
  if (!is_terminal_) return;
  constexpr std::chrono::milliseconds kPeriod{100};
  const auto now = std::chrono::steady_clock::now();
  if (!is_important && is_shown_ && now - last_ < kPeriod) return;
  last_ = now;
  is_shown_ = true;
  std::fprintf(stderr, "\r\033[K%s", text.c_str());
  std::fflush(stderr);
}

void complain(const std::string& text) { std::fprintf(stderr, "ssrig: %s\n", text.c_str()); }

}  // namespace capture
