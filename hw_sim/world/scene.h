// The scenes: a shape and the materials on it. Materials are the paper's Table 2 by region (the wax
// bust's are Jensen's), with borders a few millimetres wide that are smooth in ln sigma.
#pragma once

#include <array>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "hw_sim/world/dipole.h"
#include "hw_sim/world/shape.h"
#include "rig/fault.h"

namespace hw_sim {

enum class Region { kNone = 0, kElsewhere = 1, kLips = 2, kForehead = 3, kCheek = 4, kStubble = 5 };

struct Material {
  std::array<Scattering, 3> bands;  // R, G, B
};

// What is at a point of the surface.
struct Skin {
  Material material;
  Region region = Region::kElsewhere;  // the one with the largest share
  double border_distance_mm = 0;       // to the nearest zone where materials mix; 0 within it
  bool is_eye = false;                 // between the lids when they open
};

// Immutable, so thread-safe.
class SkinMap {
 public:
  virtual ~SkinMap() = default;
  virtual Skin at(const estimation::Vec3& point_mm) const = 0;
};

struct Scene {
  std::unique_ptr<Shape> shape;  // null: nobody in the chair
  std::unique_ptr<SkinMap> skin;
};

// face_female, face_male, flat_phantom (a slab facing the camera at 1000 mm), tilted_phantom (by 30
// degrees), wedge (two slabs like an open book, 120 degrees between them), sphere, wax_bust (a
// man's head of Jensen's media), empty. Errors: kConfiguration with the list of names.
rig::Result<Scene> make_scene(const std::string& name);
std::vector<std::string> scene_names();

}  // namespace hw_sim
