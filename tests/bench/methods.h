// The estimators that compete: ours, the paper's, and those of the literature, all over the same
// pixels, all in parallel over pixels in the caller's oneTBB arena.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "estimation/models/scattering_model.h"
#include "estimation/profile/likelihood.h"
#include "tests/bench/pixels.h"

namespace bench {

// What a method prepares (tables, starts) is not part of the time of run().
class Method {
 public:
  virtual ~Method() = default;
  virtual std::string name() const = 0;
  // Once for each set of pixels, before run().
  virtual void prepare(const PixelSet&) {}
  // One estimate a pixel.
  virtual void run(const PixelSet& pixels, std::vector<Estimate>& estimates) const = 0;
};

struct LikelihoodOptions {
  int harmonic_count = 0;  // 0: all
  estimation::IndirectLight indirect = estimation::IndirectLight::kFree;
  bool is_double = false;  // fit_pixel instead of fit_batch
};
// Ours. Borrows model and table.
std::unique_ptr<Method> likelihood(const std::string& name,
                                   const estimation::ScatteringModel& model,
                                   const estimation::HarmonicTable& table,
                                   const LikelihoodOptions& options);

// A table over what the pixels' subjects occupy, with room for noise: what the product builds for a
// scene. Or for everything that skin could be.
estimation::HarmonicTable harmonic_table(const estimation::ScatteringModel& model,
                                         const PixelSet& for_pixels);
estimation::HarmonicTable wide_harmonic_table(const estimation::ScatteringModel& model,
                                              estimation::StripeShape shape);

// The paper's table, l_d searched by parabolas (estimation/profile/lut_fit.h), or by trying all 200
// columns; indirect light from the minimum's excess either way.
std::unique_ptr<Method> parabolic_table(const estimation::ScatteringModel& model,
                                        const PixelSet& for_pixels);
std::unique_ptr<Method> brute_force_table(const estimation::ScatteringModel& model,
                                          const PixelSet& for_pixels);

// Levenberg-Marquardt on all samples of each pixel for (s, l_d, B, u), the dipole in closed form
// with analytic derivatives, weights from the signal's harmonic reconstruction, started from the
// two-frequency table. With Ceres' general solver or its solver for tiny dense problems.
enum class CeresSolver { kGeneral, kTiny };
std::unique_ptr<Method> ceres_fit(double eta, const PixelSet& for_pixels, CeresSolver solver);

// Spatial frequency domain imaging: R_d from the mean, l_d from the contrast of the first harmonic,
// bilinear in an inverse table of both (256 x 256). No indirect light.
std::unique_ptr<Method> two_frequency_table(const estimation::ScatteringModel& model,
                                            const PixelSet& for_pixels);

}  // namespace bench
