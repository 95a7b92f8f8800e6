// The contrasts that a block of pixels shows under a sweep of stripes.
#pragma once

#include <array>
#include <complex>
#include <cstddef>
#include <opencv2/core.hpp>
#include <vector>

#include "estimation/calibration/measured.h"
#include "estimation/calibration/transfer_fit.h"

namespace estimation {

inline constexpr int kTransferPeriodPx = 40;

using Contrasts = std::array<Measured, kTransferHarmonics>;  // [n - 1]; sd 0: not in the stripes

struct TransferPixel {
  int row = 0, col = 0, channel = 0;
};

// Of one band in one block: the harmonics of all pixels, turned to the phase that their position
// asks for, over the sum of means; in parts whose scatter tells the uncertainty.
struct BlockSums {
  static constexpr std::size_t kParts = 8;
  std::array<std::array<std::complex<double>, kTransferHarmonics>, kParts> harmonic{};
  std::array<double, kParts> mean{};
  int count = 0;
};

class SweepReader {
 public:
  // Both outlive it.
  SweepReader(const TransferSweep& sweep, const CameraInfo& camera);

  // Pixels of a band in a block of the picture, darker ones left out.
  std::vector<TransferPixel> pixels(const cv::Rect& block, int band) const;

  // `pixels` of one band, at least one.
  BlockSums sums(const std::vector<TransferPixel>& pixels) const;

 private:
  bool is_on_target(int row, int col) const;
  // NaN where a shift is missing.
  double mean(const TransferPixel& pixel) const;

  const TransferSweep& sweep_;
  const CameraInfo& camera_;
  std::vector<std::complex<double>> turns_;  // [shift][n - 1]
};

// Contrast over what a sharp stripe would have. The phase common to the block is taken away: a
// position that is off by a little is no loss of contrast.
Contrasts contrasts_of(const BlockSums& sums, int width_px);

}  // namespace estimation
