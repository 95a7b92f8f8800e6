// Pixels that no camera should give, for a fit to survive: any material, any signal, damaged
// samples, too few or repeated shifts.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "estimation/models/dipole.h"
#include "estimation/profile/likelihood.h"
#include "tests/estimation/truth/sensor.h"

namespace bench {

// One kind of sweep, with everything a fit of it borrows.
struct StressSweep {
  std::string name;
  std::vector<int> shifts_px;
  std::vector<estimation::MergedNoise> noise;
  double projector_black_frac = 0;
  estimation::IndirectLight indirect = estimation::IndirectLight::kFree;
};

// Batch number i is the same on every machine and for any number of threads.
class StressPixels {
 public:
  static constexpr std::size_t kCount = 1024;  // pixels a batch

  StressPixels();
  StressPixels(const StressPixels&) = delete;
  StressPixels& operator=(const StressPixels&) = delete;

  const estimation::HarmonicTable& table() const { return *table_; }
  const StressSweep& sweep(std::uint64_t batch) const { return sweeps_[batch % sweeps_.size()]; }
  const estimation::BatchFitter& fitter(std::uint64_t batch) const {
    return fitters_[batch % fitters_.size()];
  }
  const estimation::FitProblem& problem(std::uint64_t batch) const {
    return problems_[batch % problems_.size()];
  }

  struct Buffers {
    std::vector<float> samples, position_px, full_signal;
  };
  // Fills the buffers, which the result borrows. Thread-safe.
  estimation::PixelBatch make(std::uint64_t batch, Buffers& buffers) const;

 private:
  void make_pixel(const StressSweep& sweep, std::size_t pixel,
                  estimation::truth::PixelRandom& random, Buffers& buffers) const;

  estimation::Dipole dipole_{1.4};
  std::unique_ptr<estimation::HarmonicTable> table_;
  std::vector<StressSweep> sweeps_;
  std::vector<estimation::FitProblem> problems_;
  std::vector<estimation::BatchFitter> fitters_;
  // [material][phase] stripe responses without indirect light, 8 phases a projector px
  std::vector<float> curves_;
};

}  // namespace bench
