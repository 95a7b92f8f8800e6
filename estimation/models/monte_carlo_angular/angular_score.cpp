#include "estimation/models/monte_carlo_angular/angular_score.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "estimation/base/check.h"
#include "estimation/models/monte_carlo/single_scattering.h"

namespace estimation {
namespace {

using std::numbers::pi;

// Path lengths: one bin up to the shortest, then so many in every factor of ten.
constexpr double kShortestPath_tmfp = 0.01;
constexpr int kBinsPerDecade = 32;

struct Paths {
  std::vector<double> begin_tmfp{0};
  std::vector<int> frequency_count;  // that matter at this path length
  std::array<float, static_cast<std::size_t>(kAngularGridK.node_count)> k_tmfp{};

  Paths() {
    for (int i = 0; begin_tmfp.back() < AngularScore::kLongestPath_tmfp; ++i)
      begin_tmfp.push_back(std::min(AngularScore::kLongestPath_tmfp,
                                    kShortestPath_tmfp * std::pow(10.0, i * 1.0 / kBinsPerDecade)));
    for (std::size_t i = 0; i < k_tmfp.size(); ++i)
      k_tmfp[i] = static_cast<float>(kAngularGridK.node(static_cast<int>(i)));
    // Phase averages over a path decay like exp(-min(1, k^2/3) L) or faster.
    for (const double begin : begin_tmfp) {
      int count = 1;
      while (count < kAngularGridK.node_count &&
             std::min(1.0, std::pow(kAngularGridK.node(count), 2) / 3) * begin < 16)
        ++count;
      frequency_count.push_back(count);
    }
  }
  std::size_t count() const { return begin_tmfp.size() - 1; }
  std::size_t bin(double path_tmfp) const {
    if (path_tmfp < kShortestPath_tmfp) return 0;
    const float decades = std::log10(static_cast<float>(path_tmfp / kShortestPath_tmfp));
    return std::min(static_cast<std::size_t>(decades * kBinsPerDecade) + 1, count() - 1);
  }
};

const Paths& paths() {
  static const Paths kPaths;
  return kPaths;
}

// Mean of exp(-decay L) over a bin.
double mean_decay(double decay, double begin, double end) {
  const double width = decay * (end - begin);
  return std::exp(-decay * begin) * (width < 1e-6 ? 1 - 0.5 * width : -std::expm1(-width) / width);
}

// What leaves beyond the longest path, over what leaves from a quarter of it on without absorption:
// white light leaves a half space as L^(-3/2), with phases as diffusion's exp(-k^2 L/3).
constexpr double kLawFrom_tmfp = AngularScore::kLongestPath_tmfp / 4;
double beyond_longest(double absorption, double k_tmfp, double law_begin_tmfp) {
  const double longest = AngularScore::kLongestPath_tmfp;
  const double z = (absorption + k_tmfp * k_tmfp / 3) * longest;
  // Int_1^inf t^(-3/2) exp(-z t) dt / 2, which is 1 at z = 0.
  const double decay = std::exp(-z) - std::sqrt(pi * z) * std::erfc(std::sqrt(z));
  return decay / (std::sqrt(longest / law_begin_tmfp) - 1);
}

// The point after so many of the turns that a whole circle has.
DiscPoint turned(DiscPoint point, std::size_t turn) {
  static const auto kCosines = [] {
    std::array<DiscPoint, AngularScore::kTurns> cosines;
    for (std::size_t i = 0; i < cosines.size(); ++i) {
      const double angle_rad = 2 * pi * static_cast<double>(i) / AngularScore::kTurns;
      cosines[i] = {std::cos(angle_rad), std::sin(angle_rad)};
    }
    return cosines;
  }();
  const DiscPoint by = kCosines[turn];
  return {by.x * point.x - by.y * point.y, by.y * point.x + by.x * point.y};
}

// A quadrature of the disc: exact for polynomials well beyond the order used.
struct DiscRule {
  std::vector<DiscPoint> point;
  std::vector<double> weight;  // sum 1
  std::vector<DirectionPairs::Polynomials> polynomials;

  DiscRule() {
    constexpr int kRadii = 10, kAzimuths = 20;
    const Quadrature radii = gauss_legendre(kRadii);
    for (std::size_t i = 0; i < kRadii; ++i)
      for (int j = 0; j < kAzimuths; ++j) {
        const double r = std::sqrt(radii.node[i]), azimuth_rad = 2 * pi * (j + 0.5) / kAzimuths;
        point.push_back({r * std::cos(azimuth_rad), r * std::sin(azimuth_rad)});
        weight.push_back(radii.weight[i] / kAzimuths);
        polynomials.push_back(DirectionPairs::polynomials(point.back()));
      }
  }
};

AngularScore::Coefficients single_coefficients(const WalkMedium& medium, double absorption,
                                               double k_tmfp) {
  static const DiscRule kRule;
  AngularScore::Coefficients sum{};
  for (std::size_t i = 0; i < kRule.point.size(); ++i)
    for (std::size_t o = 0; o < kRule.point.size(); ++o) {
      const std::complex<double> g =
          kRule.weight[i] * kRule.weight[o] *
          single_scattering(medium, absorption, k_tmfp, kRule.point[i], kRule.point[o]);
      const auto basis = DirectionPairs::basis(kRule.polynomials[i], kRule.polynomials[o]);
      for (std::size_t q = 0; q < basis.size(); ++q)
        sum[q] += basis[q] * (q < DirectionPairs::kRealPairs ? g.real() : g.imag());
    }
  return sum;
}

}  // namespace

std::complex<double> single_scattering(const WalkMedium& medium, double absorption, double k_tmfp,
                                       DiscPoint incidence, DiscPoint exit) {
  const double eta = medium.eta, g = medium.anisotropy;
  const double sigma_s = 1 / (1 - g);
  const double in_x = -incidence.x / eta, in_y = -incidence.y / eta;
  const double out_x = exit.x / eta, out_y = exit.y / eta;
  const double cos_in = std::sqrt(1 - in_x * in_x - in_y * in_y);
  const double cos_out = std::sqrt(1 - out_x * out_x - out_y * out_y);
  const double cosine = in_x * out_x + in_y * out_y - cos_in * cos_out;
  const double phase_function = (1 - g * g) / (4 * pi * std::pow(1 + g * g - 2 * g * cosine, 1.5));
  return pi * phase_function * sigma_s / (eta * eta) /
         std::complex<double>((sigma_s + absorption) * (cos_in + cos_out),
                              k_tmfp * (cos_out * in_x + cos_in * out_x));
}

AngularScore::AngularScore()
    : sum_(paths().count() * static_cast<std::size_t>(kAngularGridK.node_count)) {}

void AngularScore::run(const PhotonWalk& walk, std::uint64_t seed, std::uint64_t stream,
                       std::int64_t photon_count) {
  check(walk.limits().longest_path_tmfp == kLongestPath_tmfp, "walks end where the scores do");
  RandomStream random(seed, stream);
  const double eta = walk.medium().eta;
  for (std::int64_t i = 0; i < photon_count; ++i) {
    const double r = std::sqrt(random.uniform()), azimuth_rad = 2 * pi * random.uniform();
    const DiscPoint from{r * std::cos(azimuth_rad), r * std::sin(azimuth_rad)};
    const Direction3 travel{-from.x / eta, -from.y / eta, std::sqrt(1 - r * r / (eta * eta))};
    for (std::size_t turn = 0; turn < kTurns; ++turn)
      incidence_[turn] = DirectionPairs::polynomials(turned(from, turn));
    walk.launch(travel, random, [&](const PhotonExit& exit) { record(eta, exit); });
  }
  photon_count_ += photon_count;
}

void AngularScore::record(double eta, const PhotonExit& exit) {
  if (exit.scatter_count == 1) return;
  // All the light that arrives at the boundary: the exit's transmission is no part of G.
  const double arriving =
      exit.weight / (1 - inner_reflection(eta, std::abs(exit.inside.z)).reflected_frac) / kTurns;
  const DiscPoint towards{eta * exit.inside.x, eta * exit.inside.y};
  const Paths& p = paths();
  const std::size_t bin = p.bin(exit.path_tmfp);
  for (std::size_t turn = 0; turn < kTurns; ++turn) {
    DirectionPairs::Basis basis =
        DirectionPairs::basis(incidence_[turn], DirectionPairs::polynomials(turned(towards, turn)));
    for (double& value : basis) value *= arriving;
    const auto x_tmfp = static_cast<float>(turned({exit.x_tmfp, exit.y_tmfp}, turn).x);
    for (int i = 0; i < p.frequency_count[bin]; ++i) {
      const float phase_rad = p.k_tmfp[static_cast<std::size_t>(i)] * x_tmfp;
      const auto cosine = static_cast<double>(std::cos(phase_rad));
      const auto minus_sine = static_cast<double>(-std::sin(phase_rad));
      Coefficients& sum = sum_[at(bin, i)];
      for (std::size_t q = 0; q < DirectionPairs::kRealPairs; ++q) sum[q] += cosine * basis[q];
      for (std::size_t q = DirectionPairs::kRealPairs; q < DirectionPairs::kPairs; ++q)
        sum[q] += minus_sine * basis[q];
    }
  }
}

void AngularScore::add(const AngularScore& other) {
  for (std::size_t i = 0; i < sum_.size(); ++i)
    for (std::size_t q = 0; q < DirectionPairs::kPairs; ++q) sum_[i][q] += other.sum_[i][q];
  photon_count_ += other.photon_count_;
}

AngularScore::Coefficients AngularScore::multiple(int s_index, int k_index) const {
  const Paths& p = paths();
  const double absorption = absorption_at(kAngularGridS.node(s_index));
  const double law_begin =
      *std::lower_bound(p.begin_tmfp.begin(), p.begin_tmfp.end(), kLawFrom_tmfp);
  const double beyond = beyond_longest(absorption, kAngularGridK.node(k_index), law_begin);
  Coefficients total{};
  for (std::size_t bin = 0; bin < p.count(); ++bin) {
    if (k_index >= p.frequency_count[bin]) break;
    const double begin = p.begin_tmfp[bin], end = p.begin_tmfp[bin + 1];
    double factor = mean_decay(absorption, begin, end);
    if (begin >= law_begin) factor += beyond;
    const Coefficients& sum = sum_[at(bin, k_index)];
    for (std::size_t q = 0; q < total.size(); ++q) total[q] += factor * sum[q];
  }
  for (double& value : total) value /= static_cast<double>(photon_count_);
  return total;
}

AngularTable make_angular_table(const WalkMedium& medium, std::span<const AngularScore> batches) {
  check(batches.size() >= 2, "batches whose scatter can be taken");
  AngularScore all;
  for (const AngularScore& batch : batches) all.add(batch);
  AngularTable table;
  table.eta = medium.eta;
  table.anisotropy = medium.anisotropy;
  table.photon_count = all.photon_count();
  const auto count = static_cast<double>(batches.size());
  for (int i = 0; i < kAngularGridS.node_count; ++i)
    for (int j = 0; j < kAngularGridK.node_count; ++j) {
      const auto multiple = all.multiple(i, j);
      const auto single =
          single_coefficients(medium, absorption_at(kAngularGridS.node(i)), kAngularGridK.node(j));
      auto& coefficients = table.coefficients.emplace_back();
      for (std::size_t q = 0; q < coefficients.size(); ++q)
        coefficients[q] = static_cast<float>(multiple[q] + single[q]);
      double squares = 0;
      for (const AngularScore& batch : batches) {
        const auto part = batch.multiple(i, j);
        for (std::size_t q = 0; q < part.size(); ++q)
          squares += (part[q] - multiple[q]) * (part[q] - multiple[q]);
      }
      table.coefficient_se.push_back(static_cast<float>(
          std::sqrt(squares / static_cast<double>(coefficients.size()) / count / (count - 1))));
    }
  return table;
}

}  // namespace estimation
