// Rays against a shape: Embree finds the triangle, a few Newton steps move the hit onto the smooth
// surface behind the mesh, so that positions and normals carry no facets.
#pragma once

#include <memory>
#include <optional>

#include "hw_sim/world/mesh.h"
#include "hw_sim/world/optics.h"
#include "hw_sim/world/shape.h"

namespace hw_sim {

struct Hit {
  estimation::Vec3 point_mm;
  int triangle = 0;
};

// Thread-safe after construction. Construction uses the caller's TBB arena.
class Surface {
 public:
  explicit Surface(std::unique_ptr<Shape> shape);
  ~Surface();
  Surface(const Surface&) = delete;
  Surface& operator=(const Surface&) = delete;

  const Shape& shape() const { return *shape_; }
  const Mesh& mesh() const { return mesh_; }
  // The first hit, on the smooth surface; nullopt for the backdrop.
  std::optional<Hit> first_hit(const Ray& ray) const;
  // The triangle first hit beyond `near_mm`; -1 for none. No Newton steps.
  int first_triangle(const Ray& ray, double near_mm) const;
  // Whether a point on the surface with that normal is seen from `eye_mm`.
  bool is_seen_from(const estimation::Vec3& eye_mm, const estimation::Vec3& point_mm,
                    const estimation::Vec3& normal) const;

 private:
  struct Embree;
  std::unique_ptr<Shape> shape_;
  Mesh mesh_;
  std::unique_ptr<Embree> embree_;
};

}  // namespace hw_sim
