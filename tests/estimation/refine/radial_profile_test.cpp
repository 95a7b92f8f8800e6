#include "estimation/refine/radial_profile.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "estimation/models/dipole.h"

namespace estimation {
namespace {

// The paper's eq. 3 in units of l_d, s = sqrt(3 (1 - alpha')).
double eq3(double s, double rho) {
  constexpr double kEta = 1.4;
  const double f_dr = -1.440 / (kEta * kEta) + 0.710 / kEta + 0.668 + 0.0636 * kEta;
  const double boundary = (1 + f_dr) / (1 - f_dr);
  const auto pole = [&](double z) {
    const double d = std::hypot(rho, z);
    return z * (1 + 1 / d) * std::exp(-d) / (d * d);
  };
  return (1 - s * s / 3) / (4 * std::numbers::pi) * (pole(s) + pole(s * (1 + 4.0 / 3 * boundary)));
}

TEST(RadialProfile, IsEquation3BeyondItsBlur) {
  const Dipole model(1.4);
  const RadialProfile profile(model, 0.02, 0.95);
  std::vector<float> line;
  for (const double s : {0.2, 0.5, 1.0, 1.4}) {
    profile.line(model.reflectance_at(s), line);
    // Blurred by 0.12 l_d, a profile that falls as exp(-rho) / rho rises by 1 to 2%.
    for (const double rho : {2.0, 3.0, 4.0, 5.0}) {
      const auto i = static_cast<std::size_t>(rho * RadialProfile::kStepsPerUnit + 0.5);
      EXPECT_NEAR(static_cast<double>(line[i]) / eq3(s, rho), 1.01, 0.015) << s << ", " << rho;
    }
  }
}

TEST(RadialProfile, HoldsAllLightAndNoneIsNegative) {
  const Dipole model(1.4);
  const RadialProfile profile(model, 0.01, 0.99);
  std::vector<float> line;
  for (const double reflectance : {0.011, 0.1, 0.3, 0.5, 0.7, 0.9, 0.985}) {
    profile.line(reflectance, line);
    double sum = 0;
    for (std::size_t i = 0; i < RadialProfile::kSteps; ++i) {
      EXPECT_GE(line[i], 0.0F);
      const double rho = static_cast<double>(i) / RadialProfile::kStepsPerUnit;
      sum +=
          2 * std::numbers::pi * rho * static_cast<double>(line[i]) / RadialProfile::kStepsPerUnit;
    }
    EXPECT_NEAR(sum / reflectance, 1, reflectance < 0.4 ? 0.01 : 0.002) << reflectance;
  }
}

}  // namespace
}  // namespace estimation
