// The dipole of eq. 3 integrated in space: what a half plane of light gives, without any transform.
#pragma once

#include <vector>

#include "estimation/models/scattering_model.h"

namespace estimation::truth {

// R_d of eq. 5 and l_d of eq. 6, written out again: truth shares no formula with the estimator.
struct Shape {
  double diffuse_reflectance = 0;
  double translucency_mm = 0;
};

// The line spread L(x) = integral of eq. 3 along a line at distance x, and what lies beyond x:
//   beyond(x) = integral of L from x to infinity.
// L by the trapezoid rule after y = rho sinh t (the integrand then falls doubly exponentially,
// 1e-15 with a step of 0.1), its integral from Chebyshev panels that grow with the distance to the
// profile's poles at x = +-i z_r. Accurate to about 1e-14 of R_d. Immutable, thread-safe.
class DipoleLineSpread {
 public:
  DipoleLineSpread(const Coefficients& medium, double eta);

  double line_spread_per_mm(double x_mm) const;  // by quadrature, not from the panels
  double beyond(double x_mm) const;              // any x; beyond(-x) = R_d - beyond(x)
  double diffuse_reflectance() const { return 2 * panels_.front().beyond_start; }
  double reach_mm() const { return panels_.back().end_mm; }  // nothing beyond it: below 1e-17
  Shape shape() const { return {diffuse_reflectance(), 1 / sigma_tr_per_mm_}; }

 private:
  static constexpr int kDegree = 20;
  struct Panel {
    double start_mm = 0, end_mm = 0;
    double beyond_start = 0;
    // Chebyshev series of the integral of L from start_mm to x.
    double series[kDegree + 2] = {};
  };
  Panel make_panel(double start_mm, double end_mm) const;
  double integral_from_start(const Panel& panel, double x_mm) const;

  double albedo_ = 0;  // alpha'
  double sigma_tr_per_mm_ = 0;
  double source_depth_mm_[2] = {};  // z_r, z_v
  std::vector<Panel> panels_;
};

}  // namespace estimation::truth
