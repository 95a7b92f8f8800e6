#include "hw_sim/world/shutter_light.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>

namespace hw_sim {

double mean_ripple(double depth, double freq_hz, double phase_rad, double begin_s, double end_s) {
  const double rate = 2 * std::numbers::pi * freq_hz, length = rate * (end_s - begin_s);
  if (!(length > 0)) return 1;
  const double begin = std::fmod(rate * begin_s + phase_rad, 2 * std::numbers::pi);
  return 1 + depth * (std::cos(begin) - std::cos(begin + length)) / length;
}

ShutterLight::Slots ShutterLight::slots(const Effects& effects, int lamp_height_px) {
  return {.band_count = effects.ripple_frac > 0 ? 3U : 1U,
          .row_count = effects.scanout_ms > 0 ? static_cast<std::size_t>(lamp_height_px) : 1U};
}

std::size_t ShutterLight::Slots::at(int band, double row_px) const {
  const double row = std::clamp(std::round(row_px), 0.0, static_cast<double>(row_count - 1));
  return std::min(static_cast<std::size_t>(band), band_count - 1) * row_count +
         static_cast<std::size_t>(row);
}

ShutterLight::ShutterLight(const Exposure& exposure, const Effects& effects, const Slots& slots) {
  using Seconds = std::chrono::duration<double>;
  const double open_s = Seconds(exposure.duration).count();
  const double start_s = Seconds(exposure.start).count();
  std::chrono::nanoseconds lit{0};
  for (const LightSegment& segment : exposure.light) lit += segment.duration;
  double begin_s = Seconds(exposure.duration - lit).count();  // from the shutter's opening
  for (std::size_t i = 0; i < exposure.light.size(); ++i) {
    const double end_s = i + 1 == exposure.light.size()
                             ? std::numeric_limits<double>::infinity()
                             : begin_s + Seconds(exposure.light[i].duration).count();
    std::vector<float>& times_us = time_us_.emplace_back(slots.band_count * slots.row_count, 0.0F);
    for (std::size_t row = 0; row < slots.row_count; ++row) {
      const double delay_s = effects.scanout_ms * 1e-3 * static_cast<double>(row) /
                             static_cast<double>(slots.row_count);
      const double from_s = std::max(0.0, begin_s + delay_s);
      const double to_s = std::min(open_s, end_s + delay_s);
      if (!(to_s > from_s)) continue;
      for (std::size_t band = 0; band < slots.band_count; ++band) {
        const double phase_rad = 2 * std::numbers::pi * static_cast<double>(band) / 3;
        times_us[band * slots.row_count + row] =
            static_cast<float>((to_s - from_s) * 1e6 *
                               mean_ripple(effects.ripple_frac, effects.ripple_hz, phase_rad,
                                           start_s + from_s, start_s + to_s));
      }
    }
    begin_s = end_s;
  }
}

bool ShutterLight::is_lit(std::size_t segment) const {
  return std::any_of(time_us_[segment].begin(), time_us_[segment].end(),
                     [](float time_us) { return time_us > 0; });
}

}  // namespace hw_sim
