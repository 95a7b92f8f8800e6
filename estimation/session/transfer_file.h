// What a stripe transfer must be, in the manifest and as an EXR on the camera grid: verify and the
// estimator refuse the same ones.
#pragma once

#include <map>
#include <optional>
#include <string>

#include "estimation/session/manifest.h"

namespace estimation {

// Optics never add contrast; a measured one may exceed 1 by its noise. A calibration that says 1.2
// has another reference than the contrast at no cycles, and would double sigma_a.
inline constexpr double kLargestTransfer = 1.02;

// What is wrong with the EXR's channels R.1 R.2 ... (a mono camera's may be Y.1 ...) as the
// expectation of an error; nullopt if nothing is. A sample may be NaN: that pixel has no fit.
std::optional<std::string> transfer_file_problem(const std::map<std::string, Image<float>>& file,
                                                 const CameraInfo& camera);

// A band's n-th channel in the file, by either name; nullptr if it has none.
const Image<float>* transfer_channel(const std::map<std::string, Image<float>>& file,
                                     ColorFilter filter, int band, int n);

}  // namespace estimation
