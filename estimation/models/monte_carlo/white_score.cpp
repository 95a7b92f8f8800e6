#include "estimation/models/monte_carlo/white_score.h"

#include <algorithm>
#include <array>
#include <numbers>

#include "estimation/base/check.h"

namespace estimation {
namespace {

constexpr double kTableEnd = 256, kPerUnit = 16;
constexpr std::size_t kTableSize = static_cast<std::size_t>(kTableEnd * kPerUnit) + 4;

// J_0 at (i - 1) / kPerUnit.
std::array<double, kTableSize> bessel_table() {
  std::array<double, kTableSize> table{};
  for (std::size_t i = 0; i < kTableSize; ++i)
    table[i] = std::cyl_bessel_j(0.0, std::abs((static_cast<double>(i) - 1) / kPerUnit));
  return table;
}

struct Grid {
  std::array<double, ScoreGrid::kFrequencyCount> k_tmfp{};
  std::vector<double> path_begin_tmfp;
  std::vector<int> frequencies;

  Grid() {
    for (std::size_t i = 0; i < k_tmfp.size(); ++i)
      k_tmfp[i] = ScoreGrid::k_tmfp(static_cast<int>(i));
    for (int bin = 0; bin <= ScoreGrid::path_bin_count(); ++bin) {
      path_begin_tmfp.push_back(ScoreGrid::path_begin_tmfp(bin));
      frequencies.push_back(ScoreGrid::frequencies_at(path_begin_tmfp.back()));
    }
  }
};

const Grid& grid() {
  static const Grid kGrid;
  return kGrid;
}

int path_bin(double path_tmfp) {
  const float decades = std::log10(static_cast<float>(path_tmfp / ScoreGrid::kShortestPath_tmfp));
  return std::clamp(static_cast<int>(decades * ScoreGrid::kBinsPerDecade) + 1, 0,
                    ScoreGrid::path_bin_count() - 1);
}

}  // namespace

double bessel_j0(double z) {
  static const std::array<double, kTableSize> kTable = bessel_table();
  if (z < kTableEnd) {
    const double place = z * kPerUnit;
    const auto i = static_cast<std::size_t>(place);
    const double t = place - static_cast<double>(i);
    const double *f = &kTable[i], u = 1 - t;
    // The cubic through four neighbours.
    return u * f[1] + t * f[2] -
           t * u * ((1 + u) * (f[0] - 2 * f[1] + f[2]) + (1 + t) * (f[1] - 2 * f[2] + f[3])) / 6;
  }
  // Hankel's expansion: the next term is below 1e-8 here.
  const double phase = z - 0.25 * std::numbers::pi;
  return std::sqrt(2 / (std::numbers::pi * z)) *
         (std::cos(phase) * (1 - 9 / (128 * z * z)) + std::sin(phase) / (8 * z));
}

double ScoreGrid::k_tmfp(int index) { return kGridScale * std::sinh(kGridStep * index); }

int ScoreGrid::path_bin_count() {
  return 1 + static_cast<int>(
                 std::ceil(kBinsPerDecade * std::log10(kLongestPath_tmfp / kShortestPath_tmfp)));
}

double ScoreGrid::path_begin_tmfp(int bin) {
  if (bin == 0) return 0;
  return std::min(
      kLongestPath_tmfp,
      kShortestPath_tmfp * std::pow(10.0, static_cast<double>(bin - 1) / kBinsPerDecade));
}

int ScoreGrid::frequencies_at(double path_tmfp) {
  int count = 1;
  while (count < kFrequencyCount) {
    const double k = k_tmfp(count);
    if (std::min(1.0, k * k / 3) * path_tmfp > 20) break;
    ++count;
  }
  return count;
}

WhiteScore::WhiteScore()
    : sum_(at(ScoreGrid::path_bin_count(), 0)),
      moment_(sum_.size()),
      exit_(exit_at(ScoreGrid::path_bin_count(), 0)) {}

void WhiteScore::run(const PhotonWalk& walk, std::uint64_t seed, std::uint64_t stream,
                     std::int64_t photon_count) {
  check(walk.limits().longest_path_tmfp == ScoreGrid::kLongestPath_tmfp,
        "walks end where the scores do");
  RandomStream random(seed, stream);
  for (std::int64_t i = 0; i < photon_count; ++i)
    weight_left_ +=
        walk.launch(Direction3{}, random, [this](const PhotonExit& exit) { record(exit); });
  photon_count_ += photon_count;
}

void WhiteScore::record(const PhotonExit& exit) {
  if (exit.scatter_count == 1) {
    single_weight_ += exit.weight;
    return;
  }
  const Grid& g = grid();
  const int bin = path_bin(exit.path_tmfp);
  const auto b = static_cast<std::size_t>(bin);
  const double middle = 0.5 * (g.path_begin_tmfp[b] + g.path_begin_tmfp[b + 1]);
  const double from_middle = exit.path_tmfp - middle;
  const double radius = std::sqrt(exit.x_tmfp * exit.x_tmfp + exit.y_tmfp * exit.y_tmfp);
  double* sum = &sum_[at(bin, 0)];
  double* moment = &moment_[at(bin, 0)];
  for (int i = 0; i < g.frequencies[b]; ++i) {
    const double score = exit.weight * bessel_j0(g.k_tmfp[static_cast<std::size_t>(i)] * radius);
    sum[i] += score;
    moment[i] += score * from_middle;
  }
  const int exit_bin =
      static_cast<int>(exit.cos_outside * exit.cos_outside * ScoreGrid::kExitBinCount);
  exit_[exit_at(bin, std::min(exit_bin, ScoreGrid::kExitBinCount - 1))] += exit.weight;
}

void WhiteScore::add(const WhiteScore& other) {
  const auto add_all = [](std::vector<double>& to, const std::vector<double>& from) {
    for (std::size_t i = 0; i < to.size(); ++i) to[i] += from[i];
  };
  add_all(sum_, other.sum_);
  add_all(moment_, other.moment_);
  add_all(exit_, other.exit_);
  photon_count_ += other.photon_count_;
  weight_left_ += other.weight_left_;
  single_weight_ += other.single_weight_;
}

}  // namespace estimation
