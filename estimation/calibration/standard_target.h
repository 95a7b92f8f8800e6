// Where the reflectance standard is in a picture. Private to this folder.
#pragma once

#include <opencv2/core.hpp>
#include <optional>

#include "estimation/calibration/illumination_fit.h"

namespace estimation {

struct Plane {
  Vec3 normal;           // unit, towards the camera
  double offset_mm = 0;  // normal . X
  double rms_mm = 0;
};

// Signals of a camera sample by band; a Bayer sample has one.
struct Sampler {
  const CameraInfo& camera;
  int channel_count;
  template <typename Use>
  void for_each_band(int row, int col, const Use& use) const {
    if (channel_count > 1)
      for (int channel = 0; channel < channel_count; ++channel) use(channel, channel);
    else
      use(band_at(camera, row, col), 0);
  }
};

// The standard's own pixels: bright, on its plane, not at its border.
struct Target {
  Plane plane;
  cv::Mat1b mask;
};

// Nullopt where no bright plane is seen. `focal_px` is the camera's. OpenCV may throw.
std::optional<Target> find_target(const StandardView& view, const Sampler& sampler, double focal_px,
                                  const StandardOptions& options);

}  // namespace estimation
