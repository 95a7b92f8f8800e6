// From a Bayer sensor's sites to every pixel: parameters are fitted at the sites of one colour and
// interpolated afterwards, because they vary slowly and demosaiced frames would not
// (design/estimation.md, section 5).
#pragma once

#include <array>
#include <cstdint>

#include "estimation/base/image.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"

namespace estimation {

// One band's parameters on the camera grid; NaN where validity holds an error. An empty image was
// not estimated.
struct BandFit {
  Image<float> diffuse_reflectance = {};
  Image<float> translucency_px = {};  // l_d in projector px
  Image<float> indirect = {};
  Image<float> phase_px = {};  // to be added to the pixel's projector coordinate
  // Standard deviations, relative but the last.
  Image<float> diffuse_reflectance_rel_sd = {}, translucency_rel_sd = {};
  Image<float> sigma_a_rel_sd = {}, sigma_s_prime_rel_sd = {}, indirect_sd = {};
  Image<std::uint32_t> validity = {};

  std::array<Image<float>*, 9> images() {
    return {&diffuse_reflectance,
            &translucency_px,
            &indirect,
            &phase_px,
            &translucency_rel_sd,
            &sigma_a_rel_sd,
            &diffuse_reflectance_rel_sd,
            &indirect_sd,
            &sigma_s_prime_rel_sd};
  }
};

// Completes the pixels that are not sites of `band`: the normalised convolution with [1 2 1] x
// [1 2 1] over the valid sites within 3 x 3. A pixel with errors of its own in `pixel_validity`
// keeps them; one whose sites are all invalid takes over their errors; nothing is extrapolated
// further. Warnings of the sites used are kept. Runs in the caller's oneTBB arena, same bits for
// any number of threads.
void fill_between_sites(const CameraInfo& camera, int band,
                        ImageView<const std::uint32_t> pixel_validity, BandFit& fit);

}  // namespace estimation
