// The report of a radiometric calibration: texts, and pictures as PNG files into a folder, made if
// absent.
#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "estimation/calibration/illumination_fit.h"
#include "estimation/calibration/light_check.h"
#include "estimation/calibration/sensor_fit.h"
#include "estimation/calibration/transfer_fit.h"
#include "estimation/session/error.h"

namespace estimation {

std::string describe_sensor(const SensorFit& fit);
std::string describe_light(const LightCheck& check);
std::string describe_illumination(const IlluminationFit& fit);
std::string describe_transfer(const TransferFit& fit);

// photon_transfer.png, linearity.png
Result<void> draw_sensor(const std::filesystem::path& folder, const SensorFit& fit);
// vignetting.png, standard_residuals.png (along the projector's columns)
Result<void> draw_illumination(const std::filesystem::path& folder, const IlluminationFit& fit);
// transfer_1.png ..., one a target: contrast over harmonics with the Gaussian that fits best
Result<void> draw_transfer(const std::filesystem::path& folder, std::span<const TransferFit> fits);

}  // namespace estimation
