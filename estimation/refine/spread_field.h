// How light from around a point differs from what the point's own plane would send it, at nodes
// spread over the picture: it varies slowly, over a diffuse mean free path.
#pragma once

#include <complex>
#include <vector>

#include "estimation/models/scattering_model.h"
#include "estimation/profile/stripe_set.h"
#include "estimation/refine/lit_patches.h"
#include "estimation/session/manifest.h"

namespace estimation {

// One band's maps on the whole grid; NaN where there is no estimate.
struct BandMaterial {
  ImageView<const float> diffuse_reflectance;
  ImageView<const float> translucency_mm;  // l_d
};

// Median l_d over the lit pixels that have one; NaN if there is none.
double typical_translucency_mm(const LitSurface& surface, const BandMaterial& material);

// Median side of a lit camera pixel at the subject, across the line of sight; NaN if none is lit.
double typical_pixel_mm(const LitSurface& surface);

struct SpreadField {
  int stride_px = 1;
  int rows = 0, cols = 0;  // node (i, j) stands at pixel (i * stride, j * stride)
  // Seen over expected on the plane: the mean and the first harmonic. NaN: not known.
  std::vector<float> mean;
  std::vector<std::complex<float>> first;

  bool is_known(int node_row, int node_col) const;
  std::complex<float> first_at(int node_row, int node_col) const {
    return first[index(node_row, node_col)];
  }
  float mean_at(int node_row, int node_col) const { return mean[index(node_row, node_col)]; }
  std::size_t index(int node_row, int node_col) const {
    return static_cast<std::size_t>(node_row) * static_cast<std::size_t>(cols) +
           static_cast<std::size_t>(node_col);
  }
};

// Nodes 0.4 l_d apart; where that is a camera pixel, the band's own pixels. Runs in the caller's
// oneTBB arena; the same bits for any number of threads.
SpreadField spread_field(const CameraInfo& camera, int band, const LitSurface& surface,
                         const BandMaterial& material, const ScatteringModel& model,
                         StripeShape shape);

}  // namespace estimation
