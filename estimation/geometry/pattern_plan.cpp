#include "estimation/geometry/pattern_plan.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <map>
#include <numbers>
#include <tuple>
#include <utility>

namespace estimation {
namespace {

void add_bit(const GrayCode& code, std::size_t signal, std::vector<BitSource>& bits) {
  auto place = std::find_if(bits.begin(), bits.end(),
                            [&](const BitSource& source) { return source.bit == code.bit; });
  if (place == bits.end()) place = bits.insert(bits.end(), BitSource{code.bit, {}, {}});
  (code.inverted ? place->inverse : place->plain) = signal;
}

constexpr double kLargestPeriodFrac = 4;  // of the projector's size

// Period and width (0: fringes), by falling period.
using FamilyKey = std::pair<double, int>;
struct Samples {
  std::vector<double> shift_px;
  std::vector<std::size_t> signals;
};
using FamilyMap = std::map<FamilyKey, Samples, std::greater<>>;

std::string name_of(const PhaseFamily& family) {
  std::string period = std::to_string(family.period_px);
  period.erase(period.find_last_not_of('0') + 1);
  if (period.back() == '.') period.pop_back();
  return (family.axis == Axis::kColumn ? "column " : "row ") +
         std::string(family.width_px > 0 ? "stripes" : "fringes") + " of period " + period + " px";
}

// Why no phase can come of a family, whatever its shifts; empty if one can.
std::string objection_to(const PhaseFamily& family, int size_px) {
  // Two px are the finest pattern there is, and lit px by px it has no sign of direction.
  if (!(family.period_px > 2)) return "are finer than a projector can show";
  if (family.width_px >= family.period_px) return "are lit everywhere";
  // Hardly any of its slope is on the projector; it would only cost memory.
  if (family.period_px > kLargestPeriodFrac * size_px) return "are flat on this projector";
  return {};
}

void add_families(Axis axis, const FamilyMap& samples, const CorrespondenceOptions& options,
                  AxisPlan& plan, std::vector<std::string>& notes) {
  std::vector<int> bits;
  for (const BitSource& source : plan.bits) bits.push_back(source.bit);
  for (const auto& [key, group] : samples) {
    const PhaseFamily family{axis, key.first, key.second, group.shift_px};
    if (const std::string objection = objection_to(family, plan.size_px); !objection.empty()) {
      notes.push_back("the " + name_of(family) + " " + objection + ": not used");
      continue;
    }
    const std::vector<char> all(group.shift_px.size(), 1);
    auto weights = make_demodulation(family, all, options.least_blur_px);
    if (!weights) {
      const std::size_t count = group.shift_px.size();
      notes.push_back((count == 1 ? "one shift" : std::to_string(count) + " shifts") + " of the " +
                      name_of(family) +
                      (count == 1 ? " does not determine a phase: not used"
                                  : " do not determine a phase: not used"));
      continue;
    }
    // Every pixel would be "too dark" for a phase whose error no light makes smaller.
    if (weights->aliasing_px > options.max_sd_px) {
      notes.push_back(std::to_string(group.shift_px.size()) + " shifts of the " + name_of(family) +
                      " tell a phase to some " + std::to_string(std::lround(weights->aliasing_px)) +
                      " px at best: not used");
      continue;
    }
    const double amplitude_frac =
        family.width_px == 0
            ? 0.5
            : 2 / std::numbers::pi *
                  std::abs(std::sin(std::numbers::pi * family.width_px / family.period_px));
    plan.families.push_back({family, group.signals, *std::move(weights),
                             PeriodChooser(family.period_px, plan.size_px, bits), amplitude_frac});
  }
}

// Bits a projector of this size needs, the lowest ones included.
int needed_bit_count(int size_px) {
  return static_cast<int>(std::bit_width(static_cast<unsigned>(size_px - 1)));
}

std::string missing_bits(const AxisPlan& plan) {
  std::string list;
  for (int bit = needed_bit_count(plan.size_px) - 1; bit >= 0; --bit) {
    const bool has = std::any_of(plan.bits.begin(), plan.bits.end(),
                                 [&](const BitSource& source) { return source.bit == bit; });
    if (!has) list += (list.empty() ? "" : ", ") + std::to_string(bit);
  }
  return list;
}

// Columns of a perfect signal whose period is not told apart from another, with the finest phase.
int ambiguous_count(const AxisPlan& plan, const CorrespondenceOptions& options) {
  int count = 0;
  std::vector<float> scratch;
  for (int position = 0; position < plan.size_px; ++position) {
    std::vector<BitReading> bits;
    for (const BitSource& source : plan.bits) {
      bits.push_back({static_cast<float>(soft_gray_bit(source.bit, position)), 0});
    }
    std::vector<PhaseReading> phases;
    for (const FamilySource& source : plan.families) {
      phases.push_back({static_cast<float>(source.family.period_px),
                        static_cast<float>(std::fmod(position, source.family.period_px)),
                        static_cast<float>(source.weights.aliasing_px)});
    }
    const std::span others(phases);
    const PeriodChoice choice =
        plan.families.front().chooser.choose(phases.front(), bits, others.subspan(1), scratch);
    if (choice.margin < options.min_period_margin) ++count;
  }
  return count;
}

// The slack between phases at which most columns are told apart, the usual one where it will do.
// Returns how many are not.
int choose_slack(AxisPlan& plan, const CorrespondenceOptions& options) {
  const auto count_with = [&](double slack_px) {
    for (FamilySource& source : plan.families) source.chooser.set_slack_px(slack_px);
    return ambiguous_count(plan, options);
  };
  double best_px = PeriodChooser::kUsualSlackPx;
  int fewest = count_with(best_px);
  for (const double slack_px : {0.35, 0.15}) {
    if (fewest == 0 || plan.families.size() < 2) break;
    const int count = count_with(slack_px);
    if (count >= fewest) continue;
    fewest = count;
    best_px = slack_px;
  }
  return count_with(best_px);
}

// Decides whether the axis can be decoded at all, and says what is missing.
void judge(const std::string& axis_name, AxisPlan& plan, const CorrespondenceOptions& options,
           std::vector<std::string>& notes) {
  if (plan.bits.empty() && plan.families.empty()) return;
  const std::string missing = missing_bits(plan);
  if (plan.families.empty()) {
    const int top = needed_bit_count(plan.size_px) - 1;
    plan.is_decodable = plan.bits.front().bit >= top;
    if (!plan.is_decodable) {
      notes.push_back(axis_name +
                      "s not decoded: Gray code lacks its high bits (missing: " + missing + ")");
    } else {
      plan.is_whole = missing.empty();
      notes.push_back(axis_name + "s to whole px only: no stripes or fringes along this axis" +
                      (missing.empty() ? "" : "; Gray code lacks bits " + missing));
    }
    return;
  }
  const int ambiguous = choose_slack(plan, options);
  plan.is_decodable = ambiguous < plan.size_px;
  plan.is_whole = ambiguous == 0;
  if (ambiguous == 0) return;
  const std::string cause =
      plan.bits.empty() ? std::string("there is no Gray code") : "Gray code lacks bits " + missing;
  if (plan.is_decodable) {
    notes.push_back(std::to_string(ambiguous) + " of " + std::to_string(plan.size_px) + " " +
                    axis_name + "s cannot be told from others: " + cause);
  } else {
    notes.push_back(axis_name + "s not decoded: " + cause +
                    ", and the phases repeat over the projector");
  }
}

AxisPlan plan_axis(Axis axis, int size_px, const SignalSet& set,
                   const CorrespondenceOptions& options, std::vector<std::string>& notes) {
  AxisPlan plan;
  plan.size_px = size_px;
  FamilyMap samples;
  for (std::size_t signal = 0; signal < set.sources.size(); ++signal) {
    const PatternKind* kind = set.sources[signal].kind;
    if (const auto* code = std::get_if<GrayCode>(kind); code && code->axis == axis) {
      add_bit(*code, signal, plan.bits);
    } else if (const auto* stripes = std::get_if<Stripes>(kind); stripes && stripes->axis == axis) {
      Samples& group = samples[{stripes->period_px, stripes->width_px}];
      group.shift_px.push_back(stripes->shift_px);
      group.signals.push_back(signal);
    } else if (const auto* fringe = std::get_if<Fringe>(kind); fringe && fringe->axis == axis) {
      Samples& group = samples[{fringe->period_px, 0}];
      group.shift_px.push_back(fringe->shift_px);
      group.signals.push_back(signal);
    }
  }
  std::sort(plan.bits.begin(), plan.bits.end(),
            [](const BitSource& a, const BitSource& b) { return a.bit > b.bit; });
  add_families(axis, samples, options, plan, notes);
  judge(axis == Axis::kColumn ? "column" : "row", plan, options, notes);
  return plan;
}

}  // namespace

PatternPlan plan_patterns(const SignalSet& signals, const ProjectorInfo& projector,
                          const CorrespondenceOptions& options) {
  PatternPlan plan;
  for (std::size_t i = 0; i < signals.sources.size(); ++i) {
    if (std::holds_alternative<White>(*signals.sources[i].kind)) plan.white = i;
    if (std::holds_alternative<Black>(*signals.sources[i].kind)) plan.black = i;
  }
  plan.column = plan_axis(Axis::kColumn, projector.width_px, signals, options, plan.notes);
  plan.row = plan_axis(Axis::kRow, projector.height_px, signals, options, plan.notes);
  return plan;
}

}  // namespace estimation
