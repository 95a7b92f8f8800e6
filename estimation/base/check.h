// check(condition, message): our own broken invariant ends the program, in release too.
#pragma once

#include <cstdio>
#include <cstdlib>

namespace estimation {

// Thread-safe. Never for input or hardware: those return a Result.
// The place is the caller's; builtins, because clang-tidy 14 cannot parse std::source_location.
inline void check(bool condition, const char* message, const char* file = __builtin_FILE(),
                  int line = __builtin_LINE()) {
  if (condition) return;
  std::fprintf(stderr, "ssrig: broken invariant at %s:%d: %s\n", file, line, message);
  std::abort();
}

}  // namespace estimation
