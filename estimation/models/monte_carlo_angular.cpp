#include "estimation/models/monte_carlo_angular.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "estimation/base/check.h"
#include "estimation/models/monte_carlo/photon_walk.h"
#include "estimation/models/monte_carlo/uniform_spline.h"
#include "estimation/models/monte_carlo_angular/shipped_angular_tables.h"

namespace estimation {
namespace {

constexpr std::size_t kPairs = DirectionPairs::kPairs;
constexpr auto kNodesS = static_cast<std::size_t>(kAngularGridS.node_count);
constexpr auto kNodesK = static_cast<std::size_t>(kAngularGridK.node_count);
constexpr std::size_t kRowSize = (kNodesK + 2 + 3) / 4 * 4;  // spline coefficients along k, padded

SplinePlace place_in(const TableGrid& grid, double value) {
  const double last = grid.node_count - 1;
  return {std::min(grid.place(value), last), static_cast<std::size_t>(grid.node_count)};
}

DirectionPairs::Basis basis_of(const Directions& directions) {
  const auto polynomials = [](double cosine, double azimuth_rad) {
    const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
    return DirectionPairs::polynomials(
        {sine * std::cos(azimuth_rad), sine * std::sin(azimuth_rad)});
  };
  return DirectionPairs::basis(
      polynomials(directions.cos_incidence, directions.incidence_azimuth_rad),
      polynomials(directions.cos_exit, directions.exit_azimuth_rad));
}

}  // namespace

MonteCarloAngular::MonteCarloAngular(const ScatteringTable& hemispherical,
                                     const AngularTable& angular)
    : MonteCarlo(hemispherical),
      eta_(angular.eta),
      coefficients_((kNodesS + 2) * kPairs * kRowSize),
      standard_error_(angular.coefficient_se) {
  check(hemispherical.eta == angular.eta && hemispherical.anisotropy == angular.anisotropy &&
            angular.coefficients.size() == AngularTable::node_count() &&
            standard_error_.size() == AngularTable::node_count(),
        "two complete tables of one medium");
  std::vector<double> per_transform;  // 1 / R~, [s][k]
  per_transform.reserve(AngularTable::node_count());
  for (std::size_t node = 0; node < AngularTable::node_count(); ++node) {
    const double s = kAngularGridS.node(static_cast<int>(node / kNodesK));
    const double k_tmfp = kAngularGridK.node(static_cast<int>(node % kNodesK));
    per_transform.push_back(1 / transform_at(s, k_tmfp));
    standard_error_[node] *= static_cast<float>(per_transform.back());
  }
  for (std::size_t pair = 0; pair < kPairs; ++pair) {
    // First along k, where real parts are even and imaginary parts odd, then along s.
    std::vector<std::vector<double>> along_k;
    for (std::size_t i = 0; i < kNodesS; ++i) {
      std::vector<double> row;
      for (std::size_t j = 0; j < kNodesK; ++j)
        row.push_back(per_transform[i * kNodesK + j] *
                      static_cast<double>(angular.coefficients[i * kNodesK + j][pair]));
      along_k.push_back(spline_coefficients(
          row, pair < DirectionPairs::kRealPairs ? SplineStart::kEven : SplineStart::kNatural));
    }
    for (std::size_t j = 0; j < kNodesK + 2; ++j) {
      std::vector<double> column;
      for (const std::vector<double>& row : along_k) column.push_back(row[j]);
      const std::vector<double> c = spline_coefficients(column, SplineStart::kNatural);
      for (std::size_t i = 0; i < c.size(); ++i)
        coefficients_[(i * kPairs + pair) * kRowSize + j] = static_cast<float>(c[i]);
    }
  }
}

void MonteCarloAngular::direction_factors(double diffuse_reflectance,
                                          std::span<const double> k_times_l_d,
                                          const Directions& directions,
                                          std::span<std::complex<double>> out) const {
  check(k_times_l_d.size() == out.size(), "one factor for each frequency");
  if (!(directions.cos_incidence > 0 && directions.cos_exit > 0)) {
    std::fill(out.begin(), out.end(), 0);
    return;
  }
  const double s = s_at(diffuse_reflectance);
  if (std::isnan(s)) {
    std::fill(out.begin(), out.end(), s);
    return;
  }
  double greatest = 0;
  for (const double x : k_times_l_d) greatest = std::max(greatest, s * x);
  const std::size_t row_end = place_in(kAngularGridK, greatest).first + 4;
  // The splines along k at this s and these directions: all pairs together.
  const SplinePlace along_s = place_in(kAngularGridS, s);
  const DirectionPairs::Basis basis = basis_of(directions);
  std::array<float, kRowSize> real{}, imaginary{};
  for (std::size_t i = 0; i < 4; ++i)
    for (std::size_t pair = 0; pair < kPairs; ++pair) {
      const float* row = &coefficients_[((along_s.first + i) * kPairs + pair) * kRowSize];
      const auto weight = static_cast<float>(along_s.weight[i] * basis[pair]);
      auto& sum = pair < DirectionPairs::kRealPairs ? real : imaginary;
      for (std::size_t j = 0; j < row_end; ++j) sum[j] += weight * row[j];
    }
  const double transmitted = transmitted_frac(eta_, directions.cos_incidence) *
                             transmitted_frac(eta_, directions.cos_exit);
  for (std::size_t n = 0; n < out.size(); ++n) {
    if (!(k_times_l_d[n] >= 0)) {
      out[n] = std::numeric_limits<double>::quiet_NaN();
      continue;
    }
    const SplinePlace along_k = place_in(kAngularGridK, s * k_times_l_d[n]);
    std::complex<double> factor = 0;
    for (std::size_t i = 0; i < 4; ++i)
      factor += along_k.weight[i] *
                std::complex<double>(static_cast<double>(real[along_k.first + i]),
                                     static_cast<double>(imaginary[along_k.first + i]));
    out[n] = transmitted * factor;
  }
}

double MonteCarloAngular::factor_standard_error(double s, double k_tmfp,
                                                const Directions& directions) const {
  const auto nearest = [](const TableGrid& grid, double value) {
    return std::min(static_cast<std::size_t>(std::lround(std::min(grid.place(value), 1e3))),
                    static_cast<std::size_t>(grid.node_count) - 1);
  };
  double squares = 0;
  for (const double value : basis_of(directions)) squares += value * value;
  // About half of them belong to the real part, half to the imaginary.
  return transmitted_frac(eta_, directions.cos_incidence) *
         transmitted_frac(eta_, directions.cos_exit) * std::sqrt(squares / 2) *
         static_cast<double>(
             standard_error_[nearest(kAngularGridS, s) * kNodesK + nearest(kAngularGridK, k_tmfp)]);
}

namespace {

std::string medium_text(double eta, double anisotropy) {
  char text[64];
  std::snprintf(text, sizeof text, "eta %g with g %g", eta, anisotropy);
  return text;
}

bool is_of(const MediumOptions& medium, double eta, double anisotropy) {
  return std::abs(eta - medium.eta) < 1e-9 && std::abs(anisotropy - medium.anisotropy) < 1e-9;
}

Result<ScatteringTable> shipped_hemispherical(const MediumOptions& medium) {
  for (const ShippedTable& shipped : shipped_tables()) {
    const std::string name(shipped.file_name);
    const Result<ScatteringTable> head = scattering_table_head(shipped.text, name);
    if (!head) return tl::unexpected(head.error());
    if (is_of(medium, head->eta, head->anisotropy))
      return scattering_table_from_text(shipped.text, name);
  }
  return tl::unexpected(InputError{InputFault::kInvalid, "", "medium",
                                   "has no table of monte_carlo, which the angular one is for"});
}

}  // namespace

Result<std::unique_ptr<ScatteringModel>> make_monte_carlo_angular(const MediumOptions& medium) {
  std::string known;
  for (const ShippedTable& shipped : shipped_angular_tables()) {
    const Result<AngularTable> angular =
        angular_table_from_text(shipped.text, std::string(shipped.file_name));
    if (!angular) return tl::unexpected(angular.error());
    if (is_of(medium, angular->eta, angular->anisotropy)) {
      const Result<ScatteringTable> hemispherical = shipped_hemispherical(medium);
      if (!hemispherical) return tl::unexpected(hemispherical.error());
      return std::make_unique<MonteCarloAngular>(*hemispherical, *angular);
    }
    known.append(known.empty() ? "" : ", ").append(medium_text(angular->eta, angular->anisotropy));
  }
  std::string expectation = "is ";
  expectation.append(medium_text(medium.eta, medium.anisotropy))
      .append("; monte_carlo_angular has tables for: ")
      .append(known);
  return tl::unexpected(InputError{InputFault::kInvalid, "", "medium", expectation});
}

}  // namespace estimation
