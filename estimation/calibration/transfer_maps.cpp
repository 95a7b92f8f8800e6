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

TransferByDepth transfer_by_depth(std::span<const TransferFit> fits) {
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
