// How far a session's maps are from the truth of the scene that was simulated.
#pragma once

#include <array>
#include <filesystem>
#include <string>

#include "estimation/session/error.h"

namespace hw_sim {

struct ErrorStats {
  double median = 0;  // NaN where there is nothing to compare
  double percentile95 = 0;
};

struct BandErrors {  // relative, absolute values
  ErrorStats sigma_a, sigma_s_prime, translucency, diffuse_reflectance;
  double valid_frac = 0;  // of the set's pixels: no error bit and a value
};

// Over one set of pixels, all of them lit with both angles (projector, camera) below 60 degrees.
struct SetErrors {
  int pixel_count = 0;
  int band_count = 3;
  std::array<BandErrors, 3> bands;
  ErrorStats position_mm;
  ErrorStats normal_deg;
};

struct JudgeReport {
  SetErrors face;
  // Forehead and cheeks (a phantom is all cheek), more than 2 l_d of the band from any border.
  SetErrors smooth_skin;

  std::string table() const;  // for a terminal
  std::string json() const;
};

// `maps`: SESSION/maps; `truth`: what HeadWorld::write_truth wrote. Thread-safe.
// Errors: kNotFound if either has no maps of the other's size; read errors as they are.
estimation::Result<JudgeReport> judge(const std::filesystem::path& maps,
                                      const std::filesystem::path& truth);

}  // namespace hw_sim
