// The optics' contrast for each harmonic of the stripes: calibration.stripe_transfer in all its
// forms.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/manifest.h"

namespace estimation {

class HarmonicTransfer {
 public:
  // `file` holds the EXR's channels where the calibration names one (else empty). A mono camera's
  // channels may be named Y.n or R.n. Errors: kInvalid where the file has no channels of a band,
  // not the camera's size, or a contrast above 1 (session/transfer_file.h).
  static Result<HarmonicTransfer> create(const std::optional<StripeTransfer>& calibration,
                                         const std::map<std::string, Image<float>>& file,
                                         const CameraInfo& camera);

  // Contrast m_n of harmonics n = 1, 2, ... of stripes of this period at a camera pixel, into
  // `out`. Calibrated at whole cycles per 40 projector px; linear between them (m = 1 at zero),
  // above the last continued as the Gaussian through it. Depth entries are interpolated in
  // distance, the ends hold beyond.
  void at(int row, int col, int band, double distance_mm, int period_px,
          std::span<float> out) const;

  // The same contrast at every pixel and distance.
  bool is_uniform() const { return depths_.size() <= 1 && maps_[0].empty(); }
  bool is_perfect() const { return depths_.empty() && maps_[0].empty(); }  // m_n = 1 everywhere

 private:
  std::vector<TransferByDepth::Entry> depths_;
  std::array<std::vector<Image<float>>, 3> maps_;  // [band][n - 1]
};

}  // namespace estimation
