// Light between the parts of the scene, over patches of a few millimetres: what a patch sends back
// of its light falls on the others by form factors with visibility, a few times over. A wall behind
// the subject takes part with what misses the head.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <unordered_map>
#include <vector>

#include "estimation/base/image.h"
#include "hw_sim/world/lamp_response.h"
#include "hw_sim/world/projector_light.h"
#include "hw_sim/world/scene.h"
#include "hw_sim/world/seen_points.h"
#include "hw_sim/world/surface.h"

namespace hw_sim {

struct Backdrop {  // a wall across the camera's axis
  double distance_mm = 0;
  double reflectance = 0;  // 0: no wall
};

struct InterreflectionOptions {
  int bounces = 3;
  Backdrop backdrop;
  // What the projector's lens passes at a place of its picture; empty: everything.
  std::function<double(double row_px, double col_px)> lamp_passes;
};

// Immutable, so thread-safe. Construction and use run in the caller's TBB arena.
class Interreflection {
 public:
  Interreflection() = default;
  Interreflection(const Surface& surface, const SkinMap& skin, const ProjectorLight& light,
                  const SeenPoints& seen, const TotalReflectance& reflectance_of,
                  const InterreflectionOptions& options);

  // Indirect irradiance [seen point][band] under a picture, in units of the irradiance at the
  // reference distance; smooth over the surface.
  std::vector<std::array<float, 3>> received(estimation::ImageView<const unsigned char> brightness,
                                             const LampResponse& lamp) const;
  // R_d times that, [sample].
  std::vector<float> reflected(estimation::ImageView<const unsigned char> brightness,
                               const LampResponse& lamp, const SeenPoints& seen) const;

  int patch_count() const { return static_cast<int>(patches_.size()); }

 private:
  using ByBand = std::array<double, 3>;
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

  std::unordered_map<std::int64_t, std::int32_t> make_patches(
      const Surface& surface, const SkinMap& skin, const TotalReflectance& reflectance_of);
  void add_backdrop();
  // Of the backdrop where a ray meets it; -1 beside it, or without one.
  std::int32_t backdrop_patch(const Ray& ray) const;
  void gather_light(const InterreflectionOptions& options);
  void gather_form_factors(const Surface& surface);
  void interpolate(const std::unordered_map<std::int64_t, std::int32_t>& patch_of_cell,
                   const SeenPoints& seen);
  std::vector<double> direct_irradiance(estimation::ImageView<const unsigned char> brightness,
                                        const LampResponse& lamp) const;
  std::vector<ByBand> bounced(const std::vector<ByBand>& irradiance) const;

  const ProjectorLight* light_ = nullptr;
  int bounces_ = 0;
  Backdrop backdrop_;
  std::vector<Patch> patches_;  // the surface's, then the backdrop's
  std::int32_t surface_patch_count_ = 0;
  std::vector<std::int32_t> patch_of_triangle_;
  std::vector<std::int32_t> patch_of_light_;  // [lattice point]; -1 where it is lost
  std::vector<float> flux_mm2_;               // [lattice point]
  std::vector<std::vector<Share>> sources_;   // [receiving patch]: form factors
  std::vector<Shares> neighbours_;            // [seen point]: interpolation between patches
  std::vector<float> sample_reflectance_;     // [sample]: R_d
};

}  // namespace hw_sim
