#include "estimation/calibration/geometry_pictures.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "estimation/calibration/chart.h"
#include "estimation/calibration/report_page.h"

namespace estimation {
namespace {

constexpr double kDegree = CV_PI / 180;

double value_of(const GeometryFit& fit, std::size_t parameter) {
  const auto of_lens = [](const Lens& lens, std::size_t at) {
    if (at >= 4) return lens.distortion[at - 4];
    return std::array{lens.K(0, 0), lens.K(1, 1), lens.K(0, 2), lens.K(1, 2)}[at];
  };
  const Calibration& c = fit.calibration;
  if (parameter < 9) return of_lens(c.camera, parameter);
  if (parameter < 18) return of_lens(c.projector, parameter - 9);
  if (parameter >= 21) return c.projector_from_camera_mm[static_cast<int>(parameter - 21)];
  Vec3 vector;
  cv::Rodrigues(c.projector_from_camera, vector);
  return vector[static_cast<int>(parameter - 18)];
}

const char* unit_of(std::size_t parameter) {
  if (parameter >= 21) return "mm";
  if (parameter >= 18) return "rad";
  return parameter % 9 < 4 ? "px" : "";
}

plot::Canvas draw_errors(const GeometryFit& fit) {
  Chart chart{"Reprojection error of each pose", "pose", "px rms", {}, true};
  ChartSeries camera{"camera", kBlueInk, false, {}}, projector{"projector", kRedInk, false, {}};
  for (std::size_t i = 0; i < fit.poses.size(); ++i) {
    const auto x = static_cast<double>(i + 1);
    camera.points.emplace_back(x, fit.poses[i].camera_rms_px);
    projector.points.emplace_back(x, fit.poses[i].projector_rms_px);
  }
  chart.series = {camera, projector};
  return draw_chart(chart);
}

struct Corner {
  Vec2 px, error_px;
};

// Corners on the picture's area with their residuals drawn out `gain` times.
plot::Canvas draw_corners(const std::string& title, const std::vector<Corner>& corners,
                          int width_px, int height_px, plot::Color color) {
  constexpr int kWidth = 760, kTop = 70, kMargin = 20;
  const double scale = static_cast<double>(kWidth - 2 * kMargin) / width_px;
  const int height = static_cast<int>(height_px * scale);
  plot::Canvas canvas(height + kTop + kMargin, kWidth, plot::kWhite);
  double squares = 0;
  for (const Corner& corner : corners) squares += corner.error_px.dot(corner.error_px);
  const double rms = corners.empty() ? 0 : std::sqrt(squares / static_cast<double>(corners.size()));
  // A residual of the usual size is drawn 12 px long.
  const double gain = rms > 0 ? 12 / (rms * scale) : 1;
  std::string caption;
  print(caption, "%zu corners on %d x %d px, %.3f px rms; residuals drawn %.0f times as long",
        corners.size(), width_px, height_px, rms, gain);
  plot::draw_text(canvas, title, {kMargin, 30}, 0.6, plot::kInk);
  plot::draw_text(canvas, caption, {kMargin, 54}, 0.42, plot::kFaintInk);
  cv::rectangle(canvas, {kMargin, kTop, kWidth - 2 * kMargin, height},
                plot::scalar(plot::kFaintInk));
  for (int i = 1; i < Coverage::kCols; ++i) {
    const int x = kMargin + (kWidth - 2 * kMargin) * i / Coverage::kCols;
    cv::line(canvas, {x, kTop}, {x, kTop + height}, plot::scalar(plot::kGrid));
  }
  for (int i = 1; i < Coverage::kRows; ++i) {
    const int y = kTop + height * i / Coverage::kRows;
    cv::line(canvas, {kMargin, y}, {kWidth - kMargin, y}, plot::scalar(plot::kGrid));
  }
  for (const Corner& corner : corners) {
    const cv::Point2d at(kMargin + corner.px[0] * scale, kTop + corner.px[1] * scale);
    const cv::Point2d end =
        at + cv::Point2d(corner.error_px[0] * gain * scale, corner.error_px[1] * gain * scale);
    cv::line(canvas, at, end, plot::scalar(color), 1, cv::LINE_AA);
    cv::circle(canvas, at, 2, plot::scalar(plot::kInk), cv::FILLED, cv::LINE_AA);
  }
  return canvas;
}

}  // namespace

std::string describe_geometry(const GeometryFit& fit, const GeometryCheck& check) {
  std::string text;
  print(text, "poses: %zu, camera %.3f px rms, projector %.3f px rms\n", fit.poses.size(),
        fit.camera_rms_px, fit.projector_rms_px);
  print(text, "noise of one coordinate: camera %.3f px, projector %.3f px beside the camera's\n",
        fit.camera_noise_px, fit.projector_noise_px);
  print(text, "rotation known to %.4f degrees, translation to %.3f mm, a depth to %.3f mm\n",
        fit.rotation_sd_deg(), fit.translation_sd_mm(), check.depth_sd_mm);
  print(text, "corners cover %.0f%% of the camera's picture and %.0f%% of the projector's\n",
        100 * check.camera.covered_frac, 100 * check.projector.covered_frac);
  print(text,
        "tilts: %.0f degrees between poses at most, spread %.1f degrees; %.0f to %.0f mm away\n",
        check.largest_tilt_deg, check.tilt_spread_deg, check.nearest_mm, check.farthest_mm);
  int name_width = 4;
  for (const PoseFit& pose : fit.poses)
    name_width = std::max(name_width, static_cast<int>(pose.name.size()));
  print(text, "\n%-*s %8s %8s %14s %17s %9s\n", name_width, "pose", "corners", "lit",
        "camera, px rms", "projector, px rms", "tilt, deg");
  for (const PoseFit& pose : fit.poses)
    print(text, "%-*s %8d %8d %14.3f %17.3f %9.0f\n", name_width, pose.name.c_str(),
          pose.corner_count, pose.lit_corner_count, pose.camera_rms_px, pose.projector_rms_px,
          std::acos(std::clamp(-pose.normal[2], -1.0, 1.0)) / kDegree);
  print(text, "\n%-16s %12s %10s  unit\n", "parameter", "value", "sd");
  for (std::size_t i = 0; i < kGeometryParameterCount; ++i)
    if (fit.sd(i) > 0)
      print(text, "%-16s %12.6g %10.2g  %s\n", kGeometryParameterNames[i], value_of(fit, i),
            fit.sd(i), unit_of(i));
  return text;
}

Result<void> draw_geometry(const std::filesystem::path& folder, const GeometryFit& fit,
                           const CameraInfo& camera, const ProjectorInfo& projector) {
  std::vector<Corner> seen, lit;
  for (const PoseFit& pose : fit.poses)
    for (const PoseFit::Residual& r : pose.residuals) {
      seen.push_back({r.camera_px - Vec2(camera.roi_x_px, camera.roi_y_px), r.camera_error_px});
      if (r.has_projector) lit.push_back({r.projector_px, r.projector_error_px});
    }
  try {
    if (const auto saved = save_picture(folder, "pose_errors.png", draw_errors(fit)); !saved)
      return saved;
    if (const auto saved = save_picture(folder, "camera_coverage.png",
                                        draw_corners("Corners in the camera's picture", seen,
                                                     camera.width_px, camera.height_px, kBlueInk));
        !saved)
      return saved;
    return save_picture(folder, "projector_coverage.png",
                        draw_corners("Corners in the projector's picture", lit, projector.width_px,
                                     projector.height_px, kRedInk));
  } catch (const cv::Exception& problem) {
    return tl::unexpected(InputError{InputFault::kInvalid, folder.string(), "",
                                     "a picture could not be drawn: " + problem.msg});
  }
}

}  // namespace estimation
