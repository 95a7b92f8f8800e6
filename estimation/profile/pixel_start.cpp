#include "estimation/profile/pixel_start.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "estimation/profile/small_matrix.h"

namespace estimation {
namespace {

// Where a start looks for R_d, as a share of the mean: B from -R_d/5 to 12 R_d.
constexpr double kLeastShare = 0.08, kGreatestShare = 1.25;
// A quarter of a projector pixel: where all profiles look alike a search finds no way out.
constexpr double kLeastLogStart = -1.4;
constexpr double kNoHarmonic = 1e-3;  // of full light
// Of the second start: a third of the period lit by the profile's tail.
constexpr double kPeriodsOfSecondStart = 1.0 / 12, kShareOfSecondStart = 0.6;

double reflectance_at(double logit) { return 1 / (1 + std::exp(-logit)); }
double logit_of(double reflectance) { return std::log(reflectance / (1 - reflectance)); }

template <std::size_t N>
std::optional<Demodulated> demodulate(PixelModel& model, int second_harmonic) {
  const std::size_t count = model.sample_count();
  if (count < N) return std::nullopt;
  SmallMatrix<N> normal{};
  std::array<double, N> right{};
  // The highest one first: it makes room for those below.
  model.cosines(second_harmonic);
  const std::array<std::span<const double>, 2> first = {model.cosines(1), model.sines(1)};
  const std::array<std::span<const double>, 2> second = {model.cosines(second_harmonic),
                                                         model.sines(second_harmonic)};
  for (std::size_t sample = 0; sample < count; ++sample) {
    std::array<double, N> row{};
    row[0] = 1;
    row[1] = first[0][sample];
    row[2] = first[1][sample];
    if constexpr (N == 5) row[3] = second[0][sample], row[4] = second[1][sample];
    for (std::size_t i = 0; i < N; ++i) {
      right[i] += row[i] * model.reflectance()[sample];
      for (std::size_t j = 0; j <= i; ++j) normal[i][j] += row[i] * row[j];
    }
  }
  const auto root = scaled_cholesky(normal);
  if (!root) return std::nullopt;
  const std::array<double, N> x = root->solve(right);
  std::array<double, N> re{}, im{};
  re[1] = im[2] = 1;
  const auto back = [&](int n) { return std::polar(1.0, -n * model.origin_rad()); };
  Demodulated data{.mean = x[0],
                   .first = std::complex(x[1], x[2]) * back(1),
                   .first_variance = 0.5 * (root->solve(re)[1] + root->solve(im)[2])};
  if constexpr (N == 5) data.second = std::complex(x[3], x[4]) * back(second_harmonic);
  return data;
}

}  // namespace

PixelStart::PixelStart(const FitProblem& problem, PixelModel& model)
    : problem_(problem), model_(model) {
  if (problem.table != nullptr && problem.table->rows() > 0) range_ = problem.table->range();
  // Stripes half as wide as their period have no second harmonic.
  if (std::abs(envelope(2)) < kNoHarmonic) second_ = 3;
}

double PixelStart::envelope(int n) const {
  return std::sin(std::numbers::pi * n * problem_.shape.width_px / problem_.shape.period_px) /
         (std::numbers::pi * n);
}

std::optional<Demodulated> PixelStart::demodulate() const {
  if (const auto data = estimation::demodulate<5>(model_, second_)) return data;
  return estimation::demodulate<3>(model_, second_);
}

// a_1 and a_second near this point.
std::array<double, 2> PixelStart::first_harmonics(ShapePoint shape) const {
  const HarmonicTable* table = problem_.table;
  if (table != nullptr && table->harmonic_count() >= second_ && table->holds(shape)) {
    const ShapePoint& least = table->range().least;
    const auto node = table->node(
        static_cast<int>(
            std::round((shape.logit_reflectance - least.logit_reflectance) / table->logit_step())),
        static_cast<int>(std::round((shape.log_translucency_px - least.log_translucency_px) /
                                    table->log_step())));
    return {static_cast<double>(node[0]),
            static_cast<double>(node[static_cast<std::size_t>(second_ - 1)])};
  }
  const double wave = model_.wave_per_px() * std::exp(shape.log_translucency_px);
  const std::array<double, 2> waves = {wave, second_ * wave};
  std::array<double, 2> harmonics{};
  problem_.model->transform(reflectance_at(shape.logit_reflectance), waves, harmonics);
  return {harmonics[0] * envelope(1), harmonics[1] * envelope(second_)};
}

// ln l at which the first harmonic, which falls with l, has this height.
double PixelStart::log_with_first_harmonic(double logit, double target) const {
  double low = std::max(range_.least.log_translucency_px, kLeastLogStart);
  double high = std::max(range_.greatest.log_translucency_px, low);
  for (int halving = 0; halving < 7; ++halving) {
    const double middle = 0.5 * (low + high);
    (first_harmonics({logit, middle})[0] > target ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

// Its shape is left open.
SearchPoint PixelStart::with_phase(const Demodulated& data) const {
  const std::complex<double> turn = data.first * std::conj(model_.twice_factor(1));
  return {.shape = {},
          .mean = data.mean / model_.level(),
          .phase_px = std::arg(turn) / model_.wave_per_px()};
}

SearchPoint PixelStart::from_harmonics(const Demodulated& data) const {
  const std::complex<double> first = model_.twice_factor(1);
  const std::complex<double> second = model_.twice_factor(second_);
  const std::complex<double> turn = data.first * std::conj(first);
  const std::complex<double> back = std::polar(1.0, -second_ * std::arg(turn));
  const double height = std::abs(turn) / std::norm(first);
  SearchPoint point = with_phase(data);
  const auto at_share = [&](double share) {
    const double logit =
        std::clamp(logit_of(std::clamp(share * point.mean, 1e-6, 0.98)),
                   range_.least.logit_reflectance, range_.greatest.logit_reflectance);
    return ShapePoint{logit, log_with_first_harmonic(logit, height)};
  };
  point.shape = at_share(1);
  if (problem_.indirect == IndirectLight::kZero || std::norm(second) == 0 || data.second == 0.0)
    return point;
  const double second_height = (data.second * std::conj(second) * back).real() / std::norm(second);
  // Relative to a stripe's own, which may have the other sign.
  const double sign = std::copysign(1, envelope(second_));
  double low = std::log(kLeastShare), high = std::log(kGreatestShare);
  for (int halving = 0; halving < 5; ++halving) {
    const double middle = 0.5 * (low + high);
    point.shape = at_share(std::exp(middle));
    // Less R_d needs a smaller l_d for the same first harmonic, which raises the second, and too
    // little cannot have it at all.
    const std::array<double, 2> harmonics = first_harmonics(point.shape);
    const bool is_too_little =
        harmonics[0] < 0.99 * height || sign * harmonics[1] > sign * second_height;
    (is_too_little ? low : high) = middle;
  }
  point.shape = at_share(std::exp(0.5 * (low + high)));
  return point;
}

SearchPoint PixelStart::from_middle(const Demodulated& data) const {
  SearchPoint point = with_phase(data);
  point.shape = {logit_of(std::clamp(kShareOfSecondStart * point.mean, 1e-3, 0.9)),
                 std::log(kPeriodsOfSecondStart * problem_.shape.period_px)};
  return point;
}

}  // namespace estimation
