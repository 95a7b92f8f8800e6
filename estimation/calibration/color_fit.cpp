#include "estimation/calibration/color_fit.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

namespace estimation {
namespace {

constexpr double kLargestCondition = 1e3;

tl::unexpected<InputError> insufficient(const std::string& expectation) {
  return tl::unexpected(InputError{InputFault::kInsufficient, "", "", expectation});
}

}  // namespace

Result<ColorFit> fit_color_matrix(std::span<const ColorPatch> patches) {
  constexpr std::size_t kLeastPatches = 4;
  if (patches.size() < kLeastPatches)
    return insufficient("a colour matrix needs four patches of different colours");
  // display - c2 = m0 (c0 - c2) + m1 (c1 - c2), as the row sums to 1.
  cv::Matx22d normal = cv::Matx22d::zeros();
  for (const ColorPatch& patch : patches) {
    const cv::Vec2d x(patch.camera[0] - patch.camera[2], patch.camera[1] - patch.camera[2]);
    normal += x * x.t();
  }
  cv::Matx21d singular;
  cv::SVD::compute(normal, singular);
  if (!(singular(1) > singular(0) / (kLargestCondition * kLargestCondition)))
    return insufficient("the patches are too alike in colour");
  const cv::Matx22d inverse = normal.inv();
  ColorFit fit;
  double all_squares = 0;
  for (int band = 0; band < 3; ++band) {
    cv::Vec2d right;
    for (const ColorPatch& patch : patches)
      right += cv::Vec2d(patch.camera[0] - patch.camera[2], patch.camera[1] - patch.camera[2]) *
               (patch.display[band] - patch.camera[2]);
    const cv::Vec2d m = inverse * right;
    for (int i = 0; i < 3; ++i) fit.matrix(band, i) = i < 2 ? m[i] : 1 - m[0] - m[1];
    double squares = 0;
    for (const ColorPatch& patch : patches) {
      double off = -patch.display[band];
      for (int i = 0; i < 3; ++i) off += fit.matrix(band, i) * patch.camera[i];
      squares += off * off;
      fit.residual_max = std::max(fit.residual_max, std::abs(off));
    }
    all_squares += squares;
    const double variance = squares / static_cast<double>(patches.size() - 2);
    fit.sd(band, 0) = std::sqrt(variance * inverse(0, 0));
    fit.sd(band, 1) = std::sqrt(variance * inverse(1, 1));
    fit.sd(band, 2) = std::sqrt(variance * (inverse(0, 0) + inverse(1, 1) + 2 * inverse(0, 1)));
  }
  fit.residual_rms = std::sqrt(all_squares / (3 * static_cast<double>(patches.size())));
  return fit;
}

Result<Mat3> color_matrix_from_primaries(const Mat3& camera_by_primary) {
  // A white picture is grey to the camera once its bands are scaled by the standard's signal.
  Mat3 scaled = camera_by_primary;
  for (int band = 0; band < 3; ++band) {
    const double white = scaled(band, 0) + scaled(band, 1) + scaled(band, 2);
    if (!(white > 0)) return insufficient("a band of the camera sees none of the single colours");
    for (int primary = 0; primary < 3; ++primary) scaled(band, primary) /= white;
  }
  cv::Matx31d singular;
  cv::SVD::compute(scaled, singular);
  if (!(singular(2) > singular(0) / kLargestCondition))
    return insufficient("the camera cannot tell the projector's single colours apart");
  return Mat3(scaled.inv());
}

}  // namespace estimation
