// How long after its reported swap the edge of a flip comes: learnt while a run is primed, and then
// held against every edge, where no more than that tells our flip from the one before it.
//
// A swap is reported up to a refresh late, never early, so that the largest lag of the priming is
// the nearest to the display's own.
#pragma once

#include <chrono>
#include <optional>

namespace capture {

// Plain data and decisions. Copyable.
class SwapLag {
 public:
  explicit SwapLag(std::chrono::nanoseconds refresh_interval)
      : tolerance_(refresh_interval * 5 / 4) {}

  void forget() { range_.reset(); }
  // A lag of the priming. nullopt where it agrees with those before it; else how much it is off,
  // negative when it is too short, and it is not learnt.
  std::optional<std::chrono::nanoseconds> learn(std::chrono::nanoseconds lag);
  // nullopt where it can be our flip's; else as learn(). The first lag of all is learnt.
  std::optional<std::chrono::nanoseconds> check(std::chrono::nanoseconds lag);

 private:
  struct Range {
    std::chrono::nanoseconds least, greatest;
  };
  // A refresh, and what edges and swaps are off by. Less than from an edge to the swap after the
  // next: flips whose edges are to be told apart are asked for at least 9/4 refreshes apart.
  std::chrono::nanoseconds tolerance_;
  std::optional<Range> range_;
};

}  // namespace capture
