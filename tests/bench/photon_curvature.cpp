#include "tests/bench/photon_curvature.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "hw_sim/photons/pixel_response.h"
#include "hw_sim/world/head_world.h"
#include "hw_sim/world/scatter_table.h"
#include "hw_sim/world/scene.h"
#include "hw_sim/world/transport.h"

namespace bench {

namespace {

using estimation::Vec3;

constexpr std::uint64_t kWorldsSeed = 20260;  // of hw_sim/world/head_light.cpp
constexpr int kSidePx = 12;                   // of the window

// All within a radius of a line along x; of no length: a ball.
class Rod final : public hw_sim::Shape {
 public:
  Rod(const Vec3& center_mm, double half_length_mm, double radius_mm)
      : center_(center_mm), half_length_mm_(half_length_mm), radius_mm_(radius_mm) {}
  double distance_mm(const Vec3& point_mm) const override {
    Vec3 offset = point_mm - center_;
    offset[0] -= std::clamp(offset[0], -half_length_mm_, half_length_mm_);
    return cv::norm(offset) - radius_mm_;
  }
  hw_sim::Box bounds() const override {
    const Vec3 reach = Vec3::all(radius_mm_ + 2) + Vec3(half_length_mm_, 0, 0);
    return {center_ - reach, center_ + reach};
  }

 private:
  Vec3 center_;
  double half_length_mm_, radius_mm_;
};

class OneSkin final : public hw_sim::SkinMap {
 public:
  explicit OneSkin(const hw_sim::Material& material) { skin_.material = material; }
  hw_sim::Skin at(const Vec3& /*point_mm*/) const override { return skin_; }

 private:
  hw_sim::Skin skin_;
};

// Near the middle of face_female's lower lip.
const Vec3 kLip_mm(5, 71, 986);
struct Lip {
  hw_sim::Material material;
  double down_radius_mm = 0, across_radius_mm = 0;
};

// Of the normal's turn along a step over the surface.
double radius_along(const hw_sim::Shape& shape, const Vec3& point, const Vec3& direction) {
  constexpr double kStepMm = 0.5;
  const Vec3 normal = hw_sim::normal_at(shape, point);
  const Vec3 flat = direction - direction.dot(normal) * normal;
  const Vec3 step = kStepMm / cv::norm(flat) * flat;
  const Vec3 turn = hw_sim::normal_at(shape, point + step) - hw_sim::normal_at(shape, point - step);
  return 2 * kStepMm * kStepMm / turn.dot(step);
}

Lip lower_lip(const estimation::Manifest& manifest, const hw_sim::Pinhole& eye,
              const hw_sim::Pinhole& lamp) {
  auto scene = hw_sim::make_scene("face_female");
  const hw_sim::Surface surface(std::move(scene->shape));
  estimation::CameraInfo camera = manifest.camera;
  const hw_sim::ProjectedPoint lip = eye.project(kLip_mm);
  camera.roi_x_px = static_cast<int>(std::lround(lip.col_px));
  camera.roi_y_px = static_cast<int>(std::lround(lip.row_px));
  camera.width_px = camera.height_px = 1;
  const auto seen = hw_sim::find_seen_points(camera, eye, lamp, kProjectorHeight, kProjectorWidth,
                                             surface, *scene->skin, 0);
  const hw_sim::SeenPoint& point = seen.points.at(0);
  return {point.skin.material, radius_along(surface.shape(), point.point_mm, Vec3(0, 1, 0)),
          radius_along(surface.shape(), point.point_mm, Vec3(1, 0, 0))};
}

}  // namespace

void show_curvature(Report& report, const WindowOptions& options) {
  const estimation::Manifest manifest = manifest_of({.name = "curvature",
                                                     .title = {},
                                                     .scene = {},
                                                     .row_px = 215,
                                                     .col_px = 293,
                                                     .height_px = kSidePx,
                                                     .width_px = kSidePx});
  const estimation::Calibration& c = manifest.calibration;
  const hw_sim::Pinhole eye(c.camera, estimation::Mat3::eye(), {0, 0, 0});
  const hw_sim::Pinhole lamp(c.projector, c.projector_from_camera, c.projector_from_camera_mm);
  const double reference_mm = *c.irradiance->reference_distance_mm;
  Table table{.name = "curvature",
              .title =
                  "A lip's material on balls and rods: the surface's transport less the "
                  "photons' level, % (standard error)",
              .columns = {"shape", "radius mm", "red", "green", "blue"}};
  tbb::task_arena(options.thread_count).execute([&] {
    const Lip lip = lower_lip(manifest, eye, lamp);
    report.text(std::string("The lower lip's middle bends with a radius of ")
                    .append(digits(lip.down_radius_mm))
                    .append(" mm downwards and ")
                    .append(digits(lip.across_radius_mm))
                    .append(" mm across."));
    const hw_sim::ScatterTable scattering = hw_sim::ScatterTable::cached(
        options.cache_folder, options.photons_per_angle, kWorldsSeed, {});
    const OneSkin skin(lip.material);
    const estimation::Image<unsigned char> white(kProjectorHeight, kProjectorWidth, 1, 255);
    const std::vector<double> lit(kProjectorWidth, 1.0);
    for (const bool is_ball : {true, false})
      for (const double radius_mm : {40.0, 20.0, 12.0, 8.0, 6.0, 4.0}) {
        const hw_sim::Surface surface(
            std::make_unique<Rod>(Vec3(0, 0, 1000 + radius_mm), is_ball ? 0 : 30, radius_mm));
        const auto seen = hw_sim::find_seen_points(manifest.camera, eye, lamp, kProjectorHeight,
                                                   kProjectorWidth, surface, skin, 0);
        const hw_sim::ProjectorLight light(surface, lamp, kProjectorHeight, kProjectorWidth,
                                           reference_mm);
        const auto transport = hw_sim::Transport::build(seen.samples, light, &scattering, {});
        const std::vector<float> by_surface = transport.reflected(white.view(), {});
        hw_sim::Box box = surface.shape().bounds();
        for (int axis = 0; axis < 3; ++axis) {
          box.low_mm[axis] = std::max(box.low_mm[axis], seen.points.front().point_mm[axis] - 20);
          box.high_mm[axis] = std::min(box.high_mm[axis], seen.points.front().point_mm[axis] + 20);
        }
        const hw_sim::ShapeGrid grid(surface.shape(), box, 0.25);
        std::array<std::unique_ptr<hw_sim::UniformMatter>, 3> matter;
        for (std::size_t band = 0; band < 3; ++band)
          matter[band] = std::make_unique<hw_sim::UniformMatter>(
              hw_sim::volume_optics(lip.material.bands[band]));
        const auto photons = hw_sim::trace_window(
            seen, surface, grid, {matter[0].get(), matter[1].get(), matter[2].get()},
            {lamp, kProjectorHeight, kProjectorWidth, reference_mm},
            {.paths_per_sample = options.paths_per_sample}, {});
        std::array<double, 3> surface_sum{}, photon_sum{}, variance{};
        for (std::size_t i = 0; i < seen.samples.size(); ++i) {
          const hw_sim::Estimate level = photons[i].lit_by(lit);
          surface_sum[seen.bands[i]] += static_cast<double>(by_surface[i]);
          photon_sum[seen.bands[i]] += level.value;
          variance[seen.bands[i]] += level.standard_error * level.standard_error;
        }
        table.rows.push_back({is_ball ? "ball" : "rod", digits(radius_mm)});
        for (std::size_t band = 0; band < 3; ++band)
          table.rows.back().push_back(
              percent(surface_sum[band] / photon_sum[band] - 1)
                  .append(" (")
                  .append(percent(std::sqrt(variance[band]) / photon_sum[band]))
                  .append(")"));
      }
  });
  report.table(table);
}

}  // namespace bench
