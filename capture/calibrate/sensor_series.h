// The frames of dark and lit series, held together for the sensor's fit and the light's check.
#pragma once

#include <deque>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/calibration/light_check.h"
#include "estimation/calibration/sensor_fit.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace capture {

// Not thread-safe.
class SensorSeries {
 public:
  // All frames of the session are dark.
  estimation::Result<void> add_dark(const std::filesystem::path& session);
  // Frames of white, of black and of grey patterns (fringes too wide to vary over the picture); the
  // manifest's own dark frames are taken too. Others are left alone.
  estimation::Result<void> add_lit(const std::filesystem::path& session);

  // Are the dark frames dark: none has bright areas, and none is brighter for a longer exposure
  // than a warm sensor makes it. Errors: kInsufficient, what they see.
  estimation::Result<void> check_dark() const;

  // What fit_sensor() wants: dark frames, and those of the even picture (white or a grey) that most
  // exposures have unclipped.
  std::vector<estimation::SeriesFrame> frames() const;
  // Repeats in the order of the manifest, two by two, with the noise that `sensor` expects.
  std::vector<estimation::LightPair> pairs(const estimation::SensorFit& sensor) const;

  double saturation_dn() const { return saturation_dn_; }
  const std::optional<estimation::CameraInfo>& camera() const { return camera_; }

 private:
  struct Frame {
    double exposure_us = 0;
    std::optional<double> drive_frac;  // none: dark
    estimation::Image<std::uint16_t> dn;
  };
  estimation::Result<void> read(const std::filesystem::path& session,
                                const estimation::Manifest& manifest, const std::string& file,
                                double exposure_us, std::optional<double> drive_frac);

  std::vector<char> lit_field(double black_dn) const;  // [sample]
  double fullest_drive() const;

  std::deque<Frame> frames_;
  std::optional<estimation::CameraInfo> camera_;
  double saturation_dn_ = 0;
};

}  // namespace capture
