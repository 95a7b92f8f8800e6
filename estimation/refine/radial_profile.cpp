#include "estimation/refine/radial_profile.h"

#include <math.h>  // j0 is POSIX, not std

#include <algorithm>
#include <cmath>
#include <numbers>

#include "estimation/base/check.h"

namespace estimation {
namespace {

constexpr double kLogitStep = 0.05;  // linear between: 3e-4 of the profile
constexpr std::size_t kLine = RadialProfile::kSteps + 2;
// k l_d of the transform: a step whose images lie 150 l_d away, up to where the blur ends all.
constexpr double kStep = 0.04;
constexpr double kEnd = 5 / RadialProfile::kBlur;

double logit(double share) { return std::log(share / (1 - share)); }

}  // namespace

RadialProfile::RadialProfile(const ScatteringModel& model, double least_reflectance,
                             double greatest_reflectance)
    : least_logit_(logit(least_reflectance)) {
  check(least_reflectance > 0 && greatest_reflectance < 1 &&
            least_reflectance <= greatest_reflectance,
        "reflectances of a radial profile lie within 0..1");
  row_count_ =
      2 + static_cast<std::size_t>((logit(greatest_reflectance) - least_logit_) / kLogitStep);
  const auto count = static_cast<std::size_t>(kEnd / kStep) + 1;
  std::vector<double> k(count), transform(count);
  for (std::size_t i = 0; i < count; ++i) k[i] = kStep * static_cast<double>(i);
  // Trapezoids of k R~(k) J_0(k rho), whose first term is zero.
  std::vector<double> bessel(kLine * count);
  for (std::size_t step = 0; step < kLine; ++step)
    for (std::size_t i = 0; i < count; ++i)
      bessel[step * count + i] =
          kStep * k[i] * std::exp(-0.5 * kBlur * kBlur * k[i] * k[i]) / (2 * std::numbers::pi) *
          ::j0(k[i] * static_cast<double>(step) / static_cast<double>(kStepsPerUnit));
  rows_.resize(row_count_ * kLine);
  for (std::size_t row = 0; row < row_count_; ++row) {
    const double reflectance =
        1 / (1 + std::exp(-(least_logit_ + kLogitStep * static_cast<double>(row))));
    model.transform(reflectance, k, transform);
    // The trapezoids' end term at k = 0, where the integrand's slope is R~(0).
    const double end = kStep * kStep / 12 * transform[0] / (2 * std::numbers::pi);
    for (std::size_t step = 0; step < kLine; ++step) {
      double sum = end;
      for (std::size_t i = 1; i < count; ++i) sum += bessel[step * count + i] * transform[i];
      rows_[row * kLine + step] = static_cast<float>(std::max(sum, 0.0) / transform[0]);
    }
  }
}

void RadialProfile::line(double diffuse_reflectance, std::vector<float>& out) const {
  out.resize(kLine);
  const double place = std::clamp((logit(diffuse_reflectance) - least_logit_) / kLogitStep, 0.0,
                                  static_cast<double>(row_count_ - 1) - 1e-9);
  const auto row = static_cast<std::size_t>(place);
  const double fraction = place - static_cast<double>(row);
  const float low = static_cast<float>((1 - fraction) * diffuse_reflectance);
  const float high = static_cast<float>(fraction * diffuse_reflectance);
  const float* below = rows_.data() + row * kLine;
  for (std::size_t step = 0; step < kLine; ++step)
    out[step] = low * below[step] + high * below[kLine + step];
}

}  // namespace estimation
