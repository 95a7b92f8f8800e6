// Which of the projector's light a shutter lets in: pictures follow each other row by row, and the
// lamp ripples.
#pragma once

#include <cstddef>
#include <vector>

#include "hw_sim/world.h"
#include "hw_sim/world/effects.h"

namespace hw_sim {

// Of one exposure. Slots tell apart what differs in time: [band][projector row].
class ShutterLight {
 public:
  // Slots under these effects: rows only where they are lit one after the other, bands only where
  // they ripple. Slot of a place: band_slot * row_count + row_slot.
  struct Slots {
    std::size_t band_count = 1, row_count = 1;
    std::size_t at(int band, double row_px) const;
  };
  static Slots slots(const Effects& effects, int lamp_height_px);

  // exposure.light ends when the shutter closes, and begins no later than scanout_ms before it
  // opens where anything was lit then.
  ShutterLight(const Exposure& exposure, const Effects& effects, const Slots& slots);

  // [slot], microseconds of full light from exposure.light[segment].
  const std::vector<float>& time_us(std::size_t segment) const { return time_us_[segment]; }
  bool is_lit(std::size_t segment) const;

 private:
  std::vector<std::vector<float>> time_us_;
};

// The mean of 1 + depth sin(2 pi freq_hz t + phase_rad) over an interval.
double mean_ripple(double depth, double freq_hz, double phase_rad, double begin_s, double end_s);

}  // namespace hw_sim
