// What the estimator says about each pixel, and its files (SESSION/maps/*.exr).
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/error.h"

namespace estimation {

// validity.exr: a sum of these per pixel and band; 0 where nothing is to be said.
enum Validity : std::uint32_t {
  // errors: the maps hold NaN
  kBackground = 1,
  kSaturated = 2,
  kTooDark = 4,
  kNoCorrespondence = 8,
  kGrazingProjector = 16,
  kGrazingCamera = 32,
  kOutsideModel = 64,
  kNotIdentifiable = 128,
  // warnings: there is a value
  kPoorFit = 1024,
  kNearDiscontinuity = 2048,
  kIndirectFixedAtZero = 4096,
  kHelpedByNeighbourhood = 8192,
  kEdited = 16384
};
inline constexpr std::uint32_t kValidityErrors = 255;

using BandMaps = std::array<Image<float>, 3>;  // [band]; mono uses the first

// All [height][width] on the camera grid of the frames; NaN where there is no estimate; an empty
// image was not computed and has no file.
struct Maps {
  int height_px = 0;
  int width_px = 0;
  int band_count = 3;  // 1 (mono) or 3
  BandMaps sigma_a_per_mm;
  BandMaps sigma_s_prime_per_mm;
  BandMaps translucency_mm;      // l_d
  BandMaps diffuse_reflectance;  // R_d
  BandMaps indirect;             // B
  // Standard deviations: relative for the first four, absolute for the rest.
  BandMaps sigma_a_rel_sd, sigma_s_prime_rel_sd, translucency_rel_sd, diffuse_reflectance_rel_sd;
  BandMaps indirect_sd;
  std::array<Image<float>, 2> correspondence_sd_px;  // U, V
  Image<float> position_sd_mm;
  std::array<Image<float>, 3> position_mm;        // X, Y, Z; camera coordinates
  std::array<Image<float>, 3> normal;             // X, Y, Z; unit, towards the camera
  std::array<Image<float>, 2> correspondence_px;  // U column, V row; projector px
  std::array<Image<std::uint32_t>, 3> validity;   // [band]
  std::string method, scattering_model;           // header attributes
  bool is_noise_measured = true;                  // else every header says noise "estimated"
};

// Writes every computed map into `folder` (made if absent) and removes the maps of an earlier run
// that this one has none for; other files stay. On an error the maps that were there stay as they
// were.
Result<void> write_maps(const std::filesystem::path& folder, const Maps& maps);

// Reads what is there; a missing file leaves its image empty. Errors: a damaged file, or sizes that
// differ.
Result<Maps> read_maps(const std::filesystem::path& folder);

// Single EXR files, 32-bit float, ZIP. Channels in the order given; attributes are strings.
struct ExrChannel {
  std::string name;
  ImageView<const float> pixels;
};
Result<void> write_exr(const std::filesystem::path& path, const std::vector<ExrChannel>& channels,
                       const std::vector<std::pair<std::string, std::string>>& attributes);
Result<std::map<std::string, Image<float>>> read_exr(const std::filesystem::path& path);

}  // namespace estimation
