#include "estimation/geometry/period.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>

namespace estimation {
namespace {

constexpr double kBinsPerPx = 2;
// How far a bit's contrast may be from the soft one, as a standard deviation: blur varies.
constexpr float kModelVariance = 0.35F * 0.35F;
// A phase contradicting by more than 3.5 standard deviations counts as 3.5: it may be the wrong
// one.
constexpr float kMaxPhaseCost = 6;
constexpr float kOutside = -1e6F;

double wrap(double value, double period) { return value - period * std::floor(value / period); }

// To the nearest integer for |value| < 2^22; unlike std::nearbyint the compiler makes it one
// addition and one subtraction of four floats at once.
float nearest(float value) {
  constexpr float kShift = 12582912.0F;  // 1.5 * 2^23: the sum has no bits left for a fraction
  return (value + kShift) - kShift;
}

}  // namespace

double soft_gray_bit(int bit, double position_px) {
  // Lit from 2^bit to 3 * 2^bit - 1 in every 4 * 2^bit; pixel edges lie at halves.
  const auto run_px = static_cast<double>(std::int64_t{1} << bit);
  const double in_period = wrap(position_px + 0.5, 4 * run_px);
  const double past_centre = std::abs(in_period - 2 * run_px);  // the lit run's centre
  const double inside_px = run_px - past_centre;                // of the lit run; negative outside
  const double ramp_px = std::min(double{kGrayRampPx}, run_px);
  return std::clamp(inside_px / ramp_px, -1.0, 1.0);
}

PeriodChooser::PeriodChooser(double period_px, int size_px, std::vector<int> bits)
    : period_px_(period_px),
      bin_count_(static_cast<int>(std::ceil(period_px * kBinsPerPx))),
      candidate_count_(static_cast<int>(std::ceil(size_px / period_px)) + 2),
      bits_(std::move(bits)) {
  for (int bin = 0; bin < bin_count_; ++bin) {
    const double phase_px = (bin + 0.5) / kBinsPerPx;
    const auto position_px = [&](int candidate) { return phase_px + (candidate - 1) * period_px; };
    for (const int bit : bits_) {
      for (int c = 0; c < candidate_count_; ++c) {
        expected_.push_back(static_cast<float>(soft_gray_bit(bit, position_px(c))));
      }
    }
    for (int c = 0; c < candidate_count_; ++c) {
      const bool is_inside = position_px(c) > -1.25 && position_px(c) < size_px + 0.25;
      base_.push_back(is_inside ? 0.0F : kOutside);
    }
  }
}

PeriodChoice PeriodChooser::choose(const PhaseReading& phase, std::span<const BitReading> bits,
                                   std::span<const PhaseReading> others,
                                   std::vector<float>& scratch) const {
  const double phase_px = wrap(static_cast<double>(phase.position_px), period_px_);
  const int bin = std::min(static_cast<int>(phase_px * kBinsPerPx), bin_count_ - 1);
  const auto count = static_cast<std::size_t>(candidate_count_);
  const float* base = base_.data() + static_cast<std::size_t>(bin) * count;
  scratch.assign(base, base + count);
  float* score = scratch.data();

  const float* expected = expected_.data() + static_cast<std::size_t>(bin) * bits_.size() * count;
  for (std::size_t j = 0; j < bits_.size(); ++j, expected += count) {
    if (!std::isfinite(bits[j].variance)) continue;
    const float weight = 1.0F / (kModelVariance + bits[j].variance);
    const float value = bits[j].value;
    for (std::size_t c = 0; c < count; ++c) {
      score[c] += weight * expected[c] * (value - 0.5F * expected[c]);
    }
  }
  const auto slack_px2 = static_cast<float>(slack_px_ * slack_px_);
  for (const PhaseReading& other : others) {
    const float variance = other.sd_px * other.sd_px + phase.sd_px * phase.sd_px + slack_px2;
    const float inverse_variance = 0.5F / variance;
    const float inverse_period = 1.0F / other.period_px;
    const auto period_px = static_cast<float>(period_px_);
    const float first_px = static_cast<float>(phase_px) - period_px - other.position_px;
    for (int c = 0; c < candidate_count_; ++c) {
      const float difference_px = first_px + static_cast<float>(c) * period_px;
      const float residual_px =
          difference_px - other.period_px * nearest(difference_px * inverse_period);
      const float cost = residual_px * residual_px * inverse_variance;
      score[c] -= cost < kMaxPhaseCost ? cost : kMaxPhaseCost;
    }
  }

  std::size_t best = 0;
  float second = -std::numeric_limits<float>::infinity();
  for (std::size_t c = 1; c < count; ++c) {
    if (score[c] > score[best]) {
      second = score[best];
      best = c;
    } else {
      second = std::max(second, score[c]);
    }
  }
  return {phase_px + (static_cast<double>(best) - 1) * period_px_,
          static_cast<double>(score[best] - second)};
}

}  // namespace estimation
