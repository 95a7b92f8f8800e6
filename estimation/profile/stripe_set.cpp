#include "estimation/profile/stripe_set.h"

#include <map>
#include <tuple>

namespace estimation {
namespace {

// R_d, l_d and the indirect light are three unknowns, and the fewest shifts that oversample them.
constexpr std::size_t kFewestShifts = 5;

}  // namespace

std::optional<StripeSet> choose_stripe_set(std::span<const PatternKind* const> patterns) {
  using Key = std::tuple<Axis, int, int>;  // axis, period, width
  std::map<Key, std::map<int, std::vector<std::size_t>>> sets;
  for (std::size_t i = 0; i < patterns.size(); ++i) {
    const auto* stripes = std::get_if<Stripes>(patterns[i]);
    if (stripes == nullptr || stripes->width_px >= stripes->period_px) continue;
    const int shift =
        ((stripes->shift_px % stripes->period_px) + stripes->period_px) % stripes->period_px;
    sets[{stripes->axis, stripes->period_px, stripes->width_px}][shift].push_back(i);
  }
  std::optional<StripeSet> best;
  std::size_t best_size = 0;
  for (const auto& [key, samples] : sets) {
    const auto& [axis, period_px, width_px] = key;
    const std::size_t size = samples.size() * static_cast<std::size_t>(period_px);
    if (samples.size() < kFewestShifts || size <= best_size) continue;
    best_size = size;
    best = StripeSet{.axis = axis, .shape = {.period_px = period_px, .width_px = width_px}};
    for (const auto& [shift, sources] : samples) {
      best->shifts_px.push_back(shift);
      best->sources.push_back(sources);
    }
  }
  return best;
}

}  // namespace estimation
