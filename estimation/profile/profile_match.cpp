#include "estimation/profile/profile_match.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numbers>
#include <numeric>

#include "estimation/base/check.h"

namespace estimation {
namespace {

using std::numbers::pi;

constexpr int kScanStep = 12;            // columns; the cost's valley is several times wider
constexpr int kFirstStep = 2;            // of the bracket around a known start
constexpr std::size_t kTroughShare = 8;  // the darkest eighth of a profile is its minimum

bool are_evenly_spaced(const StripeSet& stripes) {
  const int count = static_cast<int>(stripes.shifts_px.size());
  if (stripes.shape.period_px % count != 0) return false;
  const int step = stripes.shape.period_px / count;
  for (int i = 0; i < count; ++i)
    if (stripes.shifts_px[static_cast<std::size_t>(i)] != stripes.shifts_px[0] + i * step)
      return false;
  return true;
}

}  // namespace

ProfileMatcher::ProfileMatcher(const StripeSet& stripes, int greatest_harmonic_count, Metric metric)
    : shape_(stripes.shape),
      shifts_px_(stripes.shifts_px),
      harmonic_count_(static_cast<std::size_t>(greatest_harmonic_count)),
      is_even_(metric == Metric::kFastest && are_evenly_spaced(stripes)) {
  const std::size_t count = shifts_px_.size();
  check(count > 0, "stripes of at least one shift");
  predicted_.resize(count);
  harmonics_.reserve(harmonic_count_);
  basis_re_.resize(is_even_ ? harmonic_count_ : harmonic_count_ * count);
  basis_im_.resize(is_even_ ? harmonic_count_ : 0);
  if (!is_even_) return;
  bin_count_ = count / 2 + 1;
  for (std::size_t bin = 0; bin < bin_count_; ++bin)
    for (std::size_t i = 0; i < count; ++i) {
      const double angle =
          2 * pi * static_cast<double>(bin * i % count) / static_cast<double>(count);
      bin_cos_.push_back(std::cos(angle));
      bin_sin_.push_back(std::sin(angle));
    }
  for (std::size_t n = 1; n <= harmonic_count_; ++n)
    bin_of_.push_back(std::min(n % count, count - n % count));
  bin_weight_.assign(bin_count_, 2 * static_cast<double>(count));
  bin_weight_[0] = 0;
  if (count % 2 == 0) bin_weight_.back() = static_cast<double>(count);
  for (auto* bins : {&data_re_, &data_im_, &model_re_, &model_im_}) bins->resize(bin_count_);
}

void ProfileMatcher::load(std::span<const double> samples, double position_px,
                          std::span<const float> contrast) {
  check(samples.size() == shifts_px_.size() && contrast.size() == harmonic_count_,
        "a sample for each shift, a contrast for each harmonic");
  const std::size_t count = samples.size();
  check(count > 0, "at least one sample");
  samples_.assign(samples.begin(), samples.end());
  mean_ = 0;
  for (const double sample : samples) mean_ += sample;
  mean_ /= static_cast<double>(count);
  const double centre_px = 0.5 * (shape_.width_px - 1);
  const auto phase_at = [&](int shift) {
    return 2 * pi * (position_px - shift - centre_px) / shape_.period_px;
  };
  if (!is_even_) {
    for (std::size_t i = 0; i < count; ++i)
      for (std::size_t n = 1; n <= contrast.size(); ++n)
        basis_re_[i * contrast.size() + n - 1] =
            2 * static_cast<double>(contrast[n - 1]) *
            std::cos(static_cast<double>(n) * phase_at(shifts_px_[i]));
    return;
  }
  for (std::size_t bin = 0; bin < bin_count_; ++bin) {
    double re = 0, im = 0;
    for (std::size_t i = 0; i < count; ++i) {
      re += samples[i] * bin_cos_[bin * count + i];
      im += samples[i] * bin_sin_[bin * count + i];
    }
    data_re_[bin] = re / static_cast<double>(count);
    data_im_[bin] = im / static_cast<double>(count);
  }
  // Harmonic n at shift i is cos(n phase_0 - 2 pi n i / S): sampled, it appears in bin n mod S with
  // e^(+i n phase_0) or, folded, in bin S - n mod S with e^(-i n phase_0); in bins 0 and S/2 as
  // both.
  const std::complex<double> turn = std::polar(1.0, phase_at(shifts_px_[0]));
  std::complex<double> phasor = 1;
  for (std::size_t n = 1; n <= contrast.size(); ++n) {
    phasor *= turn;
    const double m = static_cast<double>(contrast[n - 1]);
    const std::size_t bin = bin_of_[n - 1];
    const bool is_both = bin == 0 || 2 * bin == count;
    const bool is_folded = n % count != bin;
    basis_re_[n - 1] = (is_both ? 2 : 1) * m * phasor.real();
    basis_im_[n - 1] = is_both ? 0 : (is_folded ? -m : m) * phasor.imag();
  }
}

void ProfileMatcher::mix_harmonics(const ProfileTable& table, double row, int col) {
  const int lower = std::clamp(static_cast<int>(row), 0, ProfileTable::kRows - 2);
  const double upper_frac = std::clamp(row - lower, 0.0, 1.0);
  const std::span<const double> low = table.harmonics(lower, col);
  const std::span<const double> high = table.harmonics(lower + 1, col);
  harmonics_.resize(std::max(low.size(), high.size()));
  const std::size_t common = std::min(low.size(), high.size());
  for (std::size_t n = 0; n < common; ++n)
    harmonics_[n] = (1 - upper_frac) * low[n] + upper_frac * high[n];
  for (std::size_t n = common; n < harmonics_.size(); ++n)
    harmonics_[n] = n < low.size() ? (1 - upper_frac) * low[n] : upper_frac * high[n];
}

double ProfileMatcher::cost_of_harmonics(double offset) {
  std::fill(model_re_.begin(), model_re_.end(), 0.0);
  std::fill(model_im_.begin(), model_im_.end(), 0.0);
  for (std::size_t n = 0; n < harmonics_.size(); ++n) {
    model_re_[bin_of_[n]] += harmonics_[n] * basis_re_[n];
    model_im_[bin_of_[n]] += harmonics_[n] * basis_im_[n];
  }
  const double data_scale = 1 / (mean_ - offset);
  const double model_scale = 1 / (1 + model_re_[0]);
  double sum = 0;
  for (std::size_t bin = 1; bin < bin_count_; ++bin) {
    const double re = data_re_[bin] * data_scale - model_re_[bin] * model_scale;
    const double im = data_im_[bin] * data_scale - model_im_[bin] * model_scale;
    sum += bin_weight_[bin] * (re * re + im * im);
  }
  return sum;
}

// The mixed profile at the sampled shifts into predicted_.
void ProfileMatcher::predict_samples() {
  const std::size_t count = shifts_px_.size();
  if (!is_even_) {
    const std::size_t stride = harmonic_count_;
    for (std::size_t i = 0; i < count; ++i) {
      double sum = 1;
      for (std::size_t n = 0; n < harmonics_.size(); ++n)
        sum += harmonics_[n] * basis_re_[i * stride + n];
      predicted_[i] = sum;
    }
    return;
  }
  std::fill(model_re_.begin(), model_re_.end(), 0.0);
  std::fill(model_im_.begin(), model_im_.end(), 0.0);
  for (std::size_t n = 0; n < harmonics_.size(); ++n) {
    model_re_[bin_of_[n]] += harmonics_[n] * basis_re_[n];
    model_im_[bin_of_[n]] += harmonics_[n] * basis_im_[n];
  }
  for (std::size_t i = 0; i < count; ++i) {
    double sum = 1 + model_re_[0];
    for (std::size_t bin = 1; bin < bin_count_; ++bin)
      sum += (2 * bin == count ? 1 : 2) * (model_re_[bin] * bin_cos_[bin * count + i] +
                                           model_im_[bin] * bin_sin_[bin * count + i]);
    predicted_[i] = sum;
  }
}

double ProfileMatcher::cost_of_samples(double offset) {
  predict_samples();
  double predicted_mean = 0;
  for (const double value : predicted_) predicted_mean += value;
  predicted_mean /= static_cast<double>(predicted_.size());
  double sum = 0;
  for (std::size_t i = 0; i < samples_.size(); ++i) {
    const double difference =
        (samples_[i] - offset) / (mean_ - offset) - predicted_[i] / predicted_mean;
    sum += difference * difference;
  }
  return sum;
}

double ProfileMatcher::cost(const ProfileTable& table, double row, int col, double offset) {
  mix_harmonics(table, row, col);
  return is_even_ ? cost_of_harmonics(offset) : cost_of_samples(offset);
}

ProfileMatch ProfileMatcher::search(const ProfileTable& table, double row, double offset,
                                    double from_col) {
  constexpr int kLast = ProfileTable::kCols - 1;
  const auto cost_at = [&](int col) { return cost(table, row, col, offset); };
  struct Point {
    int col;
    double cost;
  };
  Point left{}, best{}, right{};
  if (from_col < 0) {
    best = {0, cost_at(0)};
    for (int col = kScanStep; col < kLast + kScanStep; col += kScanStep) {
      const Point point{std::min(col, kLast), cost_at(std::min(col, kLast))};
      if (point.cost < best.cost) best = point;
    }
    left = {std::max(best.col - kScanStep, 0), 0};
    right = {std::min(best.col + kScanStep, kLast), 0};
    left.cost = left.col == best.col ? best.cost : cost_at(left.col);
    right.cost = right.col == best.col ? best.cost : cost_at(right.col);
  } else {
    // Walk downhill with growing steps until the cost rises on both sides.
    const int start = std::clamp(static_cast<int>(std::lround(from_col)), 0, kLast);
    best = {start, cost_at(start)};
    int step = kFirstStep;
    left = {std::max(start - step, 0), 0};
    right = {std::min(start + step, kLast), 0};
    left.cost = left.col == best.col ? best.cost : cost_at(left.col);
    right.cost = right.col == best.col ? best.cost : cost_at(right.col);
    while (left.cost < best.cost && left.col < best.col) {
      step *= 2;
      right = best;
      best = left;
      left = {std::max(best.col - step, 0), 0};
      left.cost = left.col == best.col ? best.cost : cost_at(left.col);
    }
    while (right.cost < best.cost && right.col > best.col) {
      step *= 2;
      left = best;
      best = right;
      right = {std::min(best.col + step, kLast), 0};
      right.cost = right.col == best.col ? best.cost : cost_at(right.col);
    }
  }
  // Close in: the vertex of the parabola through the three points, on a column of its own.
  while (right.col - left.col > 2) {
    if (left.col == best.col || right.col == best.col) {
      // The valley opens at the table's edge; look beside the best column.
      const int inward = left.col == best.col ? best.col + 1 : best.col - 1;
      const Point point{inward, cost_at(inward)};
      if (point.cost >= best.cost) return {.cost = best.cost, .is_at_edge = true};
      (left.col == best.col ? left : right) = best;
      best = point;
      continue;
    }
    const double to_left = best.col - left.col, to_right = right.col - best.col;
    const double rise_left = (left.cost - best.cost) / to_left;
    const double rise_right = (right.cost - best.cost) / to_right;
    const double bend = rise_left + rise_right;
    double step = bend > 0 ? 0.5 * (rise_left * to_right - rise_right * to_left) / bend : 0;
    int col = best.col + static_cast<int>(std::lround(step));
    if (col == best.col) {
      const bool look_left = to_left > 1 && (to_right <= 1 || step < 0);
      col = look_left ? best.col - 1 : best.col + 1;
    }
    col = std::clamp(col, left.col + 1, right.col - 1);
    if (col == best.col) col = to_left > 1 ? best.col - 1 : best.col + 1;
    const Point point{col, cost_at(col)};
    if (point.cost < best.cost) {
      (point.col < best.col ? right : left) = best;
      best = point;
    } else {
      (point.col < best.col ? left : right) = point;
    }
  }
  if (left.col == best.col || right.col == best.col) return {.cost = best.cost, .is_at_edge = true};
  const double curvature = left.cost - 2 * best.cost + right.cost;
  const double offset_cols = curvature > 0 ? 0.5 * (left.cost - right.cost) / curvature : 0;
  return {.col = best.col + offset_cols,
          .cost = std::max(best.cost - 0.5 * curvature * offset_cols * offset_cols, 0.0),
          .curvature = curvature};
}

ProfileMatcher::Curve ProfileMatcher::curve(const ProfileTable& table, double row, double col) {
  // Between columns the profile is interpolated linearly; a column is 2 to 4% of l_d.
  const int lower = std::clamp(static_cast<int>(col), 0, ProfileTable::kCols - 2);
  const double upper_frac = std::clamp(col - lower, 0.0, 1.0);
  mix_harmonics(table, row, lower);
  predict_samples();
  std::vector<double> values = predicted_;
  mix_harmonics(table, row, lower + 1);
  predict_samples();
  double sum = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    values[i] = std::lerp(values[i], predicted_[i], upper_frac);
    sum += values[i];
  }
  const double mean = sum / static_cast<double>(values.size());
  std::vector<std::size_t> darkest_first(values.size());
  std::iota(darkest_first.begin(), darkest_first.end(), 0);
  std::stable_sort(darkest_first.begin(), darkest_first.end(),
                   [&](std::size_t a, std::size_t b) { return values[a] < values[b]; });
  const std::size_t count = std::max<std::size_t>(1, values.size() / kTroughShare);
  Curve curve{.trough = 0, .trough_of_samples = 0, .mean = mean};
  for (std::size_t i = 0; i < count; ++i) {
    curve.trough += values[darkest_first[i]] / mean / static_cast<double>(count);
    curve.trough_of_samples += samples_[darkest_first[i]] / static_cast<double>(count);
  }
  return curve;
}

}  // namespace estimation
