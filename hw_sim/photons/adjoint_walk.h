// Photons traced backwards, from where the camera looks into the volume: by reciprocity a path says
// how much of the lamp's light that enters anywhere comes out towards the camera. At each
// scattering it collects the lamp's light that gets there unscattered, so one path sees the whole
// neighbourhood. Exact Fresnel boundary; sigma_a, sigma_s and g by place, flights by Woodcock's
// tracking. No table, no dipole and nothing flat: what those are worth is judged by this.
#pragma once

#include <optional>
#include <vector>

#include "hw_sim/photons/lamp.h"
#include "hw_sim/photons/matter.h"
#include "hw_sim/photons/shape_grid.h"
#include "hw_sim/world/white_walk.h"

namespace hw_sim {

// Just below the surface, heading in.
struct PathStart {
  estimation::Vec3 point_mm;
  estimation::Vec3 way;
  double weight = 0;
};

// Goes on below the surface where a path meets it from outside on its way `way`; the weight is what
// the boundary lets through. nullopt where it would come from behind.
std::optional<PathStart> entering(const ShapeGrid& shape, const estimation::Vec3& point_mm,
                                  const estimation::Vec3& way);

// The same for a path that starts in the eye, with the weight that makes its deposits sum to the
// reflectance factor.
std::optional<PathStart> seen_path(const ShapeGrid& shape, const estimation::Vec3& point_mm,
                                   const estimation::Vec3& towards_eye);

// Light that enters at a place counts that much, cast shadows apart.
struct Deposit {
  estimation::Vec3 entry_mm;
  estimation::Vec3 normal;  // of the surface there
  double weight = 0;
};

// How a path left the volume; weight 0: it was absorbed.
struct PathEnd {
  estimation::Vec3 point_mm;
  estimation::Vec3 way;  // outside
  double weight = 0;
};

// A scattering, after what it collected was appended.
struct Turn {
  estimation::Vec3 point_mm;
  estimation::Vec3 way_before, way_after;
  double anisotropy = 0;
  double weight = 0;
};

// Looks on as a path scatters. Whoever knows that little is still to come may thin it.
class PathWatcher {
 public:
  virtual ~PathWatcher() = default;
  // What the path's weight is multiplied by; 0 ends it. One in the mean keeps the walk unbiased.
  virtual double on_turn(const Turn& turn) = 0;
};

// Immutable, so thread-safe; refers to what it was made of.
class AdjointWalk {
 public:
  AdjointWalk(const ShapeGrid& shape, const Matter& matter, const Lamp& lamp)
      : shape_(shape), matter_(matter), lamp_(lamp) {}

  // Appends what one path collects.
  PathEnd trace(const PathStart& start, PhotonRandom& random, std::vector<Deposit>& deposits,
                PathWatcher* watcher = nullptr) const;

 private:
  struct Photon;
  bool fly(Photon& photon, PhotonRandom& random) const;
  bool meet_boundary(Photon& photon, double reach_mm, PhotonRandom& random, double& flown_mm) const;
  void collect(const Photon& photon, const VolumeOptics& here, PhotonRandom& random,
               std::vector<Deposit>& deposits) const;

  const ShapeGrid& shape_;
  const Matter& matter_;
  Lamp lamp_;
};

}  // namespace hw_sim
