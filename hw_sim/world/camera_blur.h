// The camera lens's point spread: a Gaussian, wider where the scene is out of focus.
#pragma once

#include <vector>

#include "estimation/base/image.h"

namespace hw_sim {

// Immutable, so thread-safe.
class CameraBlur {
 public:
  CameraBlur() = default;  // sharp
  // `blur_px` [height][width]: standard deviation at each pixel, camera px. Pixels of one colour
  // lie `pitch_px` apart: 2 under a Bayer mosaic, whose four colours are blurred each by itself.
  CameraBlur(estimation::Image<float> blur_px, int pitch_px);

  bool is_sharp() const { return blur_px_.empty(); }
  // In place, [height][width][channel]. Runs in the caller's TBB arena.
  void apply(estimation::Image<float>& linear) const;

 private:
  void apply_to_lattice(int first_row, int first_col, int channel,
                        estimation::Image<float>& linear) const;

  estimation::Image<float> blur_px_;
  int pitch_px_ = 1;
  std::vector<std::vector<float>> taps_;  // by blur in steps, from first_step_ on; empty: unused
  int first_step_ = 0;
};

}  // namespace hw_sim
