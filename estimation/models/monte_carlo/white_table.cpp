#include "estimation/models/monte_carlo/white_table.h"

#include <algorithm>
#include <numbers>

#include "estimation/base/check.h"

namespace estimation {
namespace {

constexpr int kFrequencies = ScoreGrid::kFrequencyCount;
constexpr int kNodeCount = 89;  // s and k up to 2.7e5 sigma_s': R_d below 1e-6

std::size_t at(int bin, int frequency) {
  return static_cast<std::size_t>(bin * kFrequencies + frequency);
}

// The integral of L^(-3/2 - term) from a to b.
double law_integral(int term, double a, double b) {
  const double power = -0.5 - term;
  return (std::pow(a, power) - (std::isinf(b) ? 0 : std::pow(b, power))) / -power;
}

// Solves the symmetric 4 x 4 system with Gauss' elimination and pivoting.
std::array<double, 4> solve(std::array<std::array<double, 5>, 4> rows) {
  for (std::size_t i = 0; i < 4; ++i) {
    std::size_t pivot = i;
    for (std::size_t j = i + 1; j < 4; ++j)
      if (std::abs(rows[j][i]) > std::abs(rows[pivot][i])) pivot = j;
    std::swap(rows[i], rows[pivot]);
    for (std::size_t j = 0; j < 4; ++j) {
      if (j == i) continue;
      const double factor = rows[j][i] / rows[i][i];
      for (std::size_t column = i; column < 5; ++column)
        rows[j][column] -= factor * rows[i][column];
    }
  }
  std::array<double, 4> result{};
  for (std::size_t i = 0; i < 4; ++i) result[i] = rows[i][4] / rows[i][i];
  return result;
}

// Light scattered at least twice at any absorption and frequency, from that at the scores'.
class MultipleScattering {
 public:
  MultipleScattering(const WalkMedium& medium, const WhiteTransform& white)
      : white_(white), sigma_s_(1 / (1 - medium.anisotropy)) {}

  // values[i] at the grid's k, i = 0..kNodeCount - 1
  std::vector<double> row(double absorption) const {
    const double x = std::min(absorption, WhiteTransform::kLargestAbsorption);
    // Twofold scattering is homogeneous in (sigma_t, k) of degree -2.
    const double shrink = (sigma_s_ + x) / (sigma_s_ + absorption);
    std::array<double, kFrequencies> levelled{};
    for (int i = 0; i < kFrequencies; ++i)
      levelled[static_cast<std::size_t>(i)] =
          white_.multiple(x, i) * level(x, ScoreGrid::k_tmfp(i));
    std::vector<double> values;
    for (int i = 0; i < kNodeCount; ++i) {
      const double k = shrink * ScoreGrid::k_tmfp(i);
      values.push_back(shrink * shrink * between(levelled, k) / level(x, k));
    }
    return values;
  }

 private:
  // What multiple scattering roughly falls like: 1/k^2 beyond the attenuation.
  double level(double absorption, double k) const {
    const double sigma_t = sigma_s_ + absorption;
    return 4 * sigma_t * sigma_t + k * k;
  }
  // Cubic interpolation in asinh(k), constant beyond the scores.
  static double between(const std::array<double, kFrequencies>& f, double k) {
    const double place = std::asinh(k / ScoreGrid::kGridScale) / ScoreGrid::kGridStep;
    if (place >= kFrequencies - 1) return f.back();
    const int i = std::clamp(static_cast<int>(place + 1e-9), 0, kFrequencies - 2);
    const double t = place - i;
    const auto value = [&](int j) {
      return f[static_cast<std::size_t>(std::min(std::abs(j), kFrequencies - 1))];
    };
    const double before = value(i - 1), a = value(i), b = value(i + 1), after = value(i + 2);
    return a + 0.5 * t *
                   (b - before +
                    t * (2 * before - 5 * a + 4 * b - after + t * (3 * (a - b) + after - before)));
  }

  const WhiteTransform& white_;
  double sigma_s_;
};

std::vector<double> log_transform(const WalkMedium& medium, const WhiteScore& score,
                                  const TableGrid& grid, double& slope) {
  const WhiteTransform white(medium, score);
  const MultipleScattering multiple(medium, white);
  const SingleScattering single(medium);
  std::vector<double> result;
  for (int i = 0; i < grid.node_count; ++i) {
    const double x = absorption_at(grid.node(i));
    const std::vector<double> row = multiple.row(x);
    for (int j = 0; j < grid.node_count; ++j) {
      const double once = single.transform(x, grid.node(j));
      // With very few photons the noise of the rest may exceed what is certain.
      const double more = std::max(row[static_cast<std::size_t>(j)], -0.5 * once);
      result.push_back(std::log(once + more));
    }
  }
  slope = white.slope();
  return result;
}

// The exit flux of score, per photon, in bins of equal Lambertian flux.
using ExitFlux = std::array<double, ScoreGrid::kExitBinCount>;

ExitFlux exit_flux(const WhiteScore& score, double absorption) {
  ExitFlux flux{};
  for (int bin = 0; bin < ScoreGrid::path_bin_count(); ++bin) {
    const double middle =
        0.5 * (ScoreGrid::path_begin_tmfp(bin) + ScoreGrid::path_begin_tmfp(bin + 1));
    // What is left at the longest path leaves like the last decade: directions no longer change.
    const double kept = std::exp(-absorption * middle) / static_cast<double>(score.photon_count());
    for (int i = 0; i < ScoreGrid::kExitBinCount; ++i)
      flux[static_cast<std::size_t>(i)] += kept * score.exit_weight(bin, i);
  }
  return flux;
}

// Least squares of the bins' h against the form that ExitRadiance states.
class ExitFit {
 public:
  explicit ExitFit(const WalkMedium& medium) {
    const Quadrature rule = gauss_legendre(16);
    for (std::size_t bin = 0; bin < shapes_.size(); ++bin) {
      for (std::size_t i = 0; i < rule.node.size(); ++i) {
        // The bin average over c^2.
        const double square = (static_cast<double>(bin) + rule.node[i]) / kBinCount;
        const double through = transmitted_frac(medium.eta, std::sqrt(square));
        double power = rule.weight[i] * through;
        for (double& shape : shapes_[bin]) {
          shape += power;
          power *= 1 - square;
        }
      }
    }
  }

  ExitRadiance fit(const ExitFlux& flux) const {
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

 private:
  static constexpr double kBinCount = ScoreGrid::kExitBinCount;
  std::array<std::array<double, 4>, ScoreGrid::kExitBinCount> shapes_{};
};

// Standard error of the mean of the batches' values.
class Scatter {
 public:
  void add(double value) {
    ++count_;
    const double before = value - mean_;
    mean_ += before / count_;
    squares_ += before * (value - mean_);
  }
  double standard_error() const { return std::sqrt(squares_ / (count_ - 1) / count_); }

 private:
  double count_ = 0, mean_ = 0, squares_ = 0;
};

double energy(const WhiteScore& score) {
  double out = score.single_weight() + score.weight_left();
  for (int bin = 0; bin < ScoreGrid::path_bin_count(); ++bin) out += score.sum(bin, 0);
  return out / static_cast<double>(score.photon_count());
}

void add_exit_radiance(const WalkMedium& medium, const WhiteScore& all,
                       std::span<const WhiteScore> batches, ScatteringTable& table) {
  const SingleScattering single(medium);
  const ExitFit fit(medium);
  const double normal = transmitted_frac(medium.eta, 1);
  for (int i = 0; i < table.grid.node_count; ++i) {
    const double x = absorption_at(table.grid.node(i));
    ExitFlux once{};
    for (std::size_t bin = 0; bin < once.size(); ++bin)
      once[bin] =
          single.flux_between(x, std::sqrt(static_cast<double>(bin) / ScoreGrid::kExitBinCount),
                              std::sqrt(static_cast<double>(bin + 1) / ScoreGrid::kExitBinCount));
    const auto radiance = [&](const WhiteScore& score) {
      ExitFlux flux = exit_flux(score, x);
      for (std::size_t bin = 0; bin < flux.size(); ++bin) flux[bin] += once[bin];
      return fit.fit(flux);
    };
    Scatter at_normal;
    for (const WhiteScore& batch : batches) at_normal.add(normal * radiance(batch)[0]);
    table.exit_radiance.push_back(radiance(all));
    table.exit_radiance_se.push_back(at_normal.standard_error());
  }
}

}  // namespace

WhiteTransform::WhiteTransform(const WalkMedium& medium, const WhiteScore& score)
    : single_(medium) {
  const auto photons = static_cast<double>(score.photon_count());
  double mass_beyond = 1 - single_.transform(0, 0);
  for (int bin = 0; bin < ScoreGrid::path_bin_count(); ++bin) {
    const double begin = ScoreGrid::path_begin_tmfp(bin);
    const double end = ScoreGrid::path_begin_tmfp(bin + 1);
    bins_.push_back({0.5 * (begin + end), end - begin});
    for (int i = 0; i < kFrequencies; ++i) {
      sum_.push_back(score.sum(bin, i) / photons);
      moment_.push_back(score.moment(bin, i) / photons);
    }
    if (begin < kLawFrom_tmfp) mass_beyond -= sum_[at(bin, 0)];
  }
  fit_law(mass_beyond);
}

// Fits the law to the flux in the bins (which roulette gives about the same absolute noise each),
// then gives those bins the law's flux, keeping their phase averages.
void WhiteTransform::fit_law(double mass_beyond) {
  std::array<std::array<double, 5>, 4> rows{};  // the fourth is the condition on the whole
  double first_tmfp = 0;
  for (std::size_t bin = 0; bin < bins_.size(); ++bin) {
    const double begin = bins_[bin].middle_tmfp - 0.5 * bins_[bin].width_tmfp;
    if (begin < kLawFrom_tmfp) continue;
    if (first_tmfp == 0) first_tmfp = begin;
    for (int i = 0; i < 3; ++i) {
      const double shape = law_integral(i, begin, begin + bins_[bin].width_tmfp);
      for (int j = 0; j < 3; ++j)
        rows[static_cast<std::size_t>(i)][static_cast<std::size_t>(j)] +=
            shape * law_integral(j, begin, begin + bins_[bin].width_tmfp);
      rows[static_cast<std::size_t>(i)][4] += shape * sum_[at(static_cast<int>(bin), 0)];
    }
  }
  for (int i = 0; i < 3; ++i) {
    const double whole = law_integral(i, first_tmfp, std::numeric_limits<double>::infinity());
    rows[static_cast<std::size_t>(i)][3] = rows[3][static_cast<std::size_t>(i)] = whole;
  }
  rows[3][4] = mass_beyond;
  const std::array<double, 4> solution = solve(rows);
  std::copy_n(solution.begin(), 3, law_.begin());
  for (int bin = 0; bin < static_cast<int>(bins_.size()); ++bin) {
    const Bin& place = bins_[static_cast<std::size_t>(bin)];
    const double begin = place.middle_tmfp - 0.5 * place.width_tmfp;
    if (begin < kLawFrom_tmfp) continue;
    double flux = 0;
    for (int i = 0; i < 3; ++i)
      flux += law_[static_cast<std::size_t>(i)] * law_integral(i, begin, begin + place.width_tmfp);
    const double scored = sum_[at(bin, 0)];
    for (int i = 0; i < kFrequencies; ++i) {
      const double k = ScoreGrid::k_tmfp(i);
      if (scored > 0) {
        sum_[at(bin, i)] *= flux / scored;
        moment_[at(bin, i)] *= flux / scored;
      } else {
        sum_[at(bin, i)] = flux * std::exp(-k * k / 3 * place.middle_tmfp);
      }
    }
  }
}

// The integral of the law times exp(-decay L) beyond the longest path.
double WhiteTransform::tail(double decay) const {
  const double from = ScoreGrid::kLongestPath_tmfp;
  const double kept = std::exp(-decay * from);
  double integral = 2 * kept / std::sqrt(from) -
                    2 * std::sqrt(std::numbers::pi * decay) * std::erfc(std::sqrt(decay * from));
  double total = law_[0] * integral;
  for (int i = 1; i < 3; ++i) {
    integral = (std::pow(from, -0.5 - i) * kept - decay * integral) / (0.5 + i);
    total += law_[static_cast<std::size_t>(i)] * integral;
  }
  return total;
}

double WhiteTransform::multiple(double absorption, int frequency) const {
  double total = 0;
  for (int bin = 0; bin < static_cast<int>(bins_.size()); ++bin) {
    const Bin& place = bins_[static_cast<std::size_t>(bin)];
    const double across = absorption * place.width_tmfp;
    // exp(-x L) over the bin to second order; the flux' own spread in it as if it were even.
    total += std::exp(-absorption * place.middle_tmfp) *
             (sum_[at(bin, frequency)] * (1 + across * across / 24) -
              absorption * moment_[at(bin, frequency)]);
  }
  const double k = ScoreGrid::k_tmfp(frequency);
  return total + tail(absorption + k * k / 3);
}

double WhiteTransform::transform(double absorption, int frequency) const {
  return single_.transform(absorption, ScoreGrid::k_tmfp(frequency)) +
         multiple(absorption, frequency);
}

// 1 - R_d -> 2 C sqrt(pi x), and s^2 -> 3 x.
double WhiteTransform::slope() const { return 2 * law_[0] * std::sqrt(std::numbers::pi / 3); }

ScatteringTable make_scattering_table(const WalkMedium& medium,
                                      std::span<const WhiteScore> batches) {
  check(batches.size() >= 2, "a standard error needs at least two batches");
  WhiteScore all;
  ScatteringTable table;
  table.eta = medium.eta;
  table.anisotropy = medium.anisotropy;
  table.grid = {ScoreGrid::kGridScale, ScoreGrid::kGridStep, kNodeCount};
  std::vector<Scatter> scatter(static_cast<std::size_t>(kNodeCount * kNodeCount));
  Scatter energies;
  for (const WhiteScore& batch : batches) {
    all.add(batch);
    energies.add(energy(batch));
    double slope = 0;
    const std::vector<double> logs = log_transform(medium, batch, table.grid, slope);
    for (std::size_t i = 0; i < logs.size(); ++i) scatter[i].add(logs[i]);
  }
  table.photon_count = all.photon_count();
  table.energy_residual = energy(all) - 1;
  table.energy_residual_se = energies.standard_error();
  table.log_transform = log_transform(medium, all, table.grid, table.slope);
  for (const Scatter& node : scatter) table.log_transform_se.push_back(node.standard_error());
  add_exit_radiance(medium, all, batches, table);
  return table;
}

}  // namespace estimation
