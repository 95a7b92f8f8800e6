// Deferred correction: what the surface around a pixel adds to its samples, and takes from them,
// is computed in space and removed from the data, so that the ordinary fit of a flat, endless
// material applies. Repeated with the maps of the last fit, it converges to the least-squares
// solution with geometry that the paper's section 8 proposes.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/profile/band_sites.h"
#include "estimation/profile/stripe_scene.h"
#include "estimation/refine/spread_field.h"
#include "estimation/session/manifest.h"

namespace estimation {

// Everything borrowed. The scene's geometry is the surface's, its signals are not looked at.
struct CorrectionInput {
  const StripeScene& scene;
  const LitSurface& surface;
};

// One band's sites among the pixels to be refined, with their samples as measured.
class SampleCorrection {
 public:
  //   signals  [image of the sweep][height][width][channel] DN/us
  //   wanted   [height][width] nonzero where to refine
  SampleCorrection(const CameraInfo& camera, int band,
                   std::span<const ImageView<const float>> signals,
                   ImageView<const unsigned char> wanted);

  std::size_t site_count() const { return sites_.size(); }

  // Writes the measured samples less the correction for `material` into `signals`; sites whose
  // surroundings or material are not known get their samples as measured. Runs in the caller's
  // oneTBB arena; the same bits for any number of threads.
  //   signal_per_us         DN/us of a perfect reflector at G = 1
  //   projector_black_frac  projector black over white, where the signals hold it
  void apply(const CorrectionInput& input, const BandMaterial& material, double signal_per_us,
             double projector_black_frac, std::span<const ImageView<float>> signals) const;

  // Writes the samples as measured.
  void restore(std::span<const ImageView<float>> signals) const;

 private:
  int band_, channel_;
  std::vector<Site> sites_;
  std::size_t sample_count_;
  std::vector<float> measured_;  // [site][image]
};

}  // namespace estimation
