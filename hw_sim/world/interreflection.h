// One bounce of light between parts of the face, over patches of a few millimetres: what a patch
// sends back of its direct light falls on the others by form factors with visibility.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "hw_sim/world/projector_light.h"
#include "hw_sim/world/scene.h"
#include "hw_sim/world/seen_points.h"
#include "hw_sim/world/surface.h"

namespace hw_sim {

// Immutable, so thread-safe. Construction and use run in the caller's TBB arena.
class Interreflection {
 public:
  Interreflection() = default;
  Interreflection(const Surface& surface, const SkinMap& skin, const ProjectorLight& light,
                  const SeenPoints& seen, const TotalReflectance& reflectance_of);

  // Indirect irradiance [seen point][band] under a picture, in units of the irradiance at the
  // reference distance; smooth over the surface.
  std::vector<std::array<float, 3>> received(
      estimation::ImageView<const unsigned char> brightness) const;
  // Adds R_d times that to `linear[sample]`.
  void add_light(estimation::ImageView<const unsigned char> brightness, const SeenPoints& seen,
                 std::vector<float>& linear) const;

  int patch_count() const { return static_cast<int>(patches_.size()); }

 private:
  struct Patch {
    estimation::Vec3 point_mm;
    estimation::Vec3 normal;
    double area_mm2 = 0;
    std::array<float, 3> reflectance{};  // R_d by band
  };
  struct Share {
    std::int32_t patch = 0;
    float weight = 0;
  };
  using Shares = std::array<Share, 8>;

  void gather_form_factors(const Surface& surface);

  const ProjectorLight* light_ = nullptr;
  std::vector<Patch> patches_;
  std::vector<std::int32_t> patch_of_triangle_;
  std::vector<std::vector<Share>> sources_;  // [receiving patch]: form factors
  std::vector<Shares> neighbours_;           // [seen point]: interpolation between patches
  std::vector<float> sample_reflectance_;    // [sample]: R_d
};

}  // namespace hw_sim
