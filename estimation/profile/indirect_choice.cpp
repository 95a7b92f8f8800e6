#include "estimation/profile/indirect_choice.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <optional>
#include <vector>

#include "estimation/session/maps.h"

namespace estimation {
namespace {

// A block decides for its sites from the 3 x 3 blocks around it.
constexpr int kBlockSites = 5;
constexpr std::size_t kFewestNeighbours = 30;
// Another material: B scales with what it reflects, and a wrong model's B depends on it.
constexpr double kLikeLogit = 0.3;
constexpr double kOutlierSd = 3;
constexpr double kWorstCaseSd = 2;
constexpr double kShareOfGain = 1.0 / 3;

constexpr std::size_t kIndirect = 2;  // its row of the covariance

class Blocks {
 public:
  Blocks(const CameraInfo& camera, const SiteFits& fits)
      : side_px_(kBlockSites * site_step_px(camera)),
        rows_((camera.height_px + side_px_ - 1) / side_px_),
        cols_((camera.width_px + side_px_ - 1) / side_px_),
        members_(static_cast<std::size_t>(rows_) * static_cast<std::size_t>(cols_)) {
    for (std::size_t i = 0; i < fits.sites.size(); ++i) {
      if ((fits.fit.validity[i] & kValidityErrors) != 0) continue;
      const auto row = static_cast<std::size_t>(fits.sites[i].row / side_px_);
      const auto col = static_cast<std::size_t>(fits.sites[i].col / side_px_);
      members_[row * static_cast<std::size_t>(cols_) + col].push_back(i);
    }
  }

  int rows() const { return rows_; }
  int cols() const { return cols_; }
  const std::vector<std::size_t>& members(int row, int col) const {
    return members_[static_cast<std::size_t>(row) * static_cast<std::size_t>(cols_) +
                    static_cast<std::size_t>(col)];
  }

 private:
  int side_px_, rows_, cols_;
  std::vector<std::vector<std::size_t>> members_;  // [block] sites with a fit
};

double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double covariance_of(const BatchFit& fit, std::size_t site, std::size_t row, std::size_t col) {
  return static_cast<double>(fit.covariance[covariance_index(row, col) * fit.stride + site]);
}

// B of a neighbourhood.
struct Level {
  double mean = 0, sd = 0;
};

// Of the sites whose R_d is like that of block (row, col); nullopt if there are too few.
std::optional<Level> level_around(const Blocks& blocks, const BatchFit& fit, int row, int col) {
  std::vector<double> values;
  for (const std::size_t i : blocks.members(row, col))
    values.push_back(static_cast<double>(fit.logit_reflectance[i]));
  const double typical_logit = median(values);
  std::vector<double> variances;
  values.clear();
  for (int r = std::max(row - 1, 0); r <= std::min(row + 1, blocks.rows() - 1); ++r)
    for (int c = std::max(col - 1, 0); c <= std::min(col + 1, blocks.cols() - 1); ++c)
      for (const std::size_t i : blocks.members(r, c)) {
        const double variance = covariance_of(fit, i, kIndirect, kIndirect);
        if (std::abs(static_cast<double>(fit.logit_reflectance[i]) - typical_logit) > kLikeLogit ||
            !(variance > 0))
          continue;
        values.push_back(static_cast<double>(fit.indirect[i]));
        variances.push_back(variance);
      }
  if (values.size() < kFewestNeighbours) return std::nullopt;
  std::vector<double> sorted = values;
  const double middle = median(sorted);
  // One variance for all: a site's own goes with its estimate of B, and as a weight it would draw
  // the mean away from zero.
  const double variance = median(variances);
  double sum = 0, squares = 0, count = 0;
  for (const double value : values) {
    const double from_middle = value - middle;
    if (from_middle * from_middle > kOutlierSd * kOutlierSd * variance) continue;
    sum += from_middle;
    squares += from_middle * from_middle;
    ++count;
  }
  if (count < static_cast<double>(kFewestNeighbours)) return std::nullopt;
  const double offset = sum / count;
  const double scatter = (squares - count * offset * offset) / (count - 1);
  return Level{.mean = middle + offset, .sd = std::sqrt(std::max(scatter, variance) / count)};
}

void fix_at_zero(BatchFit& fit, std::size_t site, double left_open_variance) {
  const double variance = covariance_of(fit, site, kIndirect, kIndirect);
  const double indirect = static_cast<double>(fit.indirect[site]);
  double slope[kUnknowns];  // of the unknown by B
  for (std::size_t k = 0; k < kUnknowns; ++k)
    slope[k] = covariance_of(fit, site, k, kIndirect) / variance;
  std::vector<float>* const unknowns[kUnknowns] = {&fit.logit_reflectance, &fit.log_translucency_px,
                                                   &fit.indirect, &fit.phase_px};
  for (std::size_t k = 0; k < kUnknowns; ++k) {
    float& value = (*unknowns[k])[site];
    value = k == kIndirect ? 0.0F
                           : static_cast<float>(static_cast<double>(value) - slope[k] * indirect);
    for (std::size_t l = 0; l <= k; ++l) {
      float& entry = fit.covariance[covariance_index(k, l) * fit.stride + site];
      const double conditional = k == kIndirect || l == kIndirect
                                     ? 0
                                     : static_cast<double>(entry) - slope[k] * slope[l] * variance;
      entry = static_cast<float>(conditional + slope[k] * slope[l] * left_open_variance);
    }
  }
  fit.validity[site] |= kIndirectFixedAtZero;
}

}  // namespace

void add_common_noise(const StripeScene& scene, const BandRadiometry& radiometry, SiteFits& fits) {
  if (!(radiometry.common_variance > 0)) return;
  const StripeShape& shape = scene.stripes.shape;
  const double lit_frac = static_cast<double>(shape.width_px) / shape.period_px;
  float* const variances =
      fits.fit.covariance.data() + covariance_index(kIndirect, kIndirect) * fits.fit.stride;
  for (std::size_t i = 0; i < fits.sites.size(); ++i) {
    if ((fits.fit.validity[i] & kValidityErrors) != 0 || !(variances[i] > 0)) continue;
    const auto [row, col] = fits.sites[i];
    const double full_per_us =
        radiometry.signal_per_us * static_cast<double>(scene.geometry.gain.at(row, col));
    const double scale = 1 / (lit_frac * full_per_us);
    variances[i] += static_cast<float>(radiometry.common_variance * scale * scale);
  }
}

std::size_t fix_indirect_where_earned(const CameraInfo& camera, SiteFits& fits) {
  const Blocks blocks(camera, fits);
  std::vector<std::optional<Level>> levels(static_cast<std::size_t>(blocks.rows()) *
                                           static_cast<std::size_t>(blocks.cols()));
  const auto level_at = [&](int row, int col) -> std::optional<Level>& {
    return levels[static_cast<std::size_t>(row) * static_cast<std::size_t>(blocks.cols()) +
                  static_cast<std::size_t>(col)];
  };
  const BatchFit& free = fits.fit;
  tbb::parallel_for(0, blocks.rows(), [&](int row) {
    for (int col = 0; col < blocks.cols(); ++col)
      if (!blocks.members(row, col).empty())
        level_at(row, col) = level_around(blocks, free, row, col);
  });
  std::atomic<std::size_t> fixed_count = 0;
  tbb::parallel_for(0, blocks.rows(), [&](int row) {
    for (int col = 0; col < blocks.cols(); ++col) {
      const std::optional<Level>& level = level_at(row, col);
      if (!level) continue;
      const double worst = std::abs(level->mean) + kWorstCaseSd * level->sd;
      // The unbiased estimate of B^2.
      const double left_open = std::max(level->mean * level->mean - level->sd * level->sd, 0.0);
      for (const std::size_t site : blocks.members(row, col)) {
        const double variance = covariance_of(fits.fit, site, kIndirect, kIndirect);
        if (!(worst * worst < kShareOfGain * kShareOfGain * variance)) continue;
        fix_at_zero(fits.fit, site, left_open);
        ++fixed_count;
      }
    }
  });
  return fixed_count;
}

}  // namespace estimation
