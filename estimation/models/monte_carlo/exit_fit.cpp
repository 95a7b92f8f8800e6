#include "estimation/models/monte_carlo/exit_fit.h"

#include "estimation/models/monte_carlo/single_scattering.h"
#include "estimation/models/monte_carlo/small_solve.h"

namespace estimation {
namespace {

constexpr double kBinCount = ScoreGrid::kExitBinCount;

}  // namespace

ExitFlux exit_flux(const WhiteScore& score, double absorption) {
  const auto photons = static_cast<double>(score.photon_count());
  ExitFlux flux{}, late{};
  double late_total = 0;
  for (int bin = 0; bin < ScoreGrid::path_bin_count(); ++bin) {
    const double begin = ScoreGrid::path_begin_tmfp(bin);
    const double middle = 0.5 * (begin + ScoreGrid::path_begin_tmfp(bin + 1));
    const double kept = std::exp(-absorption * middle) / photons;
    for (std::size_t i = 0; i < flux.size(); ++i) {
      const double weight = score.exit_weight(bin, static_cast<int>(i));
      flux[i] += kept * weight;
      if (begin < 0.1 * ScoreGrid::kLongestPath_tmfp) continue;
      late[i] += weight;
      late_total += weight;
    }
  }
  // What is left at the longest path leaves like the last decade: directions no longer change.
  const double left =
      score.weight_left() / photons * std::exp(-absorption * ScoreGrid::kLongestPath_tmfp);
  if (late_total > 0)
    for (std::size_t i = 0; i < flux.size(); ++i) flux[i] += left * late[i] / late_total;
  return flux;
}

ExitFit::ExitFit(double eta) {
  const Quadrature rule = gauss_legendre(16);
  for (std::size_t bin = 0; bin < shapes_.size(); ++bin) {
    for (std::size_t i = 0; i < rule.node.size(); ++i) {
      // The bin average over c^2.
      const double square = (static_cast<double>(bin) + rule.node[i]) / kBinCount;
      const double through = transmitted_frac(eta, std::sqrt(square));
      double power = rule.weight[i] * through;
      for (double& shape : shapes_[bin]) {
        shape += power;
        power *= 1 - square;
      }
    }
  }
}

ExitRadiance ExitFit::fit(const ExitFlux& flux) const {
  double total = 0;
  for (double part : flux) total += part;
  std::array<std::array<double, 5>, 4> rows{};
  for (std::size_t bin = 0; bin < shapes_.size(); ++bin) {
    const double h = flux[bin] * kBinCount / total;
    for (std::size_t i = 0; i < 4; ++i) {
      for (std::size_t j = 0; j < 4; ++j) rows[i][j] += shapes_[bin][i] * shapes_[bin][j];
      rows[i][4] += shapes_[bin][i] * h;
    }
  }
  ExitRadiance radiance = solve(rows);
  double mean = 0;
  for (const auto& shape : shapes_)
    for (std::size_t i = 0; i < 4; ++i) mean += shape[i] * radiance[i] / kBinCount;
  for (double& coefficient : radiance) coefficient /= mean;
  return radiance;
}

}  // namespace estimation
