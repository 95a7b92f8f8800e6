// What the head is made of, geometrically: a smooth implicit surface, negative inside, made by the
// program. Every shape is in camera coordinates (mm).
#pragma once

#include <memory>
#include <string>

#include "estimation/base/linear.h"

namespace hw_sim {

struct Box {
  estimation::Vec3 low_mm;
  estimation::Vec3 high_mm;
};

// Immutable, so thread-safe.
class Shape {
 public:
  virtual ~Shape() = default;
  // Signed and close to a distance near the surface; continuously differentiable there.
  virtual double distance_mm(const estimation::Vec3& point_mm) const = 0;
  // Holds all of the surface that camera or projector can see.
  virtual Box bounds() const = 0;
};

// The outward unit normal at a point on (or near) the surface.
estimation::Vec3 normal_at(const Shape& shape, const estimation::Vec3& point_mm);

// A mannequin's head, its face towards -z, about 155 mm wide and 200 mm tall.
struct HeadProportions {
  double jaw_width_mm = 23;
  double chin_mm = 15;  // radius
  double brow_mm = 6.0;
  double nose_width_mm = 6.5;
  double nose_length_mm = 20;  // tip in front of the face
  double lip_mm = 4.6;
  double neck_mm = 44;
};
std::unique_ptr<Shape> make_head(const HeadProportions& proportions,
                                 const estimation::Vec3& center_mm);

// A slab's lit face: a disc-free plane of the given half size with rounded rims, turned by
// `tilt_rad` about the vertical axis (positive: its right side is farther away).
std::unique_ptr<Shape> make_slab(const estimation::Vec3& center_mm, double half_width_mm,
                                 double half_height_mm, double tilt_rad);

// Two slabs like an open book that faces the camera, `width_mm` x twice the half height each, with
// their faces meeting along the vertical line through `spine_mm`, each turned by `tilt_rad`.
std::unique_ptr<Shape> make_wedge(const estimation::Vec3& spine_mm, double width_mm,
                                  double half_height_mm, double tilt_rad);

std::unique_ptr<Shape> make_sphere(const estimation::Vec3& center_mm, double radius_mm);

}  // namespace hw_sim
