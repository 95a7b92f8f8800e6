// A transfer as sessions hold it: by band, by depth, or as maps over the field.
#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/core.hpp>

#include "estimation/calibration/transfer_fit.h"

namespace estimation {
namespace {

// No contrast is held to be known better than this: blocks with little noise do not outweigh all.
constexpr double kLeastSd = 0.002;

std::size_t index(int n) { return static_cast<std::size_t>(n); }

}  // namespace

TransferByBand transfer_by_band(const TransferFit& fit) {
  TransferByBand transfer;
  for (std::size_t band = 0; band < 3; ++band) {
    const TransferCurve& curve = fit.bands[band < index(fit.band_count) ? band : 0];
    for (const Measured& m : curve.contrast)
      transfer.harmonics[band].push_back(std::clamp(m.value, 0.0, 1.0));
  }
  return transfer;
}

namespace {

// From how many targets' blocks curves over distance are fitted, and at how many distances told.
constexpr std::size_t kLeastTargets = 3;
constexpr int kToldDistances = 9;
constexpr double kLeastContrast = 0.02;  // its logarithm is noise below

// The logarithm of a contrast over distance, by all blocks of all targets: a defocus that grows
// linearly from the focus makes it a quadratic.
class ContrastOverDistance {
 public:
  ContrastOverDistance(std::span<const TransferFit> fits, std::size_t band, std::size_t n,
                       double middle_mm, double reach_mm)
      : middle_mm_(middle_mm), reach_mm_(reach_mm) {
    cv::Mat1d design(0, 3), right(0, 1);
    for (const TransferFit& fit : fits)
      for (const TransferBlock& block : fit.blocks) {
        const Measured& m = block.bands[band].contrast[n];
        if (!(m.value > kLeastContrast)) continue;
        const double weight = m.value / std::hypot(m.sd, kLeastSd);
        const double z = (block.distance_mm - middle_mm) / reach_mm;
        design.push_back(cv::Mat1d(cv::Matx13d(weight, weight * z, weight * z * z)));
        right.push_back(weight * std::log(m.value));
      }
    coefficients_ = cv::Mat1d(3, 1, 0.0);
    is_dark_ = design.rows < 3;
    if (!is_dark_) cv::solve(design, right, coefficients_, cv::DECOMP_SVD);
  }
  double at(double distance_mm) const {
    if (is_dark_) return 0;
    const double z = (distance_mm - middle_mm_) / reach_mm_;
    const double logarithm = coefficients_(0) + z * (coefficients_(1) + z * coefficients_(2));
    return std::clamp(std::exp(logarithm), 0.0, 1.0);
  }

 private:
  double middle_mm_, reach_mm_;
  cv::Mat1d coefficients_;
  bool is_dark_ = false;  // no block has contrast
};

// A target is not all at one distance: each block counts at its own.
TransferByDepth by_block_distances(std::span<const TransferFit> fits) {
  double nearest_mm = fits[0].distance_mm, farthest_mm = nearest_mm;
  for (const TransferFit& fit : fits)
    for (const TransferBlock& block : fit.blocks) {
      nearest_mm = std::min(nearest_mm, block.distance_mm);
      farthest_mm = std::max(farthest_mm, block.distance_mm);
    }
  const double middle_mm = (nearest_mm + farthest_mm) / 2;
  const double reach_mm = std::max((farthest_mm - nearest_mm) / 2, 1e-6);
  TransferByDepth by_depth;
  for (int i = 0; i < kToldDistances; ++i) {
    const double share = static_cast<double>(i) / (kToldDistances - 1);
    by_depth.entries.push_back({std::lerp(nearest_mm, farthest_mm, share), {}});
  }
  const int band_count = fits[0].band_count;
  for (std::size_t band = 0; band < 3; ++band)
    for (std::size_t n = 0; n < kTransferHarmonics; ++n) {
      const ContrastOverDistance contrast(fits, band < index(band_count) ? band : 0, n, middle_mm,
                                          reach_mm);
      for (TransferByDepth::Entry& entry : by_depth.entries)
        entry.transfer.harmonics[band].push_back(contrast.at(entry.distance_mm));
    }
  return by_depth;
}

}  // namespace

TransferByDepth transfer_by_depth(std::span<const TransferFit> fits) {
  if (fits.size() >= kLeastTargets) return by_block_distances(fits);
  TransferByDepth by_depth;
  for (const TransferFit& fit : fits)
    by_depth.entries.push_back({fit.distance_mm, transfer_by_band(fit)});
  std::ranges::sort(by_depth.entries, {}, &TransferByDepth::Entry::distance_mm);
  return by_depth;
}

namespace {

// A quadric through the blocks' values, weighted; a plane or their mean if there are too few.
Image<float> smooth_map(const std::vector<TransferBlock>& blocks, std::size_t band, std::size_t n,
                        const CameraInfo& camera) {
  const int terms = blocks.size() >= 12 ? 6 : (blocks.size() >= 5 ? 3 : 1);
  const auto at = [&](double col_px, double row_px) {
    const double x = col_px / camera.width_px - 0.5, y = row_px / camera.height_px - 0.5;
    return std::array<double, 6>{1, x, y, x * x, x * y, y * y};
  };
  cv::Mat1d design(0, terms), right(0, 1);
  double left = camera.width_px, first_row = camera.height_px, last_col = 0, last_row = 0;
  for (const TransferBlock& block : blocks) {
    const Measured& m = block.bands[band].contrast[n];
    const double weight = 1 / std::hypot(m.sd, kLeastSd);
    const auto t = at(block.col_px, block.row_px);
    cv::Mat1d row(1, terms);
    for (int i = 0; i < terms; ++i) row(i) = weight * t[index(i)];
    design.push_back(row);
    right.push_back(weight * m.value);
    left = std::min(left, block.col_px);
    last_col = std::max(last_col, block.col_px);
    first_row = std::min(first_row, block.row_px);
    last_row = std::max(last_row, block.row_px);
  }
  cv::Mat1d coefficients;
  cv::solve(design, right, coefficients, cv::DECOMP_SVD);
  Image<float> map(camera.height_px, camera.width_px);
  for (int row = 0; row < map.height_px(); ++row)
    for (int col = 0; col < map.width_px(); ++col) {
      const auto t =
          at(std::clamp<double>(col, left, last_col), std::clamp<double>(row, first_row, last_row));
      double value = 0;
      for (int i = 0; i < terms; ++i) value += coefficients(i) * t[index(i)];
      map.at(row, col) = static_cast<float>(std::clamp(value, 0.0, 1.0));
    }
  return map;
}

}  // namespace

std::map<std::string, Image<float>> transfer_maps(const TransferFit& fit,
                                                  const CameraInfo& camera) {
  std::map<std::string, Image<float>> maps;
  for (int band = 0; band < fit.band_count; ++band)
    for (std::size_t n = 0; n < kTransferHarmonics; ++n) {
      std::string name(1, "RGB"[band]);
      name.append(".").append(std::to_string(n + 1));
      maps[name] = smooth_map(fit.blocks, index(band), n, camera);
    }
  return maps;
}

}  // namespace estimation
