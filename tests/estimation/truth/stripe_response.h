// What a pixel sees of a sweeping stripe, as a periodic curve over its position in the stripes.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "estimation/profile/stripe_set.h"
#include "tests/estimation/truth/line_spread.h"

namespace estimation::truth {

// The reflectance factor r as a function of x = u - shift - (width - 1)/2, projector px from the
// stripe's centre, without indirect light. Direct sums of quadratures; about 10 us a value.
double dipole_response(const DipoleLineSpread& line_spread, StripeShape shape, double pitch_mm,
                       double x_px);

// A smooth periodic function, sampled 64 times a projector px and interpolated by polynomials of
// degree 7 (below 1e-12 where the profile's mean free path is a projector px or longer).
// Immutable, thread-safe.
class PeriodicCurve {
 public:
  PeriodicCurve(int period_px, const std::function<double(double)>& function_of_px);

  double operator()(double x_px) const;
  double mean() const;

  // The same after the optics: convolved with a Gaussian of this standard deviation.
  PeriodicCurve blurred(double sigma_px) const;

 private:
  static constexpr int kSamplesPerPx = 64;
  PeriodicCurve(int period_px, std::vector<double> samples);
  double sample(std::ptrdiff_t index) const;

  int period_px_ = 0;
  std::vector<double> samples_;
};

// Curves are made once for each medium, pitch and shape and then shared. Not thread-safe.
class DipoleCurves {
 public:
  explicit DipoleCurves(double eta) : eta_(eta) {}
  const PeriodicCurve& curve(const Coefficients& medium, StripeShape shape, double pitch_mm);
  const DipoleLineSpread& line_spread(const Coefficients& medium);

 private:
  struct Spread {
    Coefficients medium;
    std::unique_ptr<DipoleLineSpread> line_spread;
  };
  struct Curve {
    Coefficients medium;
    StripeShape shape;
    double pitch_mm = 0;
    std::unique_ptr<PeriodicCurve> curve;
  };
  double eta_;
  std::vector<Spread> spreads_;
  std::vector<Curve> curves_;
};

}  // namespace estimation::truth
