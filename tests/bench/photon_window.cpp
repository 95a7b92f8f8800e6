#include "tests/bench/photon_window.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iostream>
#include <sstream>
#include <variant>

#include "hw_sim/world/head_world.h"

namespace bench {

namespace {

using estimation::Axis;
using estimation::Vec3;
using hw_sim::ColumnResponse;
using hw_sim::Pinhole;
using hw_sim::SeenPoint;
using hw_sim::SeenPoints;

[[noreturn]] void stop(const std::string& why) {
  std::cerr << "photon-windows: " << why << "\n";
  std::exit(1);
}

estimation::Calibration calibration() {
  const std::filesystem::path file = SSRIG_CONFIG "/simulated_calibration.json";
  std::ifstream stream(file);
  std::stringstream text;
  text << stream.rdbuf();
  auto parsed = estimation::parse_calibration(text.str(), file.string());
  if (!parsed) stop(parsed.error().text());
  return *parsed;
}

// config/simulated.toml's camera, looking through the window.
estimation::CameraInfo camera_of(const WindowPlan& plan) {
  estimation::CameraInfo camera;
  camera.width_px = plan.width_px;
  camera.height_px = plan.height_px;
  camera.roi_x_px = plan.col_px - plan.width_px / 2;
  camera.roi_y_px = plan.row_px - plan.height_px / 2;
  camera.pixel_format = {estimation::ColorFilter::kBayerRG, 12};
  camera.black_level_dn = 64;
  camera.saturation_level_dn = 4000;
  camera.gain_e_per_dn = 4.88;
  camera.read_noise_e = 10;
  return camera;
}

// Where a pixel and its neighbour do not belong to one lit (or one dark) piece of surface.
bool breaks(const SeenPoint* a, const SeenPoint* b) {
  constexpr double kJumpMm = 4;
  if (a == nullptr || b == nullptr || a->is_lit != b->is_lit) return true;
  return std::abs(a->point_mm[2] - b->point_mm[2]) > kJumpMm;
}

// Distances to breaks, which may lie outside the window.
class Breaks {
 public:
  Breaks(const estimation::CameraInfo& wide, const SeenPoints& seen)
      : height_(wide.height_px),
        width_(wide.width_px),
        points_(static_cast<std::size_t>(height_) * static_cast<std::size_t>(width_)) {
    for (const SeenPoint& point : seen.points) at(point.row, point.col) = &point;
    for (int row = 0; row < height_; ++row)
      for (int col = 0; col < width_; ++col)
        if ((row + 1 < height_ && breaks(at(row, col), at(row + 1, col))) ||
            (col + 1 < width_ && breaks(at(row, col), at(row, col + 1))))
          places_.push_back({row + 0.5, col + 0.5});
  }

  double distance_mm(const SeenPoint& from, int row, int col) const {
    double nearest_px = kFarMm / from.pixel_mm;
    for (const auto& [break_row, break_col] : places_)
      nearest_px = std::min(nearest_px, std::hypot(break_row - row, break_col - col));
    return nearest_px * from.pixel_mm;
  }

 private:
  const SeenPoint*& at(int row, int col) {
    return points_[static_cast<std::size_t>(row) * static_cast<std::size_t>(width_) +
                   static_cast<std::size_t>(col)];
  }

  int height_, width_;
  std::vector<const SeenPoint*> points_;
  std::vector<std::array<double, 2>> places_;
};

std::vector<std::vector<double>> columns_of(const estimation::Manifest& manifest) {
  std::vector<std::vector<double>> patterns;
  for (const estimation::Pattern& pattern : manifest.patterns) {
    std::vector<double>& columns = patterns.emplace_back();
    for (int col = 0; col < kProjectorWidth; ++col)
      columns.push_back(estimation::brightness(pattern.kind, 0, col));
  }
  return patterns;
}

// The shape as far as light of the window's pixels may wander.
hw_sim::Box around(const SeenPoints& seen) {
  constexpr double kReachMm = 9, kOutsideMm = 1;
  hw_sim::Box box{Vec3::all(1e9), Vec3::all(-1e9)};
  for (const SeenPoint& point : seen.points)
    for (int axis = 0; axis < 3; ++axis) {
      box.low_mm[axis] = std::min(box.low_mm[axis], point.point_mm[axis] - kReachMm);
      box.high_mm[axis] = std::max(box.high_mm[axis], point.point_mm[axis] + kReachMm);
    }
  box.low_mm[2] += kReachMm - kOutsideMm;  // the camera's side
  return box;
}

void trace_photons(const hw_sim::Surface& surface, const hw_sim::SkinMap& skin,
                   const SeenPoints& seen, const Pinhole& lamp, const WindowOptions& options,
                   Window& window) {
  constexpr double kCellMm = 0.25;
  const std::clock_t begin = std::clock();
  const hw_sim::ShapeGrid grid(surface.shape(), around(seen), kCellMm);
  const auto matter = hw_sim::SkinMatter::bands_of(skin, grid);
  const hw_sim::Illumination light{lamp, kProjectorHeight, kProjectorWidth,
                                   *window.manifest.calibration.irradiance->reference_distance_mm};
  const std::vector<ColumnResponse> responses = trace_window(
      seen, surface, grid, {&matter[0], &matter[1], &matter[2]}, light,
      {.paths_per_sample = options.paths_per_sample, .has_indirect = options.has_indirect}, {});
  window.photon_cpu_s = static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
  window.path_count = seen.samples.size() * static_cast<std::size_t>(options.paths_per_sample);
  constexpr double kDuty = 8.0 / 40;  // of the paper's stripes
  const std::vector<double> mean_stripe(kProjectorWidth, kDuty);
  for (const ColumnResponse& response : responses)
    window.level_se.push_back(response.lit_by(mean_stripe).standard_error);
  for (const std::vector<double>& columns : columns_of(window.manifest)) {
    for (Signals* each : {&window.photons, &window.photons_se, &window.half}) each->emplace_back();
    for (const ColumnResponse& response : responses) {
      const hw_sim::Estimate lit = response.lit_by(columns);
      window.photons.back().push_back(lit.value);
      window.photons_se.back().push_back(lit.standard_error);
      double half = 0;
      for (std::size_t batch = 0; batch < ColumnResponse::kBatches; batch += 2)
        half += response.lit_by(columns, batch) * 2 / ColumnResponse::kBatches;
      window.half.back().push_back(half);
    }
  }
}

void trace_surface(const WindowOptions& options, Window& window) {
  hw_sim::SceneOptions scene;
  scene.name = window.plan.scene;
  scene.scattering = hw_sim::ScatteringModel::kMonteCarlo;
  scene.photons_per_angle = options.photons_per_angle;
  scene.has_indirect = options.has_indirect;
  scene.thread_count = options.thread_count;
  scene.cache_folder = options.cache_folder;
  const estimation::Manifest& m = window.manifest;
  const auto world = hw_sim::HeadWorld::create(m.camera, m.projector, m.calibration, scene);
  if (!world) stop(world.error().detail);
  for (const estimation::Pattern& pattern : m.patterns) {
    const hw_sim::Picture picture{
        static_cast<std::uint64_t>(pattern.index) + 1,
        estimation::render_pattern(pattern.kind, kProjectorHeight, kProjectorWidth)};
    const estimation::Image<float> image = (*world)->linear_image(picture);
    window.surface.emplace_back();
    for (const WindowPixel& pixel : window.pixels)
      window.surface.back().push_back(
          static_cast<double>(image.at(pixel.row, pixel.col)) /
          m.calibration.irradiance->signal_per_us[static_cast<std::size_t>(pixel.band)]);
  }
}

}  // namespace

estimation::Manifest manifest_of(const WindowPlan& plan) {
  estimation::Manifest manifest;
  manifest.id = plan.name;
  manifest.camera = camera_of(plan);
  manifest.projector.width_px = kProjectorWidth;
  manifest.projector.height_px = kProjectorHeight;
  manifest.calibration = calibration();
  for (const estimation::Pattern& pattern : estimation::paper_patterns()) {
    const auto varies_by_column = [](const auto& kind) {
      if constexpr (requires { kind.axis; }) return kind.axis == Axis::kColumn;
      return true;
    };
    if (std::visit(varies_by_column, pattern.kind)) manifest.patterns.push_back(pattern);
  }
  return manifest;
}

Window measure(const WindowPlan& plan, const WindowOptions& options) {
  Window window;
  window.plan = plan;
  window.manifest = manifest_of(plan);
  auto scene = hw_sim::make_scene(plan.scene);
  if (!scene) stop(scene.error().detail);
  const estimation::Calibration& c = window.manifest.calibration;
  const Pinhole eye(c.camera, estimation::Mat3::eye(), {0, 0, 0});
  const Pinhole lamp(c.projector, c.projector_from_camera, c.projector_from_camera_mm);
  tbb::task_arena(options.thread_count).execute([&] {
    const hw_sim::Surface surface(std::move(scene->shape));
    const auto look = [&](const estimation::CameraInfo& camera) {
      return hw_sim::find_seen_points(camera, eye, lamp, kProjectorHeight, kProjectorWidth, surface,
                                      *scene->skin, 0);
    };
    constexpr int kMarginPx = 30;
    estimation::CameraInfo wide = window.manifest.camera;
    wide.width_px += 2 * kMarginPx;
    wide.height_px += 2 * kMarginPx;
    wide.roi_x_px -= kMarginPx;
    wide.roi_y_px -= kMarginPx;
    const SeenPoints around_it = look(wide);
    const Breaks breaks(wide, around_it);
    const SeenPoints seen = look(window.manifest.camera);
    for (std::size_t i = 0; i < seen.points.size(); ++i) {
      const SeenPoint& point = seen.points[i];
      window.pixels.push_back(
          {.row = point.row,
           .col = point.col,
           .band = seen.bands[i],
           .scattering = seen.samples[i].scattering,
           .is_inside = point.skin.region == plan.inside,
           .border_distance_mm = std::min(point.skin.border_distance_mm, kFarMm),
           .break_distance_mm =
               breaks.distance_mm(point, point.row + kMarginPx, point.col + kMarginPx),
           .cos_projector = point.cos_projector,
           .is_lit = point.is_lit});
    }
    trace_photons(surface, *scene->skin, seen, lamp, options, window);
  });
  trace_surface(options, window);
  return window;
}

}  // namespace bench
