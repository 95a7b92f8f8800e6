#include "capture/app/console.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <system_error>
#include <tuple>

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

void open_standard_streams() {
  for (const int number : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO})
    // The lowest number that is free is this one.
    if (::fcntl(number, F_GETFD) < 0) std::ignore = ::open("/dev/null", O_RDWR);
}

namespace {

// 0: all was written. A write that failed earlier has left no number: another one tells it.
int output_error() {
  if (std::fflush(stdout) != 0) return errno;
  if (std::ferror(stdout) == 0) return 0;
  return ::write(STDOUT_FILENO, "\n", 1) < 0 ? errno : EIO;
}

}  // namespace

ExitCode finish_output(ExitCode exit_code) {
  const int error_number = output_error();
  if (error_number == 0 || error_number == EPIPE) return exit_code;
  complain("standard output cannot be written: " + std::generic_category().message(error_number) +
           "; what was done stands, what it says is lost");
  return exit_code == ExitCode::kDone ? ExitCode::kFailed : exit_code;
}

void complain(const std::string& text) { std::fprintf(stderr, "ssrig: %s\n", text.c_str()); }

}  // namespace capture
