#include "hw_sim/world/dipole.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace hw_sim {
namespace {

constexpr Scattering kMedia[] = {
    {0.0525, 1.2814}, {0.1653, 1.5}, {0.6833, 0.5209}, {0.4761, 1.1415}, {0.001, 2.0}};

// The paper's eq. 5 as printed; A from its F_dr at eta 1.4, worked out by hand: F_dr = 0.529489.
double eq5(const Scattering& s) {
  const double boundary = (1 + 0.529489) / (1 - 0.529489);
  const double albedo = s.sigma_s_prime_per_mm / (s.sigma_a_per_mm + s.sigma_s_prime_per_mm);
  const double root = std::sqrt(3 * (1 - albedo));
  return albedo / 2 * (1 + std::exp(-4.0 / 3.0 * boundary * root)) * std::exp(-root);
}

TEST(Dipole, IntegralOverThePlaneIsEquation5) {
  for (const Scattering& medium : kMedia)
    EXPECT_NEAR(Dipole(medium).total_reflectance(), eq5(medium), 1e-6 * eq5(medium));
}

TEST(Dipole, TailIsTheNumericalIntegralOfTheKernel) {
  for (const Scattering& medium : kMedia) {
    const Dipole dipole(medium);
    const double begin_mm = 1.5, end_mm = 80, step_mm = 1e-3;
    double sum = dipole.reflectance_beyond(end_mm);
    for (double r = begin_mm + step_mm / 2; r < end_mm; r += step_mm)
      sum += dipole.reflectance_per_mm2(r) * 2 * std::numbers::pi * r * step_mm;
    EXPECT_NEAR(dipole.reflectance_beyond(begin_mm), sum, 1e-5 * sum);
  }
}

TEST(Dipole, RadiusLeavesTheTailAskedFor) {
  for (const Scattering& medium : kMedia) {
    const Dipole dipole(medium);
    const double radius_mm = dipole.radius_with_tail_mm(1e-3);
    EXPECT_NEAR(dipole.reflectance_beyond(radius_mm) / dipole.total_reflectance(), 1e-3, 1e-8);
  }
}

TEST(KernelTable, AgreesWithTheKernelEverywhere) {
  for (const Scattering& medium : kMedia) {
    const Dipole dipole(medium);
    const double radius_mm = dipole.radius_with_tail_mm(1e-4);
    const KernelTable table(dipole, radius_mm);
    for (double r = 0; r < radius_mm * 0.9999; r += 0.0137) {
      const double exact = dipole.reflectance_per_mm2(r);
      EXPECT_NEAR(static_cast<double>(table.at(static_cast<float>(r * r))), exact, 1e-3 * exact)
          << "at " << r << " mm";
    }
  }
}

TEST(Scattering, TranslucencyIsTheTablesColumn) {
  // Table 2, female cheek, red and blue.
  EXPECT_NEAR((Scattering{0.0525, 1.2814}.translucency_mm()), 2.1817, 0.0005);
  EXPECT_NEAR((Scattering{0.2216, 1.1248}.translucency_mm()), 1.0569, 0.0005);
}

}  // namespace
}  // namespace hw_sim
