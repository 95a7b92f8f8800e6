// Radiometry from sessions: of darkness, of a steady scene over exposures, of the reflectance
// standard, of an opaque target at several distances, and a colour chart's numbers.
#pragma once

#include <array>
#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "estimation/calibration/color_fit.h"
#include "estimation/calibration/illumination_fit.h"
#include "estimation/calibration/light_check.h"
#include "estimation/calibration/sensor_fit.h"
#include "estimation/calibration/transfer_fit.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace capture {

struct RadiometryInputs {
  std::vector<std::string> dark;      // every frame is dark
  std::vector<std::string> series;    // white (black, grey) at several exposures, repeated
  std::vector<std::string> standard;  // under Gray code, or white and black too
  std::vector<std::string> opaque;    // under the sweep
  std::array<double, 3> reflectance{0.99, 0.99, 0.99};
  // A JSON list of a colour chart's {"camera": [r, g, b], "display": [r, g, b]} (see ColorPatch),
  // or
  // {"primaries": [[r, g, b] of the standard under red, under green, under blue]}; or empty.
  std::string chart;
};

// Not thread-safe.
class RadiometryJob {
 public:
  // `geometry` is the rig's. What is measured: whatever there are sessions for. Errors: a session
  // that cannot be used, and why.
  static estimation::Result<RadiometryJob> run(const RadiometryInputs& inputs,
                                               const estimation::Calibration& geometry);

  // What the measurements warn of.
  std::vector<std::string> warnings() const;
  std::string report() const;
  estimation::Result<void> write_report(const std::filesystem::path& folder) const;

  // Puts the results into the calibration file `path` (it holds the geometry), vignetting and
  // transfer maps beside it under names with the date. Returns what write_calibration() returns.
  // A transfer from a target that scatters is left out.
  estimation::Result<std::filesystem::path> store(const std::filesystem::path& path,
                                                  std::chrono::system_clock::time_point now) const;

 private:
  explicit RadiometryJob(RadiometryInputs inputs) : inputs_(std::move(inputs)) {}
  estimation::Result<void> measure_sensor();
  estimation::Result<void> measure_standard(const estimation::Calibration& geometry);
  estimation::Result<void> measure_transfer(const estimation::Calibration& geometry);
  estimation::Result<void> measure_color();
  bool is_target_opaque() const;
  std::string record_json(std::chrono::system_clock::time_point now) const;

  RadiometryInputs inputs_;
  std::optional<estimation::CameraInfo> camera_;
  std::optional<estimation::SensorFit> sensor_;
  std::optional<estimation::LightCheck> light_;
  std::optional<estimation::IlluminationFit> illumination_;
  std::vector<estimation::TransferFit> transfers_;  // [opaque session]
  std::optional<estimation::ColorFit> color_;
};

}  // namespace capture
