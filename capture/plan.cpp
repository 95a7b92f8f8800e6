#include "capture/plan.h"

#include <bit>
#include <cstdint>
#include <numeric>
#include <random>
#include <utility>

namespace capture {
namespace {

using estimation::Axis;
using estimation::GrayCode;
using estimation::Pattern;
using estimation::Stripes;

constexpr std::uint64_t kShuffleSeed = 88;  // any fixed number: the order must be the same each day

void add_gray_code(Axis axis, int size_px, std::vector<Pattern>& patterns) {
  const auto bit_count = static_cast<int>(std::bit_width(static_cast<unsigned>(size_px - 1)));
  for (int bit = bit_count - 1; bit >= 0; --bit) {
    for (const bool inverted : {false, true})
      patterns.push_back({static_cast<int>(patterns.size()), GrayCode{axis, bit, inverted}});
  }
}

// The paper's patterns, its ten-bit Gray codes replaced by codes of as many bits as are needed.
std::vector<Pattern> paper_patterns_for(const rig::ProjectorSettings& projector) {
  std::vector<Pattern> patterns;
  const GrayCode* previous = nullptr;
  const std::vector<Pattern> paper = estimation::paper_patterns();
  for (const Pattern& pattern : paper) {
    const auto* gray = std::get_if<GrayCode>(&pattern.kind);
    const bool is_first_of_axis = gray && (!previous || previous->axis != gray->axis);
    if (is_first_of_axis)
      add_gray_code(gray->axis,
                    gray->axis == Axis::kColumn ? projector.width_px : projector.height_px,
                    patterns);
    if (gray)
      previous = gray;
    else
      patterns.push_back({static_cast<int>(patterns.size()), pattern.kind});
  }
  return patterns;
}

bool is_shift(const Pattern& pattern) {
  const auto* stripes = std::get_if<Stripes>(&pattern.kind);
  return stripes && stripes->period_px == Stripes{}.period_px;
}

// Fisher and Yates over the places that hold stripe shifts. Not std::shuffle: its order differs
// between libraries.
void shuffle_shifts(Plan& plan) {
  std::vector<std::size_t> places;
  for (std::size_t i = 0; i < plan.order.size(); ++i)
    if (is_shift(plan.patterns[static_cast<std::size_t>(plan.order[i])])) places.push_back(i);
  std::mt19937_64 random(kShuffleSeed);
  for (std::size_t i = places.size(); i > 1; --i)
    std::swap(plan.order[places[i - 1]], plan.order[places[random() % i]]);
}

}  // namespace

std::string to_string(SlotId slot) {
  return "pattern " + std::to_string(slot.pattern) + " bracket " + std::to_string(slot.bracket);
}

rig::Result<Plan> make_plan(std::string_view name, const rig::ProjectorSettings& projector,
                            const rig::SequenceSettings& sequence) {
  if (name != "paper")
    return rig::failure(rig::Fault::kConfiguration,
                        "there is no plan \"" + std::string(name) + "\"; choose \"paper\"");
  Plan plan{std::string(name), paper_patterns_for(projector), {}, sequence.exposures};
  plan.order.resize(plan.patterns.size());
  std::iota(plan.order.begin(), plan.order.end(), 0);
  if (sequence.is_shuffled) shuffle_shifts(plan);
  return plan;
}

std::vector<estimation::Image<unsigned char>> render_pictures(
    const Plan& plan, const rig::ProjectorSettings& projector) {
  std::vector<estimation::Image<unsigned char>> pictures;
  pictures.reserve(plan.patterns.size());
  for (const Pattern& pattern : plan.patterns)
    pictures.push_back(
        estimation::render_pattern(pattern.kind, projector.height_px, projector.width_px));
  return pictures;
}

}  // namespace capture
