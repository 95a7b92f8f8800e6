#include "estimation/geometry/spread.h"

#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <numbers>
#include <opencv2/core.hpp>
#include <utility>
#include <variant>

#include "estimation/geometry/row_kernels.h"
#include "estimation/geometry/signal_rows.h"

namespace estimation {
namespace {

constexpr std::size_t kHarmonics = 3;
constexpr int kHighestHarmonic = 6;
// A stripe's harmonic weaker than this beside its first one says more of noise than of light.
constexpr double kLeastHarmonicFrac = 0.3;
// Quads of 2 x 2 pixels along a cell's side that are looked at: a cell needs no more.
constexpr int kQuadsPerCell = 2;
// The sums over a cell of the third harmonic must be this share of the first's: below, noise.
constexpr double kLeastThird = 0.005;

struct Sweep {
  int period_px = 0, width_px = 0;
  std::vector<int> shift_px;
  std::vector<PatternSignal> signals;
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
    sweep.signals.push_back(signal);
  }
  const auto most =
      std::max_element(sweeps.begin(), sweeps.end(), [](const auto& a, const auto& b) {
        return a.second.signals.size() < b.second.signals.size();
      });
  if (most == sweeps.end()) return std::nullopt;
  return std::move(most->second);
}

// The shifts in the set's order, in which every pattern is there once.
void keep_first_shifts(Sweep& sweep, const SignalSet& set) {
  sweep.shift_px.clear();
  for (const SignalSource& source : set.sources)
    sweep.shift_px.push_back(std::get<Stripes>(*source.kind).shift_px);
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
Amplitudes read_amplitudes(const std::array<double, kHarmonics>& cosine,
                           const std::array<double, kHarmonics>& sine,
                           const std::array<int, kHarmonics>& harmonics) {
  const double length = std::sqrt(cosine[0] * cosine[0] + sine[0] * sine[0]);
  if (!(length > 0) || !std::isfinite(length)) return {};
  // The first harmonic's direction, and its powers for the harmonics above.
  const double c1 = cosine[0] / length, s1 = sine[0] / length;
  double c = 1, s = 0;
  int n = 0;
  Amplitudes amplitudes;
  amplitudes.count = 1;
  for (std::size_t h = 0; h < kHarmonics; ++h) {
    for (; n < harmonics[h]; ++n) {
      const double turned = c * c1 - s * s1;
      s = s * c1 + c * s1;
      c = turned;
    }
    amplitudes.along[h] = cosine[h] * c + sine[h] * s;
    if (h == 1) amplitudes.second_across = sine[h] * c - cosine[h] * s;
  }
  return amplitudes;
}

// Shapes through three harmonics.
class ShapeTable {
 public:
  explicit ShapeTable(const std::array<int, kHarmonics>& harmonics) : harmonics_(harmonics) {
    for (std::size_t i = 0; i < ratios_.size(); ++i) ratios_[i] = ratio(tau_of(double(i)));
  }

  // tau from the ratio of the two steps, which falls with it, from an exponential's at 0 to a
  // Gaussian's.
  SpreadShape through(const std::array<double, kHarmonics>& log_transfer) const {
    const double first_step = log_transfer[0] - log_transfer[1];
    const double second_step = log_transfer[1] - log_transfer[2];
    if (!(first_step > 0) || !(second_step > 0)) return {};
    const double wanted = first_step / second_step;
    const auto after = std::lower_bound(ratios_.begin(), ratios_.end(), wanted, std::greater<>());
    double place = static_cast<double>(after - ratios_.begin());
    if (after == ratios_.end()) place -= 1;
    if (after != ratios_.begin() && after != ratios_.end())
      place -= (wanted - *after) / (*(after - 1) - *after);
    const double tau = tau_of(place);
    return {(first_step + second_step) / (root(tau, 2) - root(tau, 0)), tau};
  }

 private:
  static double tau_of(double place) {
    constexpr double kGreatestTau = 20;
    return kGreatestTau * place / (kSize - 1);
  }
  double root(double tau, std::size_t h) const {
    return std::sqrt(tau * tau + harmonics_[h] * harmonics_[h]);
  }
  double ratio(double tau) const {
    return (root(tau, 1) - root(tau, 0)) / (root(tau, 2) - root(tau, 1));
  }

  static constexpr std::size_t kSize = 1001;
  std::array<int, kHarmonics> harmonics_;
  std::array<double, kSize> ratios_{};
};

using BandSums = std::array<std::vector<Amplitudes>, 3>;  // [band][cell]

// Adds up the pixels of one row of cells. Not thread-safe.
class CellRowReader {
 public:
  CellRowReader(const SignalSet& set, const Weights& weights, const CameraInfo& camera,
                ImageView<const float> position_px)
      : weights_(weights), camera_(camera), position_px_(position_px), rows_(set) {
    saturation_dn_ = set.saturation_dn;
    signal_count_ = set.sources.size();
    for (auto& sum : sums_) sum.resize(static_cast<std::size_t>(camera.width_px));
  }

  void read(const SpreadCells& cells, int cell_row, BandSums& sums) {
    const int side_px = cells.side_px;
    const int step_px = 2 * std::max(1, side_px / (2 * kQuadsPerCell));
    const int end = std::min((cell_row + 1) * side_px, camera_.height_px);
    for (int row = cell_row * side_px; row < end; ++row) {
      if ((row - cell_row * side_px) % step_px > 1) continue;
      const auto position_px = position_px_.row(row);
      const auto is_decoded = [](float position) { return !std::isnan(position); };
      const auto first = std::find_if(position_px.begin(), position_px.end(), is_decoded);
      if (first == position_px.end()) continue;
      const auto last = std::find_if(position_px.rbegin(), position_px.rend(), is_decoded);
      const auto begin = static_cast<std::size_t>(first - position_px.begin());
      const auto end_col = static_cast<std::size_t>(position_px.rend() - last);
      sum_row(row, begin, end_col);
      for (std::size_t i = begin; i < end_col; ++i) {
        const int col = static_cast<int>(i);
        if (col % side_px % step_px > 1 || !is_decoded(position_px[i])) continue;
        std::array<double, kHarmonics> cosine{}, sine{};
        for (std::size_t h = 0; h < kHarmonics; ++h) {
          cosine[h] = double{sums_[h][i]};
          sine[h] = double{sums_[h + kHarmonics][i]};
        }
        sums[static_cast<std::size_t>(spread_band(camera_, row, col))][cells.index(row, col)].add(
            read_amplitudes(cosine, sine, weights_.harmonics));
      }
    }
  }

 private:
  // The harmonics' sums over columns [begin, end).
  void sum_row(int row, std::size_t begin, std::size_t end) {
    rows_.open(row);
    samples_.clear();
    for (std::size_t i = 0; i < signal_count_; ++i) samples_.push_back(rows_.at(i));
    WeightedSums sums;
    for (std::size_t h = 0; h < kHarmonics; ++h) {
      sums.weights[h] = weights_.cosine[h];
      sums.weights[h + kHarmonics] = weights_.sine[h];
    }
    for (std::size_t i = 0; i < sums_.size(); ++i) sums.out[i] = sums_[i].data();
    sum_shifts(samples_, saturation_dn_, begin, end, sums);
  }

  static_assert(kWeightSets == 2 * kHarmonics);
  const Weights& weights_;
  const CameraInfo& camera_;
  ImageView<const float> position_px_;
  SignalRows rows_;
  float saturation_dn_ = 0;
  std::size_t signal_count_ = 0;
  std::vector<SampleRow> samples_;
  std::array<std::vector<float>, kWeightSets> sums_;  // cosines, then sines
};

std::optional<CellSpread> spread_from(const Amplitudes& sums, const Sweep& sweep,
                                      const Weights& weights, const ShapeTable& shapes) {
  if (sums.count == 0 || !(sums.along.back() > kLeastThird * sums.along.front()) ||
      !(sums.along[1] > 0))
    return std::nullopt;
  std::array<double, kHarmonics> log_transfer{};
  for (std::size_t h = 0; h < kHarmonics; ++h)
    log_transfer[h] = std::log(
        sums.along[h] / stripe_harmonic(sweep.period_px, sweep.width_px, weights.harmonics[h]));
  const double px_per_rad = sweep.period_px / (2 * std::numbers::pi * weights.harmonics[1]);
  return CellSpread{shapes.through(log_transfer),
                    std::atan2(sums.second_across, sums.along[1]) * px_per_rad};
}

}  // namespace

double SpreadShape::log_transfer(double t) const { return -slope * std::sqrt(tau * tau + t * t); }

double SpreadShape::first(double t) const {
  return slope > 0 ? -slope * t / std::sqrt(tau * tau + t * t) : 0;
}

double SpreadShape::second(double t) const {
  if (!(slope > 0)) return 0;
  const double root = std::sqrt(tau * tau + t * t);
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

std::optional<SpreadCells> spread_of(std::span<const PatternSignal> signals,
                                     const FrameLevels& levels, Axis axis, const CameraInfo& camera,
                                     ImageView<const float> position_px, int cell_side_px) {
  auto sweep = widest_sweep(signals, axis);
  if (!sweep) return std::nullopt;
  const SignalSet set = collect_signals(sweep->signals, levels);
  keep_first_shifts(*sweep, set);
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
  tbb::enumerable_thread_specific<CellRowReader> readers(
      [&] { return CellRowReader(set, *weights, camera, position_px); });
  tbb::parallel_for(0, cells.rows, [&](int row) { readers.local().read(cells, row, sums); });
  const ShapeTable shapes(weights->harmonics);
  tbb::parallel_for(0, cells.rows, [&](int row) {
    for (std::size_t band = 0; band < sums.size(); ++band)
      for (int col = 0; col < cells.cols; ++col) {
        Amplitudes around;
        for (int r = std::max(row - 1, 0); r <= std::min(row + 1, cells.rows - 1); ++r)
          for (int c = std::max(col - 1, 0); c <= std::min(col + 1, cells.cols - 1); ++c)
            around.add(sums[band][static_cast<std::size_t>(r * cells.cols + c)]);
        cells.bands[band][static_cast<std::size_t>(row * cells.cols + col)] =
            spread_from(around, *sweep, *weights, shapes);
      }
  });
  return cells;
}

}  // namespace estimation
