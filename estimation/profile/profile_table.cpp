#include "estimation/profile/profile_table.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

namespace estimation {
namespace {

using std::numbers::pi;

constexpr double kVisible = 3e-5;    // of the mean; a tenth of the best signal's noise
constexpr double kComplete = 1e-12;  // of R_d; the sum of what lies beyond stays below 1e-10

// Three periods' worth of harmonics hold a stripe's edge to 1e-3; 128 bound the table's memory.
std::size_t harmonic_limit(StripeShape shape) {
  return static_cast<std::size_t>(std::min(3 * shape.period_px, 128));
}

// d sinc(n d) / d of n = 1, 2, ...
std::vector<double> stripe_harmonics(StripeShape shape) {
  std::vector<double> stripe(harmonic_limit(shape));
  for (std::size_t n = 1; n <= stripe.size(); ++n) {
    const double x = pi * static_cast<double>(n) * shape.width_px / shape.period_px;
    stripe[n - 1] = std::sin(x) / x;
  }
  return stripe;
}

// Harmonic n of l_d = 1 projector px.
double harmonic_frequency(StripeShape shape, std::size_t n) {
  return 2 * pi * static_cast<double>(n) / shape.period_px;
}

// Where R~ of this R_d has fallen below R_d * kComplete, in k l_d, rounded upwards: a model is
// asked for no harmonic beyond.
double last_frequency(const ScatteringModel& model, double reflectance) {
  constexpr double kLeast = 0.5, kRatio = 1.25;
  std::array<double, 64> k_times_l_d, transform;  // 0.5 to 6e5
  double next = kLeast;
  for (double& k : k_times_l_d) k = std::exchange(next, next * kRatio);
  model.transform(reflectance, k_times_l_d, transform);
  for (std::size_t i = transform.size(); i-- > 0;)
    if (!(std::abs(transform[i]) < kComplete * reflectance)) return k_times_l_d[i] * kRatio;
  return kLeast;
}

std::size_t count_visible(std::span<const double> harmonics) {
  std::size_t count = harmonics.size();
  while (count > 1 && std::abs(harmonics[count - 1]) < kVisible) --count;
  return count;
}

std::size_t count_up_to(double frequency, double l_d_px, StripeShape shape) {
  const double count = frequency / (harmonic_frequency(shape, 1) * l_d_px);
  const std::size_t limit = harmonic_limit(shape);
  return count < static_cast<double>(limit)
             ? std::max<std::size_t>(static_cast<std::size_t>(count), 1)
             : limit;
}

}  // namespace

std::vector<float> profile_harmonics(const ScatteringModel& model, StripeShape shape,
                                     double diffuse_reflectance, double translucency_px) {
  std::vector<double> harmonics = stripe_harmonics(shape);
  std::vector<double> k_times_l_d(harmonics.size() + 1), transform(harmonics.size() + 1);
  for (std::size_t n = 1; n < k_times_l_d.size(); ++n)
    k_times_l_d[n] = harmonic_frequency(shape, n) * translucency_px;
  model.transform(diffuse_reflectance, k_times_l_d, transform);
  for (std::size_t n = 1; n < transform.size(); ++n)
    harmonics[n - 1] *= transform[n] / transform[0];
  harmonics.resize(count_visible(harmonics));
  return {harmonics.begin(), harmonics.end()};
}

ProfileTable::ProfileTable(const ScatteringModel& model, StripeShape shape, const TableRange& range)
    : shape_(shape),
      range_(range),
      log_step_(std::log(range.greatest_translucency_px / range.least_translucency_px) /
                (kCols - 1)),
      stride_(harmonic_limit(shape)),
      row_stride_(stride_ * kCols + 1),
      harmonics_(new double[row_stride_ * kRows]),
      offsets_(static_cast<std::size_t>(kRows) * kCols),
      counts_(offsets_.size()),
      visible_counts_(offsets_.size()) {
  const std::vector<double> stripe = stripe_harmonics(shape);
  std::vector<double> k_times_l_d;  // [col][stride_]
  k_times_l_d.reserve(stride_ * kCols);
  for (int col = 0; col < kCols; ++col)
    for (std::size_t n = 1; n <= stride_; ++n)
      k_times_l_d.push_back(harmonic_frequency(shape, n) * translucency_px_at(col));
  tbb::parallel_for(0, kRows, [&](int row) { fill_row(model, row, k_times_l_d, stripe); });
}

// All columns of a row are one call of the model, which inverts R_d once.
void ProfileTable::fill_row(const ScatteringModel& model, int row,
                            std::span<const double> k_times_l_d, std::span<const double> stripe) {
  const double reflectance = reflectance_at(row);
  const double last = last_frequency(model, reflectance);
  std::vector<double> wanted;
  wanted.reserve(k_times_l_d.size());
  wanted.push_back(0);
  for (int col = 0; col < kCols; ++col) {
    const std::size_t entry = index(row, col);
    const auto first = k_times_l_d.begin() + static_cast<std::ptrdiff_t>(stride_) * col;
    const std::size_t count = count_up_to(last, translucency_px_at(col), shape_);
    offsets_[entry] = static_cast<std::uint32_t>(wanted.size());
    counts_[entry] = static_cast<std::uint32_t>(count);
    wanted.insert(wanted.end(), first, first + static_cast<std::ptrdiff_t>(count));
  }
  double* const row_data = harmonics_.get() + static_cast<std::size_t>(row) * row_stride_;
  model.transform(reflectance, wanted, {row_data, wanted.size()});
  const double scale = 1 / row_data[0];
  for (int col = 0; col < kCols; ++col) {
    const std::size_t entry = index(row, col);
    const std::span<double> harmonics(row_data + offsets_[entry], counts_[entry]);
    for (std::size_t n = 0; n < harmonics.size(); ++n) harmonics[n] *= stripe[n] * scale;
    visible_counts_[entry] = static_cast<std::uint32_t>(count_visible(harmonics));
  }
}

double ProfileTable::reflectance_at(int row) const {
  return std::lerp(range_.least_reflectance, range_.greatest_reflectance,
                   static_cast<double>(row) / (kRows - 1));
}

double ProfileTable::row_of(double diffuse_reflectance) const {
  return (diffuse_reflectance - range_.least_reflectance) /
         (range_.greatest_reflectance - range_.least_reflectance) * (kRows - 1);
}

double ProfileTable::translucency_px_at(double col) const {
  return range_.least_translucency_px * std::exp(log_step_ * col);
}

}  // namespace estimation
