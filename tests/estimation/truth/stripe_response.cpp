#include "tests/estimation/truth/stripe_response.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace estimation::truth {
namespace {

constexpr int kPoints = 8;          // of an interpolating polynomial
constexpr double kBlurReach = 8.5;  // standard deviations: exp(-36)

bool is_same(const Coefficients& a, const Coefficients& b) {
  return a.sigma_a_per_mm == b.sigma_a_per_mm && a.sigma_s_prime_per_mm == b.sigma_s_prime_per_mm;
}

// Of a stripe from `near_mm` to `far_mm` beside the pixel.
double stripe(const DipoleLineSpread& line_spread, double near_mm, double far_mm) {
  if (near_mm < 0 && far_mm < 0) return stripe(line_spread, -far_mm, -near_mm);
  return line_spread.beyond(near_mm) - line_spread.beyond(far_mm);
}

}  // namespace

double dipole_response(const DipoleLineSpread& line_spread, StripeShape shape, double pitch_mm,
                       double x_px) {
  const double reach_px = line_spread.reach_mm() / pitch_mm + 0.5 * shape.width_px;
  const int first = static_cast<int>(std::ceil((x_px - reach_px) / shape.period_px));
  const int last = static_cast<int>(std::floor((x_px + reach_px) / shape.period_px));
  double sum = 0;
  for (int number = first; number <= last; ++number) {
    const double centre_px = static_cast<double>(number) * shape.period_px - x_px;
    sum += stripe(line_spread, (centre_px - 0.5 * shape.width_px) * pitch_mm,
                  (centre_px + 0.5 * shape.width_px) * pitch_mm);
  }
  return sum;
}

PeriodicCurve::PeriodicCurve(int period_px, const std::function<double(double)>& function_of_px)
    : period_px_(period_px) {
  for (int i = 0; i < period_px * kSamplesPerPx; ++i)
    samples_.push_back(function_of_px(static_cast<double>(i) / kSamplesPerPx));
}

PeriodicCurve::PeriodicCurve(int period_px, std::vector<double> samples)
    : period_px_(period_px), samples_(std::move(samples)) {}

double PeriodicCurve::sample(std::ptrdiff_t index) const {
  const auto count = static_cast<std::ptrdiff_t>(samples_.size());
  const std::ptrdiff_t wrapped = index % count;
  return samples_[static_cast<std::size_t>(wrapped < 0 ? wrapped + count : wrapped)];
}

double PeriodicCurve::operator()(double x_px) const {
  const double place = x_px * kSamplesPerPx;
  const double whole = std::floor(place);
  const double fraction = place - whole;
  const auto first = static_cast<std::ptrdiff_t>(whole) - (kPoints / 2 - 1);
  // Barycentric weights of equidistant points are binomial coefficients of alternating sign.
  static constexpr double kWeights[kPoints] = {-1, 7, -21, 35, -35, 21, -7, 1};
  double numerator = 0, denominator = 0;
  for (int point = 0; point < kPoints; ++point) {
    const double distance = fraction - (point - (kPoints / 2 - 1));
    if (distance == 0) return sample(first + point);
    const double weight = kWeights[point] / distance;
    numerator += weight * sample(first + point);
    denominator += weight;
  }
  return numerator / denominator;
}

double PeriodicCurve::mean() const {
  double sum = 0;
  for (const double value : samples_) sum += value;
  return sum / static_cast<double>(samples_.size());
}

PeriodicCurve PeriodicCurve::blurred(double sigma_px) const {
  if (!(sigma_px > 0)) return *this;
  const auto reach = static_cast<std::ptrdiff_t>(std::ceil(kBlurReach * sigma_px * kSamplesPerPx));
  std::vector<double> kernel;
  double total = 0;
  for (std::ptrdiff_t i = -reach; i <= reach; ++i) {
    const double deviations = static_cast<double>(i) / (sigma_px * kSamplesPerPx);
    kernel.push_back(std::exp(-0.5 * deviations * deviations));
    total += kernel.back();
  }
  std::vector<double> out;
  for (std::ptrdiff_t at = 0; at < static_cast<std::ptrdiff_t>(samples_.size()); ++at) {
    double sum = 0;
    for (std::ptrdiff_t i = -reach; i <= reach; ++i)
      sum += kernel[static_cast<std::size_t>(i + reach)] * sample(at + i);
    out.push_back(sum / total);
  }
  return {period_px_, std::move(out)};
}

const DipoleLineSpread& DipoleCurves::line_spread(const Coefficients& medium) {
  for (const Spread& known : spreads_)
    if (is_same(known.medium, medium)) return *known.line_spread;
  spreads_.push_back({medium, std::make_unique<DipoleLineSpread>(medium, eta_)});
  return *spreads_.back().line_spread;
}

const PeriodicCurve& DipoleCurves::curve(const Coefficients& medium, StripeShape shape,
                                         double pitch_mm) {
  for (const Curve& known : curves_)
    if (is_same(known.medium, medium) && known.shape == shape && known.pitch_mm == pitch_mm)
      return *known.curve;
  const DipoleLineSpread& spread = line_spread(medium);
  curves_.push_back(
      {medium, shape, pitch_mm, std::make_unique<PeriodicCurve>(shape.period_px, [&](double x_px) {
         return dipole_response(spread, shape, pitch_mm, x_px);
       })});
  return *curves_.back().curve;
}

}  // namespace estimation::truth
