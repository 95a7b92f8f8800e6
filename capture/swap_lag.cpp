#include "capture/swap_lag.h"

#include <algorithm>

namespace capture {

using std::chrono::nanoseconds;

std::optional<nanoseconds> SwapLag::learn(nanoseconds lag) {
  if (!range_) range_ = Range{lag, lag};
  const Range wider{std::min(range_->least, lag), std::max(range_->greatest, lag)};
  if (wider.greatest - wider.least > tolerance_)
    return lag - (lag < range_->least ? range_->greatest : range_->least);
  range_ = wider;
  return std::nullopt;
}

std::optional<nanoseconds> SwapLag::check(nanoseconds lag) {
  if (!range_) return learn(lag);
  const nanoseconds off = lag - range_->greatest;
  if (std::chrono::abs(off) <= tolerance_) return std::nullopt;
  return off;
}

}  // namespace capture
