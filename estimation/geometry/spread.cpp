#include "estimation/geometry/spread.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <opencv2/core.hpp>
#include <utility>
#include <variant>

namespace estimation {
namespace {

constexpr std::size_t kHarmonics = 3;
constexpr int kHighestHarmonic = 6;
// A stripe's harmonic weaker than this beside its first one says more of noise than of light.
constexpr double kLeastHarmonicFrac = 0.3;
// Quads of 2 x 2 pixels along a cell's side that are looked at: a cell needs no more.
constexpr int kQuadsPerCell = 3;
// The sums over a cell of the third harmonic must be this share of the first's: below, noise.
constexpr double kLeastThird = 0.005;

struct Sweep {
  int period_px = 0, width_px = 0;
  std::vector<int> shift_px;
  std::vector<ImageView<const float>> signals;
};

// The stripes of one shape with the most shifts.
std::optional<Sweep> widest_sweep(std::span<const PatternSignal> signals, Axis axis) {
  std::map<std::pair<int, int>, Sweep> sweeps;
  for (const PatternSignal& signal : signals) {
    const auto* stripes = std::get_if<Stripes>(signal.kind);
    if (stripes == nullptr || stripes->axis != axis) continue;
    Sweep& sweep = sweeps[{stripes->period_px, stripes->width_px}];
    sweep.period_px = stripes->period_px;
    sweep.width_px = stripes->width_px;
    sweep.shift_px.push_back(stripes->shift_px);
    sweep.signals.push_back(signal.signal);
  }
  const auto most =
      std::max_element(sweeps.begin(), sweeps.end(), [](const auto& a, const auto& b) {
        return a.second.signals.size() < b.second.signals.size();
      });
  if (most == sweeps.end()) return std::nullopt;
  return std::move(most->second);
}

// Linear weights of the samples for the cosine and sine of each harmonic used.
struct Weights {
  std::array<int, kHarmonics> harmonics{};
  std::array<std::vector<float>, kHarmonics> cosine, sine;
};

std::optional<Weights> make_weights(const Sweep& sweep) {
  Weights weights;
  std::size_t found = 0;
  for (int n = 1; n <= kHighestHarmonic && found < kHarmonics; ++n)
    if (stripe_harmonic(sweep.period_px, sweep.width_px, n) >
        kLeastHarmonicFrac * stripe_harmonic(sweep.period_px, sweep.width_px, 1))
      weights.harmonics[found++] = n;
  const int shift_count = static_cast<int>(sweep.shift_px.size());
  const int fitted = weights.harmonics.back() + 1;  // one more, so that it does not leak in
  if (found < kHarmonics || 2 * fitted + 1 > shift_count) return std::nullopt;
  cv::Mat1d design(shift_count, 1 + 2 * fitted);
  for (int i = 0; i < shift_count; ++i) {
    design(i, 0) = 1;
    for (int n = 1; n <= fitted; ++n) {
      // The same centre as the coordinate's: lit columns 0 .. width - 1 at shift 0.
      const double angle_rad =
          2 * std::numbers::pi * n *
          (sweep.shift_px[static_cast<std::size_t>(i)] + (sweep.width_px - 1) / 2.0) /
          sweep.period_px;
      design(i, 2 * n - 1) = std::cos(angle_rad);
      design(i, 2 * n) = std::sin(angle_rad);
    }
  }
  cv::Mat1d inverse;
  constexpr double kMinCondition = 0.1;
  if (cv::invert(design, inverse, cv::DECOMP_SVD) < kMinCondition) return std::nullopt;
  for (std::size_t h = 0; h < kHarmonics; ++h)
    for (int i = 0; i < shift_count; ++i) {
      weights.cosine[h].push_back(static_cast<float>(inverse(2 * weights.harmonics[h] - 1, i)));
      weights.sine[h].push_back(static_cast<float>(inverse(2 * weights.harmonics[h], i)));
    }
  return weights;
}

// Sums over pixels. Of the harmonics along the first one's phase, which a symmetric spread leaves
// them at: signed, so that noise averages out; and the second's across it.
struct Amplitudes {
  std::array<double, kHarmonics> along{};
  double second_across = 0;
  int count = 0;

  void add(const Amplitudes& more) {
    for (std::size_t h = 0; h < kHarmonics; ++h) along[h] += more.along[h];
    second_across += more.second_across;
    count += more.count;
  }
};

// Of one pixel; nothing where a sample is lost.
Amplitudes read_amplitudes(const Sweep& sweep, const Weights& weights, int row, int col) {
  std::array<float, kHarmonics> cosine{}, sine{};
  for (std::size_t i = 0; i < sweep.signals.size(); ++i) {
    const float sample = sweep.signals[i].at(row, col);
    for (std::size_t h = 0; h < kHarmonics; ++h) {
      cosine[h] += weights.cosine[h][i] * sample;
      sine[h] += weights.sine[h][i] * sample;
    }
  }
  if (!std::isfinite(cosine[0])) return {};
  Amplitudes amplitudes;
  amplitudes.count = 1;
  const double length =
      std::sqrt(double{cosine[0]} * double{cosine[0]} + double{sine[0]} * double{sine[0]});
  if (!(length > 0)) return {};
  // The first harmonic's direction, and its powers for the harmonics above.
  const double c1 = double{cosine[0]} / length, s1 = double{sine[0]} / length;
  double c = 1, s = 0;
  int n = 0;
  for (std::size_t h = 0; h < kHarmonics; ++h) {
    for (; n < weights.harmonics[h]; ++n) {
      const double turned = c * c1 - s * s1;
      s = s * c1 + c * s1;
      c = turned;
    }
    amplitudes.along[h] = double{cosine[h]} * c + double{sine[h]} * s;
    if (h == 1) amplitudes.second_across = double{sine[h]} * c - double{cosine[h]} * s;
  }
  return amplitudes;
}

// Through three harmonics; tau from the ratio of the two steps.
SpreadShape shape_through(const std::array<int, kHarmonics>& harmonics,
                          const std::array<double, kHarmonics>& log_transfer) {
  const double first_step = log_transfer[0] - log_transfer[1];
  const double second_step = log_transfer[1] - log_transfer[2];
  if (!(first_step > 0) || !(second_step > 0)) return {};
  const auto root = [&](double tau, std::size_t h) { return std::hypot(tau, harmonics[h]); };
  const auto ratio = [&](double tau) {
    return (root(tau, 1) - root(tau, 0)) / (root(tau, 2) - root(tau, 1));
  };
  // The ratio falls with tau, from an exponential's at 0 to a Gaussian's.
  constexpr double kGreatestTau = 20;
  double low = 0, high = kGreatestTau;
  const double wanted = first_step / second_step;
  for (int i = 0; i < 40; ++i) {
    const double middle = (low + high) / 2;
    (ratio(middle) > wanted ? low : high) = middle;
  }
  const double tau = (low + high) / 2;
  return {(first_step + second_step) / (root(tau, 2) - root(tau, 0)), tau};
}

using BandSums = std::array<std::vector<Amplitudes>, 3>;  // [band][cell]

void sum_cell_row(const Sweep& sweep, const Weights& weights, const CameraInfo& camera,
                  const SpreadCells& cells, int cell_row, BandSums& sums) {
  const int side_px = cells.side_px;
  const int step_px = 2 * std::max(1, side_px / (2 * kQuadsPerCell));
  const int end = std::min((cell_row + 1) * side_px, camera.height_px);
  for (int row = cell_row * side_px; row < end; ++row) {
    if ((row - cell_row * side_px) % step_px > 1) continue;
    for (int col = 0; col < camera.width_px; ++col) {
      if (col % side_px % step_px > 1) continue;
      const auto cell = static_cast<std::size_t>(cell_row * cells.cols + col / side_px);
      sums[static_cast<std::size_t>(spread_band(camera, row, col))][cell].add(
          read_amplitudes(sweep, weights, row, col));
    }
  }
}

std::optional<CellSpread> spread_from(const Amplitudes& sums, const Sweep& sweep,
                                      const Weights& weights) {
  if (sums.count == 0 || !(sums.along.back() > kLeastThird * sums.along.front()) ||
      !(sums.along[1] > 0))
    return std::nullopt;
  std::array<double, kHarmonics> log_transfer{};
  for (std::size_t h = 0; h < kHarmonics; ++h)
    log_transfer[h] = std::log(
        sums.along[h] / stripe_harmonic(sweep.period_px, sweep.width_px, weights.harmonics[h]));
  const double px_per_rad = sweep.period_px / (2 * std::numbers::pi * weights.harmonics[1]);
  return CellSpread{shape_through(weights.harmonics, log_transfer),
                    std::atan2(sums.second_across, sums.along[1]) * px_per_rad};
}

}  // namespace

double SpreadShape::log_transfer(double t) const { return -slope * std::hypot(tau, t); }

double SpreadShape::first(double t) const {
  return slope > 0 ? -slope * t / std::hypot(tau, t) : 0;
}

double SpreadShape::second(double t) const {
  if (!(slope > 0)) return 0;
  const double root = std::hypot(tau, t);
  return first(t) * first(t) - slope * tau * tau / (root * root * root);
}

double stripe_harmonic(int period_px, int width_px, int harmonic) {
  const double angle_rad = std::numbers::pi * harmonic * width_px / period_px;
  return std::abs(std::sin(angle_rad) / angle_rad);
}

int spread_band(const CameraInfo& camera, int row, int col) {
  const ColorFilter filter = camera.pixel_format.filter;
  if (filter == ColorFilter::kMono || filter == ColorFilter::kRgb) return 0;
  return band_at(camera, row, col);
}

std::optional<SpreadCells> spread_of(std::span<const PatternSignal> signals, Axis axis,
                                     const CameraInfo& camera, int cell_side_px) {
  const auto sweep = widest_sweep(signals, axis);
  if (!sweep) return std::nullopt;
  const auto weights = make_weights(*sweep);
  if (!weights) return std::nullopt;
  SpreadCells cells;
  cells.period_px = sweep->period_px;
  cells.width_px = sweep->width_px;
  cells.second_harmonic = weights->harmonics[1];
  cells.side_px = cell_side_px;
  cells.rows = (camera.height_px + cell_side_px - 1) / cell_side_px;
  cells.cols = (camera.width_px + cell_side_px - 1) / cell_side_px;
  const auto count = static_cast<std::size_t>(cells.rows) * static_cast<std::size_t>(cells.cols);
  BandSums sums;
  for (auto& band : sums) band.resize(count);
  for (auto& band : cells.bands) band.resize(count);
  tbb::parallel_for(0, cells.rows,
                    [&](int row) { sum_cell_row(*sweep, *weights, camera, cells, row, sums); });
  tbb::parallel_for(0, cells.rows, [&](int row) {
    for (std::size_t band = 0; band < sums.size(); ++band)
      for (int col = 0; col < cells.cols; ++col) {
        Amplitudes around;
        for (int r = std::max(row - 1, 0); r <= std::min(row + 1, cells.rows - 1); ++r)
          for (int c = std::max(col - 1, 0); c <= std::min(col + 1, cells.cols - 1); ++c)
            around.add(sums[band][static_cast<std::size_t>(r * cells.cols + c)]);
        cells.bands[band][static_cast<std::size_t>(row * cells.cols + col)] =
            spread_from(around, *sweep, *weights);
      }
  });
  return cells;
}

}  // namespace estimation
