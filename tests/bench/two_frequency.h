// The two-frequency table of spatial frequency domain imaging.
#pragma once

#include <span>
#include <vector>

#include "estimation/models/scattering_model.h"
#include "estimation/profile/stripe_set.h"

namespace bench {

// ln l_d (projector px) over R_d and the contrast R~(k_1) / R_d, bilinear. Immutable, thread-safe.
class TwoFrequencyTable {
 public:
  TwoFrequencyTable(const estimation::ScatteringModel& model, estimation::StripeShape shape);

  struct Found {
    double diffuse_reflectance = 0, log_translucency_px = 0;
    bool is_inside = false;
  };
  // From the reflectance factors' mean and the amplitude of their first harmonic.
  Found find(double mean, double amplitude) const;

 private:
  static constexpr int kSize = 256;
  double duty_ = 0, stripe_ = 0;            // w/P, w/P sinc(w/P)
  std::vector<float> log_translucency_px_;  // [R_d][contrast]
};

}  // namespace bench
