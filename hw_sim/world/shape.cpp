#include "hw_sim/world/shape.h"

#include <algorithm>
#include <cmath>

namespace hw_sim {

using estimation::Vec3;

namespace {

double ellipsoid(const Vec3& p, const Vec3& center, const Vec3& radii) {
  const Vec3 q = p - center;
  const Vec3 a(q[0] / radii[0], q[1] / radii[1], q[2] / radii[2]);
  const Vec3 b(a[0] / radii[0], a[1] / radii[1], a[2] / radii[2]);
  const double k0 = cv::norm(a), k1 = cv::norm(b);
  return k1 < 1e-9 ? -std::min({radii[0], radii[1], radii[2]}) : k0 * (k0 - 1) / k1;
}

// A round cone from a to b, radius from ra to rb.
double cone(const Vec3& p, const Vec3& a, const Vec3& b, double ra, double rb) {
  const Vec3 pa = p - a, ba = b - a;
  const double h = std::clamp(pa.dot(ba) / ba.dot(ba), 0.0, 1.0);
  const double smooth = h * h * (3 - 2 * h);
  return cv::norm(pa - ba * h) - (ra + (rb - ra) * smooth);
}

// Cubic smooth minimum: twice continuously differentiable.
double blend(double a, double b, double k) {
  const double h = std::max(k - std::abs(a - b), 0.0) / k;
  return std::min(a, b) - h * h * h * k / 6;
}

double carve(double a, double b, double k) { return -blend(-a, b, k); }

class Head final : public Shape {
 public:
  Head(const HeadProportions& proportions, const Vec3& center_mm)
      : with_(proportions), center_(center_mm) {}

  double distance_mm(const Vec3& point_mm) const override {
    Vec3 p = point_mm - center_;
    double d = skull(p);
    // Features come in pairs: mirrored by an |x| that is rounded at 0, so that no ridge runs down
    // the middle of the face.
    constexpr double kRoundedMm = 3;
    const Vec3 half(std::sqrt(p[0] * p[0] + kRoundedMm * kRoundedMm), p[1], p[2]);
    d = cheeks_and_jaw(d, p, half);
    // A feature reaches no farther than its radius and blend: skip what is away from it.
    if (p[2] < -30) {
      if (p[1] > -50 && p[1] < 40) d = eyes(d, half);
      if (half[0] < 42 && p[1] > -40 && p[1] < 66) d = nose(d, p, half);
      if (half[0] < 60 && p[1] > 24 && p[1] < 98) d = mouth(d, p, half);
    }
    return half[0] > 45 ? ears(d, half) : d;
  }

  Box bounds() const override {
    return {center_ + Vec3(-88, -112, -118), center_ + Vec3(88, 140, 40)};
  }

 private:
  double skull(const Vec3& p) const {
    double d = ellipsoid(p, {0, -28, 14}, {71, 75, 88});
    d = blend(d, ellipsoid(p, {0, 22, -10}, {60, 76, 66}), 30);
    return blend(d, cone(p, {0, 60, 22}, {0, 170, 42}, with_.neck_mm, with_.neck_mm + 6), 24);
  }
  double cheeks_and_jaw(double d, const Vec3& p, const Vec3& half) const {
    d = blend(d, ellipsoid(half, {36, 20, -46}, {21, 16, 20}), 22);
    d = blend(d, ellipsoid(half, {with_.jaw_width_mm, 62, -38}, {24, 25, 26}), 26);
    return blend(d, ellipsoid(p, {0, 82, -57}, {with_.chin_mm + 4, with_.chin_mm, with_.chin_mm}),
                 20);
  }
  double eyes(double d, const Vec3& half) const {
    const double brow = cone(half, {10, -14, -70}, {46, -9, -42}, with_.brow_mm, 2.5);
    d = blend(d, brow, 18);
    d = carve(d, ellipsoid(half, {30, 3, -83}, {19, 13, 17}), 16);
    const double eyeball = ellipsoid(half, {30, 3.5, -60.5}, {13.5, 10, 12.5});
    d = blend(d, eyeball, 6);
    // The slit between closed lids: an arc below the eyeball's middle.
    return carve(d, cone(half, {20, 5.5, -72}, {41, 6, -70.5}, 1.0, 0.8), 3.5);
  }
  double nose(double d, const Vec3& p, const Vec3& half) const {
    const double tip_z = -76 - with_.nose_length_mm;
    d = blend(d, cone(p, {0, -12, -71}, {0, 31, tip_z + 6}, 5, with_.nose_width_mm + 1), 14);
    d = blend(d, ellipsoid(p, {0, 33, tip_z + 6}, {9, 7.5, 8.5}), 9);
    const Vec3 wing(with_.nose_width_mm + 2, 36.5, tip_z + 16);
    d = blend(d, ellipsoid(half, wing, {6, 5.6, 9}), 13);
    return carve(d, ellipsoid(half, {5.6, 43, tip_z + 11}, {2.6, 3.6, 4.5}), 4);
  }
  double mouth(double d, const Vec3& p, const Vec3& half) const {
    d = blend(d, ellipsoid(p, {0, 62, -62}, {26, 18, 18}), 18);
    const double upper = cone(half, {4, 58.2, -79}, {22, 63, -69.5}, with_.lip_mm, 1.8);
    const double lower = cone(half, {0, 67.5, -78.5}, {20, 64, -70.5}, with_.lip_mm + 1, 1.8);
    d = blend(d, upper, 5);
    d = blend(d, lower, 5);
    d = carve(d, cone(half, {0, 62.8, -85.5}, {24, 63.8, -73}, 2.0, 0.8), 3.5);
    // The groove between nose and lip.
    return carve(d, cone(p, {0, 46, -86}, {0, 53, -86.5}, 2.2, 2.2), 6);
  }
  static double ears(double d, const Vec3& half) {
    d = blend(d, ellipsoid(half, {71, 8, 14}, {6.5, 27, 15}), 8);
    return carve(d, ellipsoid(half, {78, 6, 6}, {4, 15, 8}), 6);
  }

  HeadProportions with_;
  Vec3 center_;
};

class Slab final : public Shape {
 public:
  Slab(const Vec3& center_mm, double half_width_mm, double half_height_mm, double tilt_rad)
      : center_(center_mm),
        half_(half_width_mm, half_height_mm, kHalfDepth),
        right_(std::cos(tilt_rad), 0, std::sin(tilt_rad)),
        back_(-std::sin(tilt_rad), 0, std::cos(tilt_rad)) {}

  double distance_mm(const Vec3& point_mm) const override {
    const Vec3 p = point_mm - center_;
    const Vec3 q(std::abs(p.dot(right_)) - half_[0] + kRim, std::abs(p[1]) - half_[1] + kRim,
                 std::abs(p.dot(back_) - kHalfDepth) - half_[2] + kRim);
    const Vec3 outside(std::max(q[0], 0.0), std::max(q[1], 0.0), std::max(q[2], 0.0));
    return cv::norm(outside) + std::min(std::max({q[0], q[1], q[2]}), 0.0) - kRim;
  }
  Box bounds() const override {
    const double reach = half_[0] + 3 * kHalfDepth;
    const Vec3 corner(reach, half_[1] + 3 * kHalfDepth, reach);
    return {center_ - corner, center_ + corner};
  }

 private:
  static constexpr double kHalfDepth = 6;
  static constexpr double kRim = 3;
  Vec3 center_, half_, right_, back_;
};

class Wedge final : public Shape {
 public:
  Wedge(const Vec3& spine_mm, double width_mm, double half_height_mm, double tilt_rad)
      : spine_(spine_mm),
        half_size_(width_mm * std::cos(tilt_rad) + kReach, half_height_mm + kReach,
                   width_mm * std::sin(tilt_rad) + kReach),
        // A page reaches a little beyond the spine, so that its rounded rim lies inside the other.
        left_(page(-1, width_mm, half_height_mm, tilt_rad)),
        right_(page(1, width_mm, half_height_mm, tilt_rad)) {}

  double distance_mm(const Vec3& point_mm) const override {
    return blend(left_.distance_mm(point_mm), right_.distance_mm(point_mm), kFilletMm);
  }
  Box bounds() const override { return {spine_ - half_size_, spine_ + half_size_}; }

 private:
  static constexpr double kReach = 20;
  static constexpr double kBeyondSpineMm = 6;
  static constexpr double kFilletMm = 1;

  Slab page(int side, double width_mm, double half_height_mm, double tilt_rad) const {
    const Vec3 outward(side * std::cos(tilt_rad), 0, -std::sin(tilt_rad));
    const double half_mm = (width_mm + kBeyondSpineMm) / 2;
    return {spine_ + (half_mm - kBeyondSpineMm) * outward, half_mm, half_height_mm,
            -side * tilt_rad};
  }

  Vec3 spine_, half_size_;
  Slab left_, right_;
};

class Sphere final : public Shape {
 public:
  Sphere(const Vec3& center_mm, double radius_mm) : center_(center_mm), radius_mm_(radius_mm) {}
  double distance_mm(const Vec3& point_mm) const override {
    return cv::norm(point_mm - center_) - radius_mm_;
  }
  Box bounds() const override {
    const Vec3 corner = Vec3::all(radius_mm_ + 3);
    return {center_ - corner, center_ + corner};
  }

 private:
  Vec3 center_;
  double radius_mm_;
};

}  // namespace

Vec3 normal_at(const Shape& shape, const Vec3& point_mm) {
  // Central differences: exact to (h / radius of curvature)^2, 1e-6 at the sharpest feature.
  constexpr double kStep = 2e-3;
  Vec3 gradient;
  for (int axis = 0; axis < 3; ++axis) {
    Vec3 step(0, 0, 0);
    step[axis] = kStep;
    gradient[axis] = shape.distance_mm(point_mm + step) - shape.distance_mm(point_mm - step);
  }
  return gradient / cv::norm(gradient);
}

std::unique_ptr<Shape> make_head(const HeadProportions& proportions, const Vec3& center_mm) {
  return std::make_unique<Head>(proportions, center_mm);
}

std::unique_ptr<Shape> make_slab(const Vec3& center_mm, double half_width_mm, double half_height_mm,
                                 double tilt_rad) {
  return std::make_unique<Slab>(center_mm, half_width_mm, half_height_mm, tilt_rad);
}

std::unique_ptr<Shape> make_wedge(const Vec3& spine_mm, double width_mm, double half_height_mm,
                                  double tilt_rad) {
  return std::make_unique<Wedge>(spine_mm, width_mm, half_height_mm, tilt_rad);
}

std::unique_ptr<Shape> make_sphere(const Vec3& center_mm, double radius_mm) {
  return std::make_unique<Sphere>(center_mm, radius_mm);
}

}  // namespace hw_sim
