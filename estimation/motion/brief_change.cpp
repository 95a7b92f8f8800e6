#include "estimation/motion/brief_change.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <opencv2/core.hpp>
#include <optional>
#include <tuple>
#include <utility>

#include "estimation/motion/picture.h"

namespace estimation {
namespace {

constexpr int kBlocksAcross = 48, kSmallestBlock = 4;
constexpr double kMostClippedFrac = 0.01;
// What a block's light is a function of the shift in: mean, and harmonics that a period's length
// and the skin's own picture leave over.
constexpr int kHarmonics = 3;
constexpr int kTerms = 2 * kHarmonics + 1;
constexpr int kFewestShifts = 16, kFewestPairs = 6;
// A relative that is known no better than this: the sensor is not that linear, and people breathe.
constexpr double kFloorFrac = 0.003;
constexpr double kSure = 8, kLeastFrac = 0.05;
// Of a block's mean light, root sum of squares of the harmonics: more, and it lies across a border
// and goes from light to dark as the stripes cross it, with edges that few harmonics do not follow.
constexpr double kMostModulation = 0.5;
constexpr double kFewestValidFrac = 0.8;  // of a block's frames
constexpr double kLitFrac = 0.1;          // of the brightest blocks
constexpr double kEverywhereFrac = 0.5;   // of the lit blocks
constexpr std::size_t kFewestBlocks = 2;  // side by side

using Terms = cv::Vec<double, kTerms>;
using NormalMatrix = cv::Matx<double, kTerms, kTerms>;

double light_at(const SeenFrame& frame, std::size_t block) {
  return static_cast<double>(frame.light_dn[block]);
}

// What a block's light should have been in each of some frames that are relatives.
struct Relatives {
  double level_dn = 0;               // the block's mean light
  std::vector<double> surplus_dn{};  // [frame] seen less expected; NaN: not seen
};

Terms harmonics_of(const Stripes& stripes) {
  Terms terms;
  terms[0] = 1;
  const double phase_rad =
      2 * std::numbers::pi * stripes.shift_px / static_cast<double>(stripes.period_px);
  for (int k = 1; k <= kHarmonics; ++k) {
    terms[2 * k - 1] = std::cos(k * phase_rad);
    terms[2 * k] = std::sin(k * phase_rad);
  }
  return terms;
}

// Least squares with what does not fit given less and less weight.
std::optional<Relatives> fit_shifts(const std::vector<Terms>& design,
                                    const std::vector<double>& light_dn) {
  const std::size_t count = design.size();
  std::vector<double> weights(count), surplus(count);
  std::size_t valid_count = 0;
  for (std::size_t i = 0; i < count; ++i) {
    weights[i] = std::isnan(light_dn[i]) ? 0 : 1;
    valid_count += weights[i] > 0 ? 1U : 0U;
  }
  if (static_cast<double>(valid_count) < kFewestValidFrac * static_cast<double>(count))
    return std::nullopt;
  Terms found;
  constexpr int kRounds = 6;
  for (int round = 0; round < kRounds; ++round) {
    NormalMatrix matrix;
    Terms vector;
    for (std::size_t i = 0; i < count; ++i) {
      if (weights[i] <= 0) continue;
      vector += weights[i] * light_dn[i] * design[i];
      matrix += weights[i] * design[i] * design[i].t();
    }
    if (!cv::solve(matrix, vector, found, cv::DECOMP_CHOLESKY)) return std::nullopt;
    std::vector<double> sizes;
    for (std::size_t i = 0; i < count; ++i) {
      surplus[i] = light_dn[i] - found.dot(design[i]);
      if (!std::isnan(surplus[i])) sizes.push_back(std::abs(surplus[i]));
    }
    // Tukey's biweight, from an ordinary fit on.
    const double reach = 4.685 * 1.4826 * std::max(median_of(std::move(sizes)), 1e-6);
    for (std::size_t i = 0; i < count; ++i) {
      const double part = std::isnan(surplus[i]) ? 1 : std::min(1.0, std::abs(surplus[i]) / reach);
      weights[i] = std::isnan(surplus[i]) ? 0 : (1 - part * part) * (1 - part * part);
    }
  }
  double squares = 0;
  for (int a = 1; a < kTerms; ++a) squares += found[a] * found[a];
  if (!(std::sqrt(squares) < kMostModulation * found[0])) return std::nullopt;
  return Relatives{found[0], std::move(surplus)};
}

// Of sums that should all be alike; NaN where one is not known.
std::optional<Relatives> fit_sums(const std::vector<double>& sums_dn) {
  std::vector<double> valid;
  for (const double sum : sums_dn)
    if (!std::isnan(sum)) valid.push_back(sum);
  if (static_cast<double>(valid.size()) < kFewestValidFrac * static_cast<double>(sums_dn.size()))
    return std::nullopt;
  Relatives relatives{median_of(std::move(valid)), sums_dn};
  for (double& surplus : relatives.surplus_dn) surplus -= relatives.level_dn;
  return relatives;
}

// Frames of one bracket that have to fit together: `frames[i]` are those whose light adds up to
// the i-th value.
struct Series {
  std::vector<std::vector<std::size_t>> frames;
  std::vector<Terms> design;  // of stripes, by shift; empty: all values should be alike
};

std::vector<Series> find_series(const std::vector<Pattern>& patterns,
                                const std::vector<SeenFrame>& frames) {
  std::map<int, const Pattern*> by_index;
  for (const Pattern& pattern : patterns) by_index[pattern.index] = &pattern;
  std::map<std::tuple<int, Axis, int, int>, Series> stripes;  // bracket, axis, period, width
  std::map<int, std::map<std::tuple<Axis, int>, std::vector<std::size_t>>> pairs;  // by bracket
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const auto found = by_index.find(frames[i].pattern);
    if (found == by_index.end()) continue;
    if (const auto* each = std::get_if<Stripes>(&found->second->kind)) {
      Series& series = stripes[{frames[i].bracket, each->axis, each->period_px, each->width_px}];
      series.frames.push_back({i});
      series.design.push_back(harmonics_of(*each));
    } else if (const auto* gray = std::get_if<GrayCode>(&found->second->kind)) {
      pairs[frames[i].bracket][{gray->axis, gray->bit}].push_back(i);
    }
  }
  std::vector<Series> all;
  for (auto& [key, series] : stripes)
    if (series.frames.size() >= kFewestShifts) all.push_back(std::move(series));
  for (const auto& [bracket, own] : pairs) {
    std::map<int, Series> by_square_light;  // in neither, one or both: sums differ by it
    for (const auto& [key, pair] : own)
      if (pair.size() == 2)
        by_square_light[static_cast<int>(frames[pair[0]].is_square_light) +
                        static_cast<int>(frames[pair[1]].is_square_light)]
            .frames.push_back(pair);
    for (auto& [count, series] : by_square_light)
      if (series.frames.size() >= kFewestPairs) all.push_back(std::move(series));
  }
  return all;
}

// Noise of a block's mean light, DN.
double noise_dn(const CameraInfo& camera, const BlockGrid& grid, double light_dn) {
  const double gain_e_per_dn = camera.gain_e_per_dn.value_or(1);
  const double read_dn = camera.read_noise_e.value_or(0) / gain_e_per_dn;
  return std::sqrt((read_dn * read_dn + std::max(light_dn, 0.0) / gain_e_per_dn) /
                   (grid.height_px * grid.width_px));
}

// [frame][block] the share of its light by which it is off, where that is beyond doubt; else 0.
using Changes = std::vector<std::vector<float>>;

void judge_series(const CameraInfo& camera, const BlockGrid& grid, const Series& series,
                  const std::vector<SeenFrame>& frames, Changes& changes, std::size_t& lit_count) {
  std::vector<std::optional<Relatives>> fits(grid.count());
  std::vector<double> levels_dn;
  std::vector<double> values(series.frames.size());
  for (std::size_t block = 0; block < grid.count(); ++block) {
    for (std::size_t i = 0; i < values.size(); ++i) {
      values[i] = 0;
      for (const std::size_t frame : series.frames[i]) values[i] += light_at(frames[frame], block);
    }
    fits[block] = series.design.empty() ? fit_sums(values) : fit_shifts(series.design, values);
    if (fits[block]) levels_dn.push_back(fits[block]->level_dn);
  }
  if (levels_dn.empty()) return;
  std::sort(levels_dn.begin(), levels_dn.end());
  const double lit_dn = kLitFrac * levels_dn[(levels_dn.size() - 1) * 95 / 100];
  std::size_t own_lit_count = 0;
  for (std::size_t block = 0; block < grid.count(); ++block) {
    if (!fits[block] || !(fits[block]->level_dn > lit_dn) || !(lit_dn > 0)) continue;
    ++own_lit_count;
    const Relatives& fit = *fits[block];
    std::vector<double> sizes;
    for (const double surplus : fit.surplus_dn)
      if (!std::isnan(surplus)) sizes.push_back(std::abs(surplus));
    const double sd_dn =
        std::max({1.4826 * median_of(std::move(sizes)), noise_dn(camera, grid, fit.level_dn),
                  kFloorFrac * fit.level_dn});
    const double limit_dn = std::max(kSure * sd_dn, kLeastFrac * fit.level_dn);
    for (std::size_t i = 0; i < fit.surplus_dn.size(); ++i)
      if (std::abs(fit.surplus_dn[i]) > limit_dn)
        for (const std::size_t frame : series.frames[i])
          changes[frame][block] = static_cast<float>(fit.surplus_dn[i] / fit.level_dn);
  }
  lit_count = std::max(lit_count, own_lit_count);
}

struct Place {
  std::size_t block_count = 0;
  double row = 0, col = 0;  // sums over its blocks
  float change_frac = 0;
};

// The blocks beside each other that changed the same way, the largest such place; all counted.
Place largest_place(const BlockGrid& grid, std::vector<float> changes, std::size_t& block_count) {
  Place largest;
  block_count = 0;
  for (std::size_t seed = 0; seed < changes.size(); ++seed) {
    if (changes[seed] == 0) continue;
    const bool is_more = changes[seed] > 0;
    Place place;
    std::vector<std::size_t> open{seed};
    const auto visit = [&](std::size_t block) {
      const float change = changes[block];
      if (change == 0 || (change > 0) != is_more) return;
      open.push_back(block);
    };
    while (!open.empty()) {
      const std::size_t block = open.back();
      open.pop_back();
      const float change = std::exchange(changes[block], 0.0F);
      if (change == 0) continue;
      const auto cols = static_cast<std::size_t>(grid.cols);
      const std::size_t row = block / cols, col = block % cols;
      ++place.block_count;
      place.row += static_cast<double>(row);
      place.col += static_cast<double>(col);
      if (std::abs(change) > std::abs(place.change_frac)) place.change_frac = change;
      if (row > 0) visit(block - cols);
      if (row + 1 < static_cast<std::size_t>(grid.rows)) visit(block + cols);
      if (col > 0) visit(block - 1);
      if (col + 1 < cols) visit(block + 1);
    }
    if (place.block_count < kFewestBlocks) continue;
    block_count += place.block_count;
    if (place.block_count > largest.block_count) largest = place;
  }
  return largest;
}

// One pattern's worth of change: the worst of its brackets.
struct PatternChange {
  Place place;
  bool is_everywhere = false;
};

std::vector<BriefChange> joined(const BlockGrid& grid, const std::vector<SeenFrame>& frames,
                                const std::map<int, PatternChange>& by_pattern) {
  std::map<int, double> shown_s;  // by pattern: its first frame
  for (const SeenFrame& frame : frames) {
    const auto at = shown_s.emplace(frame.pattern, frame.elapsed_s).first;
    at->second = std::min(at->second, frame.elapsed_s);
  }
  std::vector<std::pair<double, int>> order;
  order.reserve(shown_s.size());
  for (const auto& [pattern, elapsed_s] : shown_s) order.emplace_back(elapsed_s, pattern);
  std::sort(order.begin(), order.end());
  std::vector<BriefChange> all;
  std::size_t last = 0, most = 0;  // place in the order of the latest; blocks of the largest
  for (std::size_t i = 0; i < order.size(); ++i) {
    const auto found = by_pattern.find(order[i].second);
    if (found == by_pattern.end()) continue;
    if (all.empty() || i > last + 2) {  // one between may hide it: black is black
      all.push_back({.patterns = {}, .elapsed_s = order[i].first});
      most = 0;
    }
    last = i;
    BriefChange& change = all.back();
    change.patterns.push_back(order[i].second);
    change.is_everywhere = change.is_everywhere || found->second.is_everywhere;
    const Place& place = found->second.place;
    if (place.block_count <= most) continue;
    most = place.block_count;
    const auto count = static_cast<double>(place.block_count);
    change.change_frac = static_cast<double>(place.change_frac);
    change.row_px = (place.row / count + 0.5) * grid.height_px - 0.5;
    change.col_px = (place.col / count + 0.5) * grid.width_px - 0.5;
  }
  return all;
}

}  // namespace

BlockGrid block_grid(const CameraInfo& camera, Axis axis, double period_px) {
  const auto even = [&camera](double side_px) {
    return 2 * static_cast<int>(std::lround(std::min<double>(side_px, camera.width_px) / 2));
  };
  const int side_px =
      std::max(kSmallestBlock, even(static_cast<double>(camera.width_px) / kBlocksAcross));
  const int along_px = std::clamp(even(period_px), side_px, 3 * side_px);
  BlockGrid grid;
  grid.height_px = axis == Axis::kColumn ? side_px : along_px;
  grid.width_px = axis == Axis::kColumn ? along_px : side_px;
  grid.rows = camera.height_px / grid.height_px;
  grid.cols = camera.width_px / grid.width_px;
  return grid;
}

std::vector<float> block_light(const CameraInfo& camera, const BlockGrid& grid,
                               ImageView<const std::uint16_t> frame_dn) {
  const auto samples_across =
      static_cast<std::size_t>(grid.width_px) * static_cast<std::size_t>(frame_dn.channel_count);
  const auto cols = static_cast<std::size_t>(grid.cols);
  const auto limit = static_cast<std::uint32_t>(std::clamp(clip_level_dn(camera), 0.0, 65535.0));
  const double sample_count = static_cast<double>(samples_across) * grid.height_px;
  std::vector<float> light(grid.count());
  for (int block_row = 0; block_row < grid.rows; ++block_row) {
    std::vector<std::uint64_t> sums(cols);
    std::vector<std::uint32_t> clipped(cols);
    for (int row = block_row * grid.height_px; row < (block_row + 1) * grid.height_px; ++row) {
      const auto samples = frame_dn.row(row);
      for (std::size_t col = 0; col < cols; ++col) {
        std::uint32_t sum = 0, high = 0;
        for (const std::uint16_t sample : samples.subspan(col * samples_across, samples_across)) {
          sum += sample;
          high += sample >= limit ? 1U : 0U;
        }
        sums[col] += sum;
        clipped[col] += high;
      }
    }
    for (std::size_t col = 0; col < cols; ++col)
      light[static_cast<std::size_t>(block_row) * cols + col] =
          static_cast<double>(clipped[col]) > kMostClippedFrac * sample_count
              ? std::numeric_limits<float>::quiet_NaN()
              : static_cast<float>(static_cast<double>(sums[col]) / sample_count -
                                   camera.black_level_dn.value_or(0));
  }
  return light;
}

std::vector<BriefChange> find_brief_changes(const CameraInfo& camera, const BlockGrid& grid,
                                            const std::vector<Pattern>& patterns,
                                            const std::vector<SeenFrame>& frames) {
  Changes changes(frames.size(), std::vector<float>(grid.count()));
  std::size_t lit_count = 0;
  for (const Series& series : find_series(patterns, frames))
    judge_series(camera, grid, series, frames, changes, lit_count);
  std::map<int, PatternChange> by_pattern;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    std::size_t block_count = 0;
    const Place place = largest_place(grid, std::move(changes[i]), block_count);
    if (place.block_count == 0) continue;
    PatternChange& pattern = by_pattern[frames[i].pattern];
    pattern.is_everywhere =
        pattern.is_everywhere ||
        static_cast<double>(block_count) > kEverywhereFrac * static_cast<double>(lit_count);
    if (place.block_count > pattern.place.block_count) pattern.place = place;
  }
  return joined(grid, frames, by_pattern);
}

}  // namespace estimation
