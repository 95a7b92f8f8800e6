#include "hw_sim/world/scatter_table.h"

#include <tbb/parallel_for.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <fstream>
#include <mutex>
#include <opencv2/core.hpp>
#include <string>

#include "hw_sim/world/layer_doubling.h"
#include "hw_sim/world/white_walk.h"

namespace hw_sim {

namespace {

constexpr std::uint64_t kVersion = 10;  // of what a file holds
constexpr std::size_t kStrands = 16;  // of photons, each with its own sums: fixed, so that threads
                                      // do not change the numbers

double ratio_at(std::size_t i, std::size_t count) {
  const double share = static_cast<double>(i) / static_cast<double>(count - 1);
  return ScatterTable::kLeastRatio *
         std::pow(ScatterTable::kGreatestRatio / ScatterTable::kLeastRatio, share);
}

const ExitProjection& exit_projection() {
  static const ExitProjection kProjection;
  return kProjection;
}

// At each knot, what a cubic in the logarithm of the radius through the knots around it says, by
// least squares.
class RadialSmoother {
 public:
  struct Tap {
    std::size_t knot = 0;
    float weight = 0;
  };
  RadialSmoother() {
    for (std::size_t knot = 0; knot < RadialKnots::kCount; ++knot) fit(knot);
  }
  const std::vector<Tap>& taps(std::size_t knot) const { return taps_[knot]; }

 private:
  static constexpr std::size_t kReach = 6;  // knots on either side: a factor of 1.3 in radius
  static constexpr int kTerms = 4;

  void fit(std::size_t knot) {
    const std::size_t begin = knot < kReach ? 0 : knot - kReach;
    const std::size_t end = std::min(RadialKnots::kCount, knot + kReach + 1);
    cv::Matx<double, kTerms, kTerms> normal_matrix;
    const auto basis = [&](std::size_t other) {
      const double x = std::log(RadialKnots::r2(other) / RadialKnots::r2(knot));
      return cv::Vec<double, kTerms>(1, x, x * x, x * x * x);
    };
    for (std::size_t other = begin; other < end; ++other)
      normal_matrix += basis(other) * basis(other).t();
    const cv::Matx<double, kTerms, kTerms> inverse = normal_matrix.inv(cv::DECOMP_CHOLESKY);
    for (std::size_t other = begin; other < end; ++other) {
      const cv::Vec<double, kTerms> terms = inverse * basis(other);
      taps_[knot].push_back(
          {other, static_cast<float>(terms[0] * RadialKnots::r2(other) / RadialKnots::r2(knot))});
    }
  }

  std::array<std::vector<Tap>, RadialKnots::kCount> taps_;
};

std::size_t order_of(int m, int k) {
  const auto found = std::find_if(kOrders.begin(), kOrders.end(), [&](const AngularOrder& order) {
    return order.m == m && order.k == k;
  });
  return static_cast<std::size_t>(found - kOrders.begin());
}

}  // namespace

// What one task sums up for one incidence.
struct ScatterTable::Strand {
  // Ratios innermost: one exit adds to all of them.
  static std::size_t place(std::size_t term, std::size_t knot, std::size_t ratio) {
    return ((term * RadialKnots::kCount + knot) * kRatios + ratio) * kAngularStride;
  }
  std::vector<float> sums = std::vector<float>(place(ExitProjection::kTerms, 0, 0), 0.0F);
  // [knot][ratio] of squared weights: where the noise is.
  std::vector<float> squares = std::vector<float>(RadialKnots::kCount * kRatios, 0.0F);

  void score(const PhotonExit& exit, const std::array<double, kRatios>& ratios) {
    const double r2 = exit.x * exit.x + exit.y * exit.y;
    const double r = std::sqrt(std::max(r2, 1e-30));
    const RadialKnots::Place at = RadialKnots::place_of(static_cast<float>(r2));
    const double ca = exit.x / r, sa = exit.y / r;
    const double cb = exit.cos_azimuth, sb = exit.sin_azimuth;
    const std::array<double, 3> cos_a = {1, ca, ca * ca - sa * sa}, sin_a = {0, sa, 2 * ca * sa};
    const std::array<double, 3> cos_b = {1, cb, cb * cb - sb * sb}, sin_b = {0, sb, 2 * cb * sb};
    const auto terms = exit_projection().terms(1 - exit.cos_exit * exit.cos_exit);
    std::array<std::array<float, kAngularStride>, ExitProjection::kTerms> shapes{};
    for (std::size_t i = 0; i < kAngularOrders; ++i) {
      const auto m = static_cast<std::size_t>(kOrders[i].m);
      const auto k = static_cast<std::size_t>(power_of(kOrders[i].k));
      const double wave = cos_a[m] * cos_b[k] - (kOrders[i].k < 0 ? -1 : 1) * sin_a[m] * sin_b[k];
      for (std::size_t term = 0; term < shapes.size(); ++term)
        shapes[term][i] = static_cast<float>(wave * terms[term][k]);
    }
    std::array<float, kRatios> weights{};
    std::size_t count = 0;  // of the ratios at which anything is left
    for (; count < kRatios; ++count) {
      const double weight = exit.weight * std::exp(-ratios[count] * exit.path_length);
      if (weight < 1e-9) break;
      weights[count] = static_cast<float>(weight);
    }
    float* square = &squares[at.knot * kRatios];
    for (std::size_t ratio = 0; ratio < count; ++ratio)
      square[ratio] += weights[ratio] * weights[ratio];
    for (std::size_t term = 0; term < shapes.size(); ++term)
      for (std::size_t side = 0; side < 2; ++side) {
        const float share = side == 0 ? 1 - at.fraction : at.fraction;
        float* sum = &sums[place(term, at.knot + side, 0)];
        for (std::size_t ratio = 0; ratio < count; ++ratio, sum += kAngularStride)
          for (std::size_t i = 0; i < kAngularStride; ++i)
            sum[i] += share * weights[ratio] * shapes[term][i];
      }
  }
};

ScatterTable ScatterTable::make(int photons_per_angle, std::uint64_t seed,
                                const std::function<void(double)>& progress) {
  std::array<double, kRatios> ratios{};
  for (std::size_t i = 0; i < kRatios; ++i) ratios[i] = ratio_at(i, kRatios);
  ScatterTable table;
  table.orders_.resize(kRatios * kRatioSize);
  const int per_strand = std::max(1, photons_per_angle / static_cast<int>(kStrands));
  Noise noise(RadialKnots::kCount * kRatios, 0.0);
  std::mutex progress_mutex;
  std::size_t done = 0;  // guarded by progress_mutex
  for (std::size_t incidence = 0; incidence < kAngleNodes; ++incidence) {
    const double incidence_rad = std::asin(std::sqrt(kNodeSines2[incidence]));
    std::vector<Strand> strands(kStrands);
    tbb::parallel_for(std::size_t{0}, kStrands, [&](std::size_t s) {
      PhotonRandom random(seed + 1000 * incidence + s);
      for (int photon = 0; photon < per_strand; ++photon)
        walk_photon(incidence_rad, random,
                    [&](const PhotonExit& exit) { strands[s].score(exit, ratios); });
      const std::lock_guard lock(progress_mutex);
      ++done;
      if (progress) progress(static_cast<double>(done) / double{kStrands * kAngleNodes});
    });
    table.take(strands, incidence, static_cast<double>(per_strand) * double{kStrands});
    for (const Strand& strand : strands)
      for (std::size_t i = 0; i < noise.size(); ++i)
        noise[i] += static_cast<double>(strand.squares[i]);
  }
  table.make_reciprocal();
  table.smooth_over_radius();
  table.set_totals(noise);
  return table;
}

void ScatterTable::take(const std::vector<Strand>& strands, std::size_t incidence, double photons) {
  const auto& areas = RadialKnots::areas();
  for (std::size_t ratio = 0; ratio < kRatios; ++ratio) {
    for (std::size_t knot = 0; knot < RadialKnots::kCount; ++knot)
      for (std::size_t i = 0; i < kAngularOrders; ++i) {
        std::array<double, ExitProjection::kTerms> sums{};
        for (const Strand& strand : strands)
          for (std::size_t term = 0; term < sums.size(); ++term)
            sums[term] += static_cast<double>(strand.sums[Strand::place(term, knot, ratio) + i]);
        // A series of cosines: twice the mean, but for the order 0.
        const double norm = (i > 0 ? 2 : 1) / (photons * areas[knot]);
        const auto power = static_cast<std::size_t>(power_of(kOrders[i].k));
        for (std::size_t exit = 0; exit < kAngleNodes; ++exit)
          orders_[index(ratio, incidence, exit, knot) + i] =
              static_cast<float>(norm * exit_projection().at_node(exit, power, sums));
      }
  }
}

// Photons that leave at 3 mm rather than 3.1 mm say something of stripes 0.5 mm wide only by their
// noise: over the logarithm of the radius light varies slowly, so cubics through the knots around
// each say the same of the mean with less of it. Fitted to r^2 K, which is nearly even there.
void ScatterTable::smooth_over_radius() {
  const RadialSmoother smoother;
  using Line = std::array<std::array<float, kAngularStride>, RadialKnots::kCount>;
  for (std::size_t ratio = 0; ratio < kRatios; ++ratio)
    for (std::size_t in = 0; in < kAngleNodes; ++in)
      for (std::size_t out = 0; out < kAngleNodes; ++out) {
        Line smooth{};
        const float* from = &orders_[index(ratio, in, out, 0)];
        for (std::size_t knot = 0; knot < RadialKnots::kCount; ++knot)
          for (const RadialSmoother::Tap& tap : smoother.taps(knot))
            for (std::size_t i = 0; i < kAngularOrders; ++i)
              smooth[knot][i] += tap.weight * from[tap.knot * kAngularStride + i];
        std::copy_n(smooth.front().data(), smooth.size() * kAngularStride,
                    &orders_[index(ratio, in, out, 0)]);
      }
}

// What all places reflect together needs no photons: the photons' noise in it is taken out, from
// each place its share of it.
void ScatterTable::set_totals(const Noise& noise) {
  const auto& areas = RadialKnots::areas();
  tbb::parallel_for(std::size_t{0}, kRatios, [&](std::size_t ratio) {
    const HalfSpaceTotals wanted = half_space_totals(ratio_at(ratio, kRatios));
    totals_[ratio] = wanted.reflectance;
    double all_noise = 1e-30;
    for (std::size_t knot = 0; knot < RadialKnots::kCount; ++knot)
      all_noise += noise[knot * kRatios + ratio];
    for (std::size_t in = 0; in < kAngleNodes; ++in)
      for (std::size_t out = 0; out < kAngleNodes; ++out)
        for (std::size_t k = 0; k < 3; ++k) {
          const auto value = [&](std::size_t knot) -> float& {
            return orders_[index(ratio, in, out, knot) + k];
          };
          double missing = wanted.by_direction[k][in][out];
          for (std::size_t knot = 0; knot < RadialKnots::kCount; ++knot)
            missing -= areas[knot] * static_cast<double>(value(knot));
          for (std::size_t knot = 0; knot < RadialKnots::kCount; ++knot)
            value(knot) += static_cast<float>(missing * noise[knot * kRatios + ratio] /
                                              (all_noise * areas[knot]));
        }
  });
}

// Light and eye may change places: the way in becomes the way out, from -r, all azimuths now from
// the old exit: g_mk(in, exit) = g_m,-(m+k)(exit, in). Two walks that say the same are one of less
// noise; each counts as its own noise allows.
void ScatterTable::make_reciprocal() {
  for (std::size_t i = 0; i < kAngularOrders; ++i) {
    const auto out_power = static_cast<std::size_t>(power_of(kOrders[i].k));
    const auto in_power = static_cast<std::size_t>(power_of(kOrders[i].m + kOrders[i].k));
    const int k = -(kOrders[i].m + kOrders[i].k);
    const std::size_t other = order_of(kOrders[i].m, kOrders[i].m == 0 ? power_of(k) : k);
    if (other < i || other == kAngularOrders) continue;  // done with the other, or not tabulated
    for (std::size_t in = 0; in < kAngleNodes; ++in)
      for (std::size_t out = 0; out < kAngleNodes; ++out) {
        if (other == i && out < in) continue;
        const double variance = exit_projection().variance_at_node(out, out_power);
        const double other_variance = exit_projection().variance_at_node(in, in_power);
        const double share =
            variance + other_variance > 0 ? other_variance / (variance + other_variance) : 0;
        for (std::size_t ratio = 0; ratio < kRatios; ++ratio)
          for (std::size_t knot = 0; knot < RadialKnots::kCount; ++knot) {
            float& here = orders_[index(ratio, in, out, knot) + i];
            float& there = orders_[index(ratio, out, in, knot) + other];
            here = there = static_cast<float>(share * static_cast<double>(here) +
                                              (1 - share) * static_cast<double>(there));
          }
      }
  }
}

std::array<ScatterTable::Corner, 4> ScatterTable::ratio_corners(double ratio) {
  const double position =
      std::clamp(std::log(ratio / kLeastRatio) / std::log(kGreatestRatio / kLeastRatio), 0.0, 1.0) *
      static_cast<double>(kRatios - 1);
  const std::size_t first =
      static_cast<std::size_t>(std::clamp(std::floor(position) - 1, 0.0, double{kRatios - 4}));
  // Lagrange's cubic: the nodes are a factor of 1.5 apart, where a line would be off by 1%.
  std::array<Corner, 4> corners{};
  for (std::size_t i = 0; i < 4; ++i) {
    corners[i] = {first + i, 1};
    for (std::size_t j = 0; j < 4; ++j)
      if (j != i)
        corners[i].weight *= (position - static_cast<double>(first + j)) /
                             (static_cast<double>(i) - static_cast<double>(j));
  }
  return corners;
}

double ScatterTable::total_reflectance(const Scattering& scattering) const {
  double total = 0;
  for (const Corner& corner :
       ratio_corners(scattering.sigma_a_per_mm / scattering.sigma_s_prime_per_mm))
    total += corner.weight * totals_[corner.at];
  return total;
}

SkinMaterial ScatterTable::material(const Scattering& scattering) const {
  SkinMaterial material;
  material.scattering_ = scattering;
  material.orders_.assign(kRatioSize, 0.0F);
  for (const Corner& corner :
       ratio_corners(scattering.sigma_a_per_mm / scattering.sigma_s_prime_per_mm)) {
    const float* from = &orders_[corner.at * kRatioSize];
    const auto weight = static_cast<float>(corner.weight);
    for (std::size_t i = 0; i < kRatioSize; ++i) material.orders_[i] += weight * from[i];
  }
  return material;
}

ScatterTable ScatterTable::cached(const std::filesystem::path& folder, int photons_per_angle,
                                  std::uint64_t seed, const std::function<void(double)>& progress) {
  const std::uint64_t key =
      (kVersion << 56) ^ (seed << 32) ^ static_cast<unsigned>(photons_per_angle);
  const std::filesystem::path file = folder / ("scattering-" + std::to_string(key));
  ScatterTable table;
  if (!folder.empty() && table.load(file, key)) return table;
  table = make(photons_per_angle, seed, progress);
  if (!folder.empty()) table.save(file, key);
  return table;
}

bool ScatterTable::load(const std::filesystem::path& file, std::uint64_t key) {
  std::ifstream in(file, std::ios::binary);
  std::uint64_t stored = 0, sum = 0;
  in.read(reinterpret_cast<char*>(&stored), sizeof(stored));
  if (!in || stored != key) return false;
  orders_.resize(kRatios * kRatioSize);
  in.read(reinterpret_cast<char*>(orders_.data()),
          static_cast<std::streamsize>(orders_.size() * sizeof(float)));
  in.read(reinterpret_cast<char*>(totals_.data()), sizeof(totals_));
  in.read(reinterpret_cast<char*>(&sum), sizeof(sum));
  return in.good() && in.peek() == std::ifstream::traits_type::eof() && sum == checksum();
}

void ScatterTable::save(const std::filesystem::path& file, std::uint64_t key) const {
  std::error_code error;
  std::filesystem::create_directories(file.parent_path(), error);
  const std::filesystem::path temporary = file.string() + "." + std::to_string(getpid()) + ".tmp";
  bool is_written = false;
  {
    std::ofstream out(temporary, std::ios::binary);
    const std::uint64_t sum = checksum();
    out.write(reinterpret_cast<const char*>(&key), sizeof(key));
    out.write(reinterpret_cast<const char*>(orders_.data()),
              static_cast<std::streamsize>(orders_.size() * sizeof(float)));
    out.write(reinterpret_cast<const char*>(totals_.data()), sizeof(totals_));
    out.write(reinterpret_cast<const char*>(&sum), sizeof(sum));
    out.flush();
    is_written = out.good();
  }
  if (is_written) std::filesystem::rename(temporary, file, error);
  if (!is_written || error) std::filesystem::remove(temporary, error);
}

std::uint64_t ScatterTable::checksum() const {
  std::uint64_t state = 0xCBF29CE484222325U;
  for (const float value : orders_) {
    state = (state ^ std::bit_cast<std::uint32_t>(value)) * 0x9FB21C651E98DF25U;
    state ^= state >> 32;
  }
  return state;
}

}  // namespace hw_sim
