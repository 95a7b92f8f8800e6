// Which of a session's patterns sweep a stripe over the subject, and where their samples lie.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "estimation/session/pattern.h"

namespace estimation {

struct StripeShape {
  int period_px = 40;
  int width_px = 8;
  bool operator==(const StripeShape&) const = default;
};

struct StripeSet {
  Axis axis = Axis::kColumn;
  StripeShape shape;
  std::vector<int> shifts_px{};                     // distinct, rising, 0..period-1
  std::vector<std::vector<std::size_t>> sources{};  // [shift] indices into the patterns given
};

// The set fit for scattering profiles: the one with the largest number of shifts times period (many
// samples of a wide period; the few shifts of a fine set only serve correspondence), columns before
// rows if equal. nullopt if no set has at least five shifts.
std::optional<StripeSet> choose_stripe_set(std::span<const PatternKind* const> patterns);

}  // namespace estimation
