#include "capture/calibrate/calibration_plans.h"

#include <cmath>
#include <numbers>
#include <numeric>
#include <variant>

namespace capture {
namespace {

using estimation::Axis;
using estimation::Black;
using estimation::Fringe;
using estimation::PatternKind;
using estimation::Stripes;
using estimation::White;

// Multiples of the shortest exposure; six are as many as the usual camera's sequencer has sets.
constexpr int kMultiples[] = {1, 2, 3, 4, 6, 8};
constexpr int kDarkRepeats = 4, kWhiteRepeats = 2, kGreyRepeats = 4;
// Of 255: what an eight-bit picture can show exactly.
constexpr int kGreyLevels[] = {32, 64, 128};

// A fringe so wide that no picture shows any of its slope.
PatternKind grey(int level) {
  constexpr double kPeriodPx = 1e9;
  const double phase = std::acos(2.0 * level / 255 - 1);
  return Fringe{Axis::kColumn, kPeriodPx, -kPeriodPx * phase / (2 * std::numbers::pi)};
}

Plan plan_of(std::string name, const std::vector<PatternKind>& kinds,
             std::vector<std::chrono::microseconds> exposures) {
  Plan plan;
  plan.name = std::move(name);
  plan.exposures = std::move(exposures);
  for (const PatternKind& kind : kinds)
    plan.patterns.push_back({static_cast<int>(plan.patterns.size()), kind});
  plan.order.resize(plan.patterns.size());
  std::iota(plan.order.begin(), plan.order.end(), 0);
  return plan;
}

// The paper's plan for this projector, in its order.
std::vector<PatternKind> paper_kinds(const rig::RigFile& rig_file) {
  std::vector<PatternKind> kinds;
  const auto paper = make_plan("paper", rig_file.projector, rig_file.sequence);
  for (const estimation::Pattern& pattern : paper->patterns) kinds.push_back(pattern.kind);
  return kinds;
}

// The paper shows its fine stripes at four shifts, which cannot tell their third and fifth
// harmonics from the first: its phase then errs by up to 0.6 px, four times a period. Over a face's
// many pixels the sweep puts that right; a corner has a few rows of pixels that may all err alike.
Stripes between(Stripes stripes) {
  constexpr int kPaperShifts = 4;
  stripes.shift_px += stripes.period_px / (2 * kPaperShifts);
  return stripes;
}

}  // namespace

Plan board_plan(const rig::RigFile& rig_file) {
  std::vector<PatternKind> kinds{White{}, Black{}};
  for (const PatternKind& kind : paper_kinds(rig_file)) {
    const auto* stripes = std::get_if<Stripes>(&kind);
    if (stripes && stripes->period_px == Stripes{}.period_px) continue;
    kinds.push_back(kind);
    if (stripes) kinds.emplace_back(between(*stripes));
  }
  return plan_of("board", kinds, rig_file.sequence.exposures);
}

Plan target_plan(const rig::RigFile& rig_file) {
  std::vector<PatternKind> kinds{White{}, Black{}};
  for (const PatternKind& kind : paper_kinds(rig_file)) kinds.push_back(kind);
  return plan_of("target", kinds, rig_file.sequence.exposures);
}

std::vector<std::chrono::microseconds> series_exposures(const rig::RigFile& rig_file) {
  std::vector<std::chrono::microseconds> exposures;
  for (const int multiple : kMultiples)
    exposures.push_back(multiple * rig_file.sequence.exposures.front());
  return exposures;
}

Plan dark_plan(const rig::RigFile& rig_file) {
  return plan_of("dark", std::vector<PatternKind>(kDarkRepeats, Black{}),
                 series_exposures(rig_file));
}

Plan series_plan(const rig::RigFile& rig_file) {
  std::vector<PatternKind> kinds;
  for (int i = 0; i < kWhiteRepeats; ++i) kinds.insert(kinds.end(), {White{}, Black{}});
  for (const int level : kGreyLevels) kinds.insert(kinds.end(), kGreyRepeats, grey(level));
  return plan_of("series", kinds, series_exposures(rig_file));
}

}  // namespace capture
