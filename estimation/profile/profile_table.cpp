#include "estimation/profile/profile_table.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace estimation {
namespace {

using std::numbers::pi;

constexpr double kSmallestHarmonic = 3e-5;  // of the mean; a tenth of the best signal's noise

constexpr std::size_t kBlock = 16;  // harmonics computed at a time

// Three periods' worth of harmonics hold a stripe's edge to 1e-3; 128 bound the table's memory.
std::size_t harmonic_limit(StripeShape shape) {
  return static_cast<std::size_t>(std::min(3 * shape.period_px, 128));
}

double stripe_harmonic(StripeShape shape, std::size_t n) {
  const double x = pi * static_cast<double>(n) * shape.width_px / shape.period_px;
  return std::sin(x) / x;
}

std::size_t count_above(std::span<const float> harmonics, double smallest) {
  std::size_t count = harmonics.size();
  while (count > 1 && static_cast<double>(std::abs(harmonics[count - 1])) < smallest) --count;
  return count;
}

// The harmonics of one entry, block by block until R~ (which falls with frequency) is negligible;
// returns how many of them count. The rest of `harmonics` stays zero.
std::size_t fill_entry(const ScatteringModel& model, StripeShape shape, double reflectance,
                       double l_d_px, std::span<float> harmonics) {
  double k_times_l_d[kBlock], transform[kBlock];
  const double zero = 0;
  double total = 0;
  model.transform(reflectance, {&zero, 1}, {&total, 1});
  for (std::size_t first = 1; first <= harmonics.size(); first += kBlock) {
    const std::size_t count = std::min(kBlock, harmonics.size() + 1 - first);
    for (std::size_t i = 0; i < count; ++i)
      k_times_l_d[i] = 2 * pi * static_cast<double>(first + i) / shape.period_px * l_d_px;
    model.transform(reflectance, {k_times_l_d, count}, {transform, count});
    for (std::size_t i = 0; i < count; ++i)
      harmonics[first + i - 1] =
          static_cast<float>(stripe_harmonic(shape, first + i) * transform[i] / total);
    if (transform[count - 1] < kSmallestHarmonic * total) break;
  }
  return count_above(harmonics, kSmallestHarmonic);
}

}  // namespace

std::vector<float> profile_harmonics(const ScatteringModel& model, StripeShape shape,
                                     double diffuse_reflectance, double translucency_px) {
  std::vector<float> harmonics(harmonic_limit(shape));
  harmonics.resize(fill_entry(model, shape, diffuse_reflectance, translucency_px, harmonics));
  return harmonics;
}

ProfileTable::ProfileTable(const ScatteringModel& model, StripeShape shape, const TableRange& range)
    : shape_(shape),
      range_(range),
      log_step_(std::log(range.greatest_translucency_px / range.least_translucency_px) /
                (kCols - 1)),
      stride_(harmonic_limit(shape)),
      harmonics_(stride_ * kRows * kCols),
      counts_(static_cast<std::size_t>(kRows) * kCols) {
  tbb::parallel_for(0, kRows, [&](int row) {
    const double reflectance = std::lerp(range_.least_reflectance, range_.greatest_reflectance,
                                         static_cast<double>(row) / (kRows - 1));
    for (int col = 0; col < kCols; ++col) {
      const std::size_t entry = index(row, col);
      counts_[entry] = fill_entry(model, shape_, reflectance, translucency_px_at(col),
                                  {harmonics_.data() + entry * stride_, stride_});
    }
  });
}

double ProfileTable::row_of(double diffuse_reflectance) const {
  return (diffuse_reflectance - range_.least_reflectance) /
         (range_.greatest_reflectance - range_.least_reflectance) * (kRows - 1);
}

double ProfileTable::translucency_px_at(double col) const {
  return range_.least_translucency_px * std::exp(log_step_ * col);
}

}  // namespace estimation
