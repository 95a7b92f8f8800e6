// What a pixel sees of the stripes beyond what a flat, evenly lit, endless piece of its own
// material would show: the paper's eq. 7 summed in space over the reconstructed surface, less the
// same sum over the pixel's own plane.
//
// The kernel is that of the material at the seen point, as in the paper (eq. 7), and distances are
// straight lines through the medium.
#pragma once

#include <complex>
#include <span>
#include <vector>

#include "estimation/refine/lit_patches.h"
#include "estimation/refine/radial_profile.h"

namespace estimation {

struct SpreadMaterial {
  double diffuse_reflectance = 0;
  double translucency_mm = 0;  // l_d
};

// Borrows all it is given. One per task.
class SpatialCorrection {
 public:
  // `harmonic_count` + 1 numbers a pixel, n = 0 first.
  SpatialCorrection(const LitSurface& surface, const LitPatches& patches,
                    const RadialProfile& profile, int period_px, int harmonic_count);

  // out[n] = D_n, on the scale of R_d under the pixel's own G, such that a sample's reflectance
  // factor is the homogeneous model's with R~(2 pi n / P) + D_n in the place of R~ (D_0 beside
  // R_d). False, and zeros, where the surface around the pixel is not known well enough.
  bool at(int row, int col, const SpreadMaterial& material, std::span<std::complex<double>> out);

 private:
  // Light that reaches the pixel, and at which phase of the stripes relative to the pixel's.
  struct Arrivals {
    std::vector<float> weight, cosine, sine;
    void add(float w, float c, float s) {
      weight.push_back(w);
      cosine.push_back(c);
      sine.push_back(s);
    }
    void clear() {
      weight.clear();
      cosine.clear();
      sine.clear();
    }
  };
  void collect_surface(int block_row, int first, int last);
  void collect_plane(int block_row, int first, int last);
  void sum_arrivals(std::span<std::complex<double>> out);
  float profile_at(float distance2_mm2) const;

  const LitSurface& surface_;
  const LitPatches& patches_;
  const RadialProfile& profile_;
  int period_px_;
  std::size_t count_;        // harmonics and the mean
  std::vector<float> line_;  // of the profile, one material's
  Arrivals arrivals_;
  std::vector<float> im_;
  // Of the pixel at hand:
  int row_ = 0, col_ = 0;
  LocalPlane plane_;
  Vec3 here_mm_{0, 0, 0};
  double own_phase_rad_ = 0, plane_flux_mm2_ = 0;
  float reach2_mm2_ = 0, steps_per_mm_ = 0;
};

}  // namespace estimation
