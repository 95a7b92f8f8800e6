#include "hw_sim/world/simulated_rig.h"

#include <string>
#include <utility>

#include "estimation/session/file_reading.h"

namespace hw_sim {

namespace {

rig::Result<estimation::Calibration> read_calibration(const rig::RigFile& rig) {
  if (rig.calibration_file.empty())
    return rig::failure(rig::Fault::kConfiguration,
                        rig.path.string() + ": a simulated rig needs a calibration file");
  const auto text = estimation::read_text(rig.calibration_file);
  if (!text)
    return rig::failure(rig::Fault::kConfiguration,
                        "cannot read calibration file " + text.error().text() +
                            "; correct [calibration] file in the rig file");
  estimation::Result<estimation::Calibration> calibration =
      estimation::parse_calibration(*text, rig.calibration_file.string());
  if (!calibration) return rig::failure(rig::Fault::kConfiguration, calibration.error().text());
  return *std::move(calibration);
}

}  // namespace

rig::Result<SimulatedRig> simulated_rig(const rig::RigFile& rig) {
  const auto format = estimation::parse_pixel_format(rig.camera.pixel_format);
  if (!format)
    return rig::failure(rig::Fault::kConfiguration,
                        rig.path.string() + ": pixel_format " + rig.camera.pixel_format +
                            " cannot be simulated; use Mono8, BayerRG12 or the like");
  rig::Result<estimation::Calibration> calibration = read_calibration(rig);
  if (!calibration) return tl::unexpected(calibration.error());
  SimulatedRig simulated;
  simulated.calibration = *std::move(calibration);
  estimation::CameraInfo& camera = simulated.camera;
  camera.width_px = rig.camera.width_px;
  camera.height_px = rig.camera.height_px;
  camera.roi_x_px = rig.camera.offset_x_px;
  camera.roi_y_px = rig.camera.offset_y_px;
  camera.pixel_format = *format;
  camera.black_level_dn = rig.sensor.black_level_dn;
  camera.saturation_level_dn = rig.sensor.saturation_level_dn;
  camera.gain_e_per_dn = rig.sensor.gain_e_per_dn;
  camera.read_noise_e = rig.sensor.read_noise_e;
  simulated.projector.width_px = rig.projector.width_px;
  simulated.projector.height_px = rig.projector.height_px;
  return simulated;
}

}  // namespace hw_sim
