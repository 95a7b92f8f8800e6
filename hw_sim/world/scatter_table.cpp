#include "hw_sim/world/scatter_table.h"

#include <tbb/parallel_for.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <fstream>
#include <mutex>
#include <numbers>
#include <span>
#include <string>

#include "hw_sim/world/white_walk.h"

namespace hw_sim {

namespace {

constexpr std::uint64_t kVersion = 5;  // of what a file holds
constexpr double kTailFrac = 1e-4;
constexpr std::size_t kStrands = 16;  // of photons, each with its own sums: fixed, so that threads
                                      // do not change the numbers

// Knots are where a float's exponent and first three bits of mantissa change.
constexpr int kFractionBits = 20;
constexpr std::uint32_t kFractionMask = (1U << kFractionBits) - 1;
constexpr float kFractionScale = 1.0F / static_cast<float>(1U << kFractionBits);
const std::uint32_t kFirstBits =
    std::bit_cast<std::uint32_t>(std::ldexp(1.0F, SkinKernel::kFirstExponent));

struct Place {
  std::size_t knot = 0;  // below
  float fraction = 0;    // of the way to the next
};

Place place_of(float r2) {
  const std::uint32_t bits = std::max(std::bit_cast<std::uint32_t>(r2), kFirstBits);
  const std::size_t knot = (bits - kFirstBits) >> kFractionBits;
  if (knot + 1 >= SkinKernel::kKnots) return {SkinKernel::kKnots - 2, 1};
  return {knot, static_cast<float>(bits & kFractionMask) * kFractionScale};
}

double knot_r2(std::size_t knot) {
  return static_cast<double>(
      std::bit_cast<float>(kFirstBits + (static_cast<std::uint32_t>(knot) << kFractionBits)));
}

// The integral of knot k's hat over the plane: hats are linear in r^2, and dA = pi d(r^2).
std::array<double, SkinKernel::kKnots> knot_areas() {
  std::array<double, SkinKernel::kKnots> areas{};
  for (std::size_t k = 0; k < areas.size(); ++k) {
    const double below = k == 0 ? 0 : knot_r2(k - 1);
    const double above = k + 1 < areas.size() ? knot_r2(k + 1) : knot_r2(k);
    areas[k] = std::numbers::pi * (above - below) / 2;
    if (k == 0) areas[k] += std::numbers::pi * knot_r2(0) / 2;  // flat within the first knot
  }
  return areas;
}

double ratio_at(std::size_t i, std::size_t count) {
  const double share = static_cast<double>(i) / static_cast<double>(count - 1);
  return ScatterTable::kLeastRatio *
         std::pow(ScatterTable::kGreatestRatio / ScatterTable::kLeastRatio, share);
}

// How the radiance falls with the angle of exit, roughly: what the boundary lets through. What the
// table holds is the share of it, which varies so little with the angle that linear hats, whose
// means stand for their middle, lose little.
double typical_radiance(double exit_rad) {
  return 1 - fresnel_reflectance(std::cos(exit_rad), 1, kSkinIndex);
}

// 2 times the integral of node j's hat times sin^n over the hemisphere with Lambert's cosine: what
// an exit of the typical radiance would put there. The last node's hat is flat to the horizon.
double typical_share(std::span<const double> nodes, std::size_t j, int power) {
  constexpr int kSteps = 4000;
  double sum = 0;
  for (int i = 0; i < kSteps; ++i) {
    const double angle = (i + 0.5) / kSteps * std::numbers::pi / 2;
    double hat = 0;
    if (j + 1 == nodes.size() && angle >= nodes[j])
      hat = 1;
    else if (j > 0 && angle >= nodes[j - 1] && angle < nodes[j])
      hat = (angle - nodes[j - 1]) / (nodes[j] - nodes[j - 1]);
    else if (j + 1 < nodes.size() && angle >= nodes[j] && angle < nodes[j + 1])
      hat = (nodes[j + 1] - angle) / (nodes[j + 1] - nodes[j]);
    sum += hat * 2 * std::sin(angle) * std::cos(angle) * std::pow(std::sin(angle), power) *
           typical_radiance(angle);
  }
  return sum * std::numbers::pi / 2 / kSteps;
}

}  // namespace

SkinKernel::Ring SkinKernel::ring(std::size_t knot) const {
  static const auto areas = knot_areas();
  Ring ring;
  ring.radius_mm = std::sqrt(knot_r2(knot) / static_cast<double>(scale2_));
  ring.area_mm2 = areas[knot] / static_cast<double>(scale2_);
  for (std::size_t i = 0; i < kTerms; ++i) ring.terms[i] = static_cast<double>(knots_[knot][i]);
  return ring;
}

float SkinKernel::at(float distance2_mm2, float x_mm, float y_mm) const {
  const Place place = place_of(distance2_mm2 * scale2_);
  const std::array<float, 8>& low = knots_[place.knot];
  const std::array<float, 8>& high = knots_[place.knot + 1];
  const auto term = [&](std::size_t i) { return low[i] + place.fraction * (high[i] - low[i]); };
  const float across2 = x_mm * x_mm + y_mm * y_mm;
  if (!(across2 > 0)) return term(0);
  const float inverse = 1 / std::sqrt(across2);
  const float c = x_mm * inverse, s = y_mm * inverse;
  return term(0) + c * term(1) + s * term(2) + (c * c - s * s) * term(3) + 2 * c * s * term(4);
}

// What one task sums up for one incidence.
struct ScatterTable::Strand {
  std::vector<float> moments = std::vector<float>(index(1, 0, 0, 0), 0.0F);
  // Ratios innermost: one exit adds to all of them.
  static std::size_t place(std::size_t exit, std::size_t knot, std::size_t ratio) {
    return ((exit * SkinKernel::kKnots + knot) * kRatios + ratio) * kStride;
  }
  std::array<double, kRatios> totals{};

  void score(const PhotonExit& exit, const std::array<double, kRatios>& ratios) {
    const double exit_rad = std::acos(std::min(exit.cos_exit, 1.0));
    const auto exits = angle_corners(kExits_rad, exit_rad);
    const double r2 = exit.x * exit.x + exit.y * exit.y;
    const Place at = place_of(static_cast<float>(r2));
    const double r = std::sqrt(std::max(r2, 1e-30));
    const double ca = exit.x / r, sa = exit.y / r;
    const double cb = exit.cos_azimuth, sb = exit.sin_azimuth;
    const std::array<double, 3> cos_a = {1, ca, ca * ca - sa * sa};
    const std::array<double, 3> cos_b = {1, cb, cb * cb - sb * sb};
    const std::array<double, 2> sin_a = {sa, 2 * ca * sa}, sin_b = {sb, 2 * cb * sb};
    std::array<float, kStride> shape{};
    for (std::size_t m = 0; m < 3; ++m)
      for (std::size_t n = 0; n < 3; ++n)
        shape[3 * m + n] = static_cast<float>(cos_a[m] * cos_b[n]);
    for (std::size_t m = 0; m < 2; ++m)
      for (std::size_t n = 0; n < 2; ++n)
        shape[9 + 2 * m + n] = static_cast<float>(sin_a[m] * sin_b[n]);
    std::array<float, kRatios> weights{};
    std::size_t count = 0;  // of the ratios at which anything is left
    for (; count < kRatios; ++count) {
      const double weight = exit.weight * std::exp(-ratios[count] * exit.path_length);
      if (weight < 1e-9) break;
      totals[count] += weight;
      weights[count] = static_cast<float>(weight);
    }
    for (const Corner& corner : exits)
      for (std::size_t side = 0; side < 2; ++side) {
        const float share =
            static_cast<float>(corner.weight) * (side == 0 ? 1 - at.fraction : at.fraction);
        float* sums = &moments[place(corner.at, at.knot + side, 0)];
        for (std::size_t ratio = 0; ratio < count; ++ratio, sums += kStride)
          for (std::size_t i = 0; i < kStride; ++i) sums[i] += share * weights[ratio] * shape[i];
      }
  }
};

ScatterTable ScatterTable::make(int photons_per_angle, std::uint64_t seed,
                                const std::function<void(double)>& progress) {
  std::array<double, kRatios> ratios{};
  for (std::size_t i = 0; i < kRatios; ++i) ratios[i] = ratio_at(i, kRatios);
  const auto areas = knot_areas();
  ScatterTable table;
  table.moments_.resize(index(kIncidences_rad.size(), 0, 0, 0));
  const int per_strand = std::max(1, photons_per_angle / static_cast<int>(kStrands));
  const double photons = static_cast<double>(per_strand) * static_cast<double>(kStrands);
  std::mutex progress_mutex;
  std::size_t done = 0;  // guarded by progress_mutex
  for (std::size_t incidence = 0; incidence < kIncidences_rad.size(); ++incidence) {
    std::vector<Strand> strands(kStrands);
    tbb::parallel_for(std::size_t{0}, kStrands, [&](std::size_t s) {
      PhotonRandom random(seed + 1000 * incidence + s);
      for (int photon = 0; photon < per_strand; ++photon)
        walk_photon(kIncidences_rad[incidence], random,
                    [&](const PhotonExit& exit) { strands[s].score(exit, ratios); });
      const std::lock_guard lock(progress_mutex);
      ++done;
      if (progress)
        progress(static_cast<double>(done) /
                 static_cast<double>(kStrands * kIncidences_rad.size()));
    });
    for (std::size_t ratio = 0; ratio < kRatios; ++ratio) {
      if (incidence == 0)
        for (const Strand& strand : strands) table.totals_[ratio] += strand.totals[ratio] / photons;
      for (std::size_t exit = 0; exit < kExits_rad.size(); ++exit)
        for (std::size_t i = 0; i < kMoments; ++i) {
          const std::size_t n = i < 9 ? i % 3 : 1 + (i - 9) % 2;  // order of the exit's azimuth
          const std::size_t m = i < 9 ? i / 3 : 1 + (i - 9) / 2;
          // cos and sin series: twice the mean, but for the order 0.
          const double norm = (m > 0 ? 2.0 : 1.0) * (n > 0 ? 2.0 : 1.0) /
                              (photons * typical_share(kExits_rad, exit, static_cast<int>(n)));
          for (std::size_t knot = 0; knot < SkinKernel::kKnots; ++knot) {
            double sum = 0;
            for (const Strand& strand : strands)
              sum += static_cast<double>(strand.moments[Strand::place(exit, knot, ratio) + i]);
            table.moments_[index(incidence, exit, ratio, knot) + i] =
                static_cast<float>(sum * norm / areas[knot]);
          }
        }
    }
  }
  return table;
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

std::array<ScatterTable::Corner, 2> ScatterTable::angle_corners(const std::array<double, 5>& nodes,
                                                                double angle_rad) {
  std::size_t above = 1;
  while (above + 1 < nodes.size() && nodes[above] < angle_rad) ++above;
  const double fraction =
      std::clamp((angle_rad - nodes[above - 1]) / (nodes[above] - nodes[above - 1]), 0.0, 1.0);
  return {{{above - 1, 1 - fraction}, {above, fraction}}};
}

double ScatterTable::total_reflectance(const Scattering& scattering) const {
  double total = 0;
  for (const Corner& corner :
       ratio_corners(scattering.sigma_a_per_mm / scattering.sigma_s_prime_per_mm))
    total += corner.weight * totals_[corner.at];
  return total;
}

SkinKernel ScatterTable::kernel(const Scattering& scattering, const LightPath& path) const {
  using Sums = std::array<float, kStride>;
  std::array<Sums, SkinKernel::kKnots> sums{};
  for (const Corner& ratio :
       ratio_corners(scattering.sigma_a_per_mm / scattering.sigma_s_prime_per_mm))
    for (const Corner& incidence : angle_corners(kIncidences_rad, path.incidence_rad))
      for (const Corner& exit : angle_corners(kExits_rad, path.exit_rad)) {
        const auto weight = static_cast<float>(ratio.weight * incidence.weight * exit.weight);
        if (weight == 0) continue;
        const float* from = &moments_[index(incidence.at, exit.at, ratio.at, 0)];
        for (Sums& sum : sums) {
          for (std::size_t i = 0; i < kStride; ++i) sum[i] += weight * from[i];
          from += kStride;
        }
      }
  const double sine = std::sin(path.exit_rad), b = path.exit_azimuth_rad;
  const std::array<double, 3> cos_b = {1, sine * std::cos(b), sine * sine * std::cos(2 * b)};
  const std::array<double, 2> sin_b = {sine * std::sin(b), sine * sine * std::sin(2 * b)};
  const double scale2 = scattering.sigma_s_prime_per_mm * scattering.sigma_s_prime_per_mm;
  const double radiance = scale2 * typical_radiance(path.exit_rad);
  SkinKernel kernel;
  kernel.scale2_ = static_cast<float>(scale2);
  static const auto areas = knot_areas();
  for (std::size_t knot = 0; knot < sums.size(); ++knot) {
    const auto cosines = [&](std::size_t m) {
      double sum = 0;
      for (std::size_t n = 0; n < 3; ++n)
        sum += cos_b[n] * static_cast<double>(sums[knot][3 * m + n]);
      return static_cast<float>(radiance * sum);
    };
    const auto sines = [&](std::size_t m) {
      double sum = 0;
      for (std::size_t n = 0; n < 2; ++n)
        sum += sin_b[n] * static_cast<double>(sums[knot][9 + 2 * (m - 1) + n]);
      return static_cast<float>(radiance * sum);
    };
    kernel.knots_[knot] = {cosines(0), cosines(1), sines(1), cosines(2), sines(2), 0, 0, 0};
    kernel.total_ += static_cast<double>(kernel.knots_[knot][0]) * areas[knot] / scale2;
  }
  double beyond = 0;
  std::size_t last = SkinKernel::kKnots - 1;
  while (last > 0 && beyond < kTailFrac * kernel.total_) {
    beyond += static_cast<double>(kernel.knots_[last][0]) * areas[last] / scale2;
    --last;
  }
  kernel.radius_mm_ = std::sqrt(knot_r2(last + 1) / scale2);
  return kernel;
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
  moments_.resize(index(kIncidences_rad.size(), 0, 0, 0));
  in.read(reinterpret_cast<char*>(moments_.data()),
          static_cast<std::streamsize>(moments_.size() * sizeof(float)));
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
    out.write(reinterpret_cast<const char*>(moments_.data()),
              static_cast<std::streamsize>(moments_.size() * sizeof(float)));
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
  for (const float value : moments_) {
    state = (state ^ std::bit_cast<std::uint32_t>(value)) * 0x9FB21C651E98DF25U;
    state ^= state >> 32;
  }
  return state;
}

}  // namespace hw_sim
