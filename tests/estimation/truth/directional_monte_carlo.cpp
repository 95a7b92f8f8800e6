#include "tests/estimation/truth/directional_monte_carlo.h"

#include <cmath>
#include <numbers>

#include "estimation/models/monte_carlo/random_stream.h"

namespace estimation::testing {
namespace {

using std::numbers::pi;

struct Vector {
  double x, y, z;
};

double dot(const Vector& a, const Vector& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Unpolarised Fresnel reflection between the air and the medium, by the angles on both sides.
double reflected(double eta, double cos_inside) {
  const double sin_outside = eta * std::sqrt(1 - cos_inside * cos_inside);
  if (sin_outside >= 1) return 1;
  const double outside = std::asin(sin_outside), inside = std::acos(cos_inside);
  if (outside < 1e-6) return std::pow((eta - 1) / (eta + 1), 2);
  const double s = std::sin(outside - inside) / std::sin(outside + inside);
  const double p = std::tan(outside - inside) / std::tan(outside + inside);
  return 0.5 * (s * s + p * p);
}

// The direction inside of light along this direction outside (azimuth as given), z > 0.
Vector inside_of(double eta, double cos_outside, double azimuth_rad) {
  const double sine = std::sqrt(1 - cos_outside * cos_outside) / eta;
  return {sine * std::cos(azimuth_rad), sine * std::sin(azimuth_rad), std::sqrt(1 - sine * sine)};
}

class Walk {
 public:
  explicit Walk(const DirectionalRun& run)
      : run_(run),
        random_(run.seed, 0),
        sigma_s_(1 / (1 - run.anisotropy)),
        sigma_t_(sigma_s_ + run.absorption),
        albedo_(sigma_s_ / sigma_t_),
        exit_(inside_of(run.eta, run.directions.cos_exit, run.directions.exit_azimuth_rad)),
        exit_scale_(pi * (1 - reflected(run.eta, exit_.z)) / (run.eta * run.eta * exit_.z)),
        sums_(static_cast<std::size_t>(run.harmonic_count) + 1) {
    exit_.z = -exit_.z;
    start_ = inside_of(run.eta, run.directions.cos_incidence, run.directions.incidence_azimuth_rad);
    entering_ = 1 - reflected(run.eta, start_.z);
    start_.x = -start_.x;  // towards the projector becomes away from it
    start_.y = -start_.y;
  }

  // Adds what one photon sends into the exit direction, [n].
  const std::vector<std::complex<double>>& photon() {
    std::fill(sums_.begin(), sums_.end(), 0);
    Vector at{0, 0, 0}, along = start_;
    double weight = entering_;
    // Every fourfold number of collisions ends half of the walks and doubles the others.
    std::int64_t next_roulette = 20;
    for (std::int64_t collision = 1; fly(at, along, weight); ++collision) {
      weight *= albedo_;
      score(at, along, weight);
      if (collision == next_roulette) {
        if (random_.uniform() < 0.5) break;
        weight *= 2;
        next_roulette *= 4;
      }
      if (weight < 1e-3 && random_.uniform() < 0.9) break;
      if (weight < 1e-3) weight *= 10;
      along = scattered(along);
    }
    return sums_;
  }

 private:
  // To the next collision, mirrored at the surface as often as it is met.
  bool fly(Vector& at, Vector& along, double& weight) {
    double length = -std::log(random_.uniform()) / sigma_t_;
    if (at.z + length * along.z < 0) {
      const double there = -at.z / along.z;
      at.x += there * along.x;
      at.y += there * along.y;
      at.z = 0;
      length -= there;
      weight *= reflected(run_.eta, -along.z);
      along.z = -along.z;
      if (weight <= 0) return false;
    }
    at.x += length * along.x;
    at.y += length * along.y;
    at.z += length * along.z;
    return true;
  }

  void score(const Vector& at, const Vector& along, double weight) {
    const double depth = sigma_t_ * at.z / -exit_.z;
    if (depth > 25) return;
    const double g = run_.anisotropy;
    const double denominator = 1 + g * g - 2 * g * dot(along, exit_);
    const double phase_function = (1 - g * g) / (4 * pi * denominator * std::sqrt(denominator));
    const double score = weight * phase_function * exit_scale_ * std::exp(-depth);
    const double x = at.x - at.z / exit_.z * exit_.x;
    const std::complex<double> turn = std::polar(1.0, -run_.k_tmfp * x);
    std::complex<double> phasor = score;
    for (std::complex<double>& sum : sums_) {
      sum += phasor;
      phasor *= turn;
    }
  }

  Vector scattered(const Vector& along) {
    const double g = run_.anisotropy, u = random_.uniform();
    const double ratio = (1 - g * g) / (1 - g + 2 * g * u);
    const double cosine = g == 0 ? 2 * u - 1 : (1 + g * g - ratio * ratio) / (2 * g);
    const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
    const double azimuth_rad = 2 * pi * random_.uniform();
    // Any axis that is not along the direction.
    const Vector axis = std::abs(along.z) < 0.9 ? Vector{0, 0, 1} : Vector{1, 0, 0};
    Vector u1{axis.y * along.z - axis.z * along.y, axis.z * along.x - axis.x * along.z,
              axis.x * along.y - axis.y * along.x};
    const double norm = 1 / std::sqrt(dot(u1, u1));
    u1 = {u1.x * norm, u1.y * norm, u1.z * norm};
    const Vector u2{along.y * u1.z - along.z * u1.y, along.z * u1.x - along.x * u1.z,
                    along.x * u1.y - along.y * u1.x};
    const double a = sine * std::cos(azimuth_rad), b = sine * std::sin(azimuth_rad);
    Vector next{cosine * along.x + a * u1.x + b * u2.x, cosine * along.y + a * u1.y + b * u2.y,
                cosine * along.z + a * u1.z + b * u2.z};
    const double length = 1 / std::sqrt(dot(next, next));
    return {next.x * length, next.y * length, next.z * length};
  }

  const DirectionalRun& run_;
  RandomStream random_;
  double sigma_s_, sigma_t_, albedo_;
  Vector exit_, start_{};
  double exit_scale_, entering_ = 0;
  std::vector<std::complex<double>> sums_;
};

}  // namespace

DirectionalResult run_directional(const DirectionalRun& run) {
  Walk walk(run);
  const auto count = static_cast<std::size_t>(run.harmonic_count) + 1;
  DirectionalResult result{.value = std::vector<std::complex<double>>(count),
                           .se = std::vector<double>(count)};
  for (std::int64_t i = 0; i < run.photon_count; ++i) {
    const auto& photon = walk.photon();
    for (std::size_t n = 0; n < count; ++n) {
      result.value[n] += photon[n];
      result.se[n] += std::norm(photon[n]);
    }
  }
  const auto photons = static_cast<double>(run.photon_count);
  for (std::size_t n = 0; n < count; ++n) {
    result.value[n] /= photons;
    const double variance = (result.se[n] / photons - std::norm(result.value[n])) / photons;
    result.se[n] = std::sqrt(0.5 * variance);
  }
  return result;
}

}  // namespace estimation::testing
