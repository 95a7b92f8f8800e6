// check(condition, message): our own broken invariant ends the program, in release too.
#pragma once

#include <cstdio>
#include <cstdlib>
#include <source_location>

namespace estimation {

// Thread-safe. Never for input or hardware: those return a Result.
inline void check(bool condition, const char* message,
                  const std::source_location& where = std::source_location::current()) {
  if (condition) return;
  std::fprintf(stderr, "ssrig: broken invariant at %s:%u: %s\n", where.file_name(),
               static_cast<unsigned>(where.line()), message);
  std::abort();
}

}  // namespace estimation
