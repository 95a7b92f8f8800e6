// Light that comes back from where it falls without entering: the shine of skin, a wall behind the
// subject, an open eye.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/base/linear.h"
#include "hw_sim/world/lamp_response.h"

namespace hw_sim {

// How a place's projector coordinates change as its surface moves along its normal.
struct Slide {
  std::array<double, 3> normal{};
  std::array<float, 2> px_per_mm{};  // column, row
  // By how much light arrives displaced, px: it stays, the place moves under it.
  float shift_px(std::size_t axis, const estimation::Vec3& displacement_mm) const {
    const double along_mm = normal[0] * displacement_mm[0] + normal[1] * displacement_mm[1] +
                            normal[2] * displacement_mm[2];
    return -px_per_mm[axis] * static_cast<float>(along_mm);
  }
};

struct DirectSample {
  std::int32_t sample = 0;                    // of the frame
  float col_px = 0, row_px = 0, blur_px = 0;  // of the projector
  float weight = 0;                           // reflectance factor times irradiance
  Slide slide;
};

// Immutable once filled, so thread-safe.
class DirectLight {
 public:
  void add(const DirectSample& sample) { samples_.push_back(sample); }
  bool empty() const { return samples_.empty(); }
  const std::vector<DirectSample>& samples() const { return samples_; }
  // Adds to `linear` [frame sample] what comes back of a picture.
  void add_light(estimation::ImageView<const unsigned char> brightness, const LampResponse& lamp,
                 const estimation::Vec3& displacement_mm, std::vector<float>& linear) const;

 private:
  std::vector<DirectSample> samples_;
};

// Reflectance factor of a rough surface's shine, relative to a perfect diffuser (GGX microfacets,
// index 1.4). The directions point away from the surface.
double shine(const estimation::Vec3& normal, const estimation::Vec3& towards_lamp,
             const estimation::Vec3& towards_eye, double roughness);

}  // namespace hw_sim
