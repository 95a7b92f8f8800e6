// The files beside the frames that the calibration names, read and checked once.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/profile/stripe_transfer.h"
#include "estimation/radiometry/merge.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace estimation {

struct Auxiliary {
  CameraBlack black{0.0};
  Image<float> flat_field, vignetting;  // empty where none is named
  HarmonicTransfer transfer;
  std::vector<std::string> notes;  // for the user
};

// Errors: a file that is missing, damaged or of the wrong size, with the manifest's key for it.
Result<Auxiliary> read_auxiliary(const Manifest& manifest, const std::filesystem::path& session);

// The same error with the manifest's key that names the file.
InputError named_by(const std::string& key, InputError error);

}  // namespace estimation
