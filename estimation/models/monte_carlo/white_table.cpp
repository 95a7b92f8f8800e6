#include "estimation/models/monte_carlo/white_table.h"

#include <algorithm>

#include "estimation/base/check.h"
#include "estimation/models/monte_carlo/exit_fit.h"
#include "estimation/models/monte_carlo/row_smoothing.h"
#include "estimation/models/monte_carlo/white_transform.h"

namespace estimation {
namespace {

constexpr int kNodeCount = 89;   // s and k up to 2.7e5 sigma_s': R_d below 1e-6
constexpr int kScoredRows = 53;  // s up to 164, x = 94: beyond, too few paths are short enough
constexpr int kScoredColumns = ScoreGrid::kFrequencyCount;
// Third differences of ln[R~ (1 + slope q)] along k are 0.002 to 0.008 where R~ bends.
constexpr double kTypicalThirdDifference = 0.006;

using Rows = std::vector<std::vector<double>>;

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

// The table's nodes from those that were scored.
class Nodes {
 public:
  explicit Nodes(const WalkMedium& medium)
      : sigma_s_(1 / (1 - medium.anisotropy)),
        grid_{ScoreGrid::kGridScale, ScoreGrid::kGridStep, kNodeCount} {
    const SingleScattering single(medium);
    for (int i = 0; i < kNodeCount; ++i) {
      absorption_.push_back(absorption_at(grid_.node(i)));
      once_.emplace_back();
      for (int j = 0; j < kNodeCount; ++j)
        once_.back().push_back(single.transform(absorption_.back(), grid_.node(j)));
    }
  }

  const TableGrid& grid() const { return grid_; }

  // ln[R~ (1 + slope q)] at the scored nodes.
  Rows scored(const WhiteTransform& white, double slope) const {
    Rows rows;
    for (int i = 0; i < kScoredRows; ++i) {
      rows.emplace_back();
      for (int j = 0; j < kScoredColumns; ++j) {
        const double once = once_[index(i)][index(j)];
        // With very few photons the noise of the rest may exceed what is certain.
        const double more = std::max(white.multiple(absorption_[index(i)], j), -0.5 * once);
        rows.back().push_back(std::log(once + more) + reference(i, j, slope));
      }
    }
    return rows;
  }

  // ln R~ at all nodes, [s][k].
  std::vector<double> all(const Rows& scored, double slope) const {
    Rows more;  // than once scattered
    for (int i = 0; i < kScoredRows; ++i) {
      more.emplace_back();
      for (int j = 0; j < kScoredColumns; ++j)
        more.back().push_back(std::exp(scored[index(i)][index(j)] - reference(i, j, slope)) -
                              once_[index(i)][index(j)]);
    }
    std::vector<double> logs;
    for (int i = 0; i < kNodeCount; ++i) {
      const int row = std::min(i, kScoredRows - 1);
      for (int j = 0; j < kNodeCount; ++j)
        logs.push_back(
            std::log(once_[index(i)][index(j)] + beyond(more[index(row)], absorption_[index(row)],
                                                        absorption_[index(i)], grid_.node(j))));
    }
    return logs;
  }

 private:
  static std::size_t index(int i) { return static_cast<std::size_t>(i); }
  double reference(int i, int j, double slope) const {
    return std::log1p(slope * std::hypot(grid_.node(i), grid_.node(j)));
  }
  // Multiple scattering at `absorption` and k from its values at absorption `scored_x`: twofold
  // scattering is homogeneous of degree -2 in (sigma_t, k), and falls like 1/k^2 in the end.
  double beyond(const std::vector<double>& more, double scored_x, double absorption,
                double k) const {
    const double shrink = (sigma_s_ + scored_x) / (sigma_s_ + absorption);
    const double shrunk_k = shrink * k;
    const auto level = [&](double at_k) {
      const double sigma_t = sigma_s_ + scored_x;
      return 4 * sigma_t * sigma_t + at_k * at_k;
    };
    const auto levelled = [&](int j) {
      const int column = std::min(std::abs(j), kScoredColumns - 1);
      return more[index(column)] * level(grid_.node(column));
    };
    const double place = std::min(grid_.place(shrunk_k), kScoredColumns - 1.0);
    const int j = std::min(static_cast<int>(place + 1e-9), kScoredColumns - 2);
    const double t = place - j;
    // The cubic through the neighbours with their central slopes (Catmull and Rom).
    const double before = levelled(j - 1), a = levelled(j), b = levelled(j + 1);
    const double after = levelled(j + 2);
    const double value =
        a + 0.5 * t *
                (b - before +
                 t * (2 * before - 5 * a + 4 * b - after + t * (3 * (a - b) + after - before)));
    return shrink * shrink * value / level(shrunk_k);
  }

  double sigma_s_;
  TableGrid grid_;
  std::vector<double> absorption_;  // [s]
  Rows once_;                       // R~ of what scattered once, [s][k]
};

// One smoothing for each scored row, by the batches' scatter.
std::vector<RowSmoothing> smoothings(const std::vector<Rows>& batches) {
  std::vector<RowSmoothing> result;
  for (std::size_t i = 0; i < kScoredRows; ++i) {
    std::vector<double> errors;
    for (std::size_t j = 0; j < kScoredColumns; ++j) {
      Scatter scatter;
      for (const Rows& rows : batches) scatter.add(rows[i][j]);
      errors.push_back(scatter.standard_error());
    }
    result.emplace_back(errors, kTypicalThirdDifference);
  }
  return result;
}

double energy(const WhiteScore& score) {
  double out = score.single_weight() + score.weight_left();
  for (int bin = 0; bin < ScoreGrid::path_bin_count(); ++bin) out += score.sum(bin, 0);
  return out / static_cast<double>(score.photon_count());
}

void add_transform(const WalkMedium& medium, const WhiteScore& all,
                   std::span<const WhiteScore> batches, ScatteringTable& table) {
  const Nodes nodes(medium);
  const WhiteTransform white(medium, all);
  table.slope = white.slope();
  table.grid = nodes.grid();
  std::vector<Rows> batch_rows;
  for (const WhiteScore& batch : batches)
    batch_rows.push_back(nodes.scored(WhiteTransform(medium, batch), table.slope));
  const std::vector<RowSmoothing> smoothing = smoothings(batch_rows);
  const auto finished = [&](Rows rows) {
    for (std::size_t i = 0; i < rows.size(); ++i) rows[i] = smoothing[i].smooth(rows[i]);
    return nodes.all(rows, table.slope);
  };
  table.log_transform = finished(nodes.scored(white, table.slope));
  std::vector<Scatter> scatter(table.log_transform.size());
  for (Rows& rows : batch_rows) {
    const std::vector<double> logs = finished(std::move(rows));
    for (std::size_t i = 0; i < logs.size(); ++i) scatter[i].add(logs[i]);
  }
  for (const Scatter& node : scatter) table.log_transform_se.push_back(node.standard_error());
}

void add_exit_radiance(const WalkMedium& medium, const WhiteScore& all,
                       std::span<const WhiteScore> batches, ScatteringTable& table) {
  const SingleScattering single(medium);
  const ExitFit fit(medium.eta);
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

ScatteringTable make_scattering_table(const WalkMedium& medium,
                                      std::span<const WhiteScore> batches) {
  check(batches.size() >= 2, "a standard error needs at least two batches");
  ScatteringTable table;
  table.eta = medium.eta;
  table.anisotropy = medium.anisotropy;
  WhiteScore all;
  Scatter energies;
  for (const WhiteScore& batch : batches) {
    all.add(batch);
    energies.add(energy(batch));
  }
  table.photon_count = all.photon_count();
  table.energy_residual = energy(all) - 1;
  table.energy_residual_se = energies.standard_error();
  add_transform(medium, all, batches, table);
  add_exit_radiance(medium, all, batches, table);
  return table;
}

}  // namespace estimation
