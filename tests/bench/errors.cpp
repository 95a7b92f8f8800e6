#include "tests/bench/errors.h"

#include <algorithm>
#include <cmath>

namespace bench {
namespace {

struct Sums {
  double sum = 0, squares = 0;
  void add(double value) {
    sum += value;
    squares += value * value;
  }
  Errors::Quantity over(double count) const {
    if (count == 0) return {};
    const double mean = sum / count, square = squares / count;
    return {.rms = std::sqrt(square),
            .bias = mean,
            .sd = std::sqrt(std::max(square - mean * mean, 0.0))};
  }
};

}  // namespace

Errors errors_of(const PixelSet& pixels, const std::vector<Estimate>& estimates,
                 const estimation::ScatteringModel* model) {
  Sums translucency, reflectance, sigma_a, sigma_s_prime, indirect, pull;
  double count = 0, within_1 = 0, within_2 = 0, u_error_px = 0;
  std::vector<double> chi_squares;
  for (std::size_t pixel = 0; pixel < pixels.count; ++pixel) {
    const Estimate& estimate = estimates[pixel];
    if (!estimate.is_valid) continue;
    count += 1;
    const Subject& subject = pixels.subject(pixel);
    const double l_d_mm = estimate.translucency_px * subject.pitch_mm;
    translucency.add(l_d_mm / subject.translucency_mm - 1);
    reflectance.add(estimate.diffuse_reflectance / subject.diffuse_reflectance - 1);
    indirect.add(estimate.indirect - pixels.indirect);
    if (!pixels.true_u_px.empty()) u_error_px += estimate.u_px - pixels.true_u_px[pixel];
    if (model != nullptr) {
      const auto found =
          model->coefficients(std::clamp(estimate.diffuse_reflectance, 1e-6, 1 - 1e-9), l_d_mm);
      sigma_a.add(found.sigma_a_per_mm / subject.medium.sigma_a_per_mm - 1);
      sigma_s_prime.add(found.sigma_s_prime_per_mm / subject.medium.sigma_s_prime_per_mm - 1);
    }
    chi_squares.push_back(estimate.reduced_chi_square);
    if (!(estimate.log_translucency_sd > 0)) continue;
    const double deviations =
        std::log(l_d_mm / subject.translucency_mm) / estimate.log_translucency_sd;
    pull.add(deviations);
    within_1 += std::abs(deviations) < 1 ? 1 : 0;
    within_2 += std::abs(deviations) < 2 ? 1 : 0;
  }
  Errors errors{.translucency = translucency.over(count),
                .reflectance = reflectance.over(count),
                .sigma_a = sigma_a.over(count),
                .sigma_s_prime = sigma_s_prime.over(count)};
  errors.valid_frac = count / static_cast<double>(pixels.count);
  if (count == 0) return errors;
  errors.indirect_bias = indirect.sum / count;
  errors.u_bias_px = u_error_px / count;
  errors.within_1_sd = within_1 / count;
  errors.within_2_sd = within_2 / count;
  errors.pull_variance = pull.squares / count;
  const auto middle = chi_squares.begin() + static_cast<std::ptrdiff_t>(chi_squares.size() / 2);
  std::nth_element(chi_squares.begin(), middle, chi_squares.end());
  errors.median_chi_square = *middle;
  return errors;
}

}  // namespace bench
