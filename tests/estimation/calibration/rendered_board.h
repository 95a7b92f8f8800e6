// Pictures of a board under projected patterns: through both lenses, blurred by both, with noise.
// Rays and projections are OpenCV's own.
#pragma once

#include <functional>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "tests/estimation/calibration/synthetic_board.h"

namespace estimation::testing {

// Reflectance at a point of the board's plane, mm from its first inner corner.
using Albedo = std::function<double(double x_mm, double y_mm)>;

inline constexpr double kPaper = 0.8, kInkOfBoard = 0.04;

// As many squares as `shape` has inner corners and one more, a white border around, air beyond.
inline Albedo checkerboard(const BoardShape& shape) {
  return [shape](double x_mm, double y_mm) {
    const double x = x_mm / shape.square_mm + 1, y = y_mm / shape.square_mm + 1;
    if (x < -1 || y < -1 || x > shape.cols + 2 || y > shape.rows + 2) return 0.002;
    if (x < 0 || y < 0 || x > shape.cols + 1 || y > shape.rows + 1) return kPaper;
    const bool is_black = (static_cast<int>(x) + static_cast<int>(y)) % 2 == 0;
    return is_black ? kInkOfBoard : kPaper;
  };
}

struct RenderSettings {
  double projector_blur_px = 0.8, camera_blur_px = 0.8;
  double signal = 1000;  // of a white reflector under white
  double black = 2;      // under a black pattern
  double shot = 0.5;     // variance per signal
  double read_sd = 3;
  std::uint64_t seed = 1;
  std::array<double, 4> site_gain{1, 1, 1, 1};
};

// One pose: where each camera pixel's ray meets the board, prepared once.
class RenderedPose {
 public:
  RenderedPose(const SyntheticRig& rig, const RigidPlace& place, const Albedo& albedo,
               const RenderSettings& settings)
      : rig_(rig), settings_(settings), random_(settings.seed) {
    const int width = rig.camera.width_px, height = rig.camera.height_px;
    albedo_ = cv::Mat1f(height, width, 0.0F);
    column_ = cv::Mat1f(height, width);
    row_ = cv::Mat1f(height, width);
    const Vec3 normal(place.rotation(0, 2), place.rotation(1, 2), place.rotation(2, 2));
    const auto meet = [&](const cv::Point2d& ray) {
      const Vec3 direction(ray.x, ray.y, 1);
      return Vec3(direction * (normal.dot(place.translation_mm) / normal.dot(direction)));
    };
    const std::vector<cv::Point2d> rays = rays_of(width, height);
    std::vector<cv::Point3d> points;
    for (const cv::Point2d& ray : rays) points.emplace_back(meet(ray));
    const std::vector<cv::Point2d> lit = project(points);
    const auto on_board = [&](int row, int col) {
      const int i = std::min(row, height - 1) * width + std::min(col, width - 1);
      const Vec3 point(points[static_cast<std::size_t>(i)]);
      const Vec3 on = place.rotation.t() * (point - place.translation_mm);
      return Vec2(on[0], on[1]);
    };
    for (int row = 0; row < height; ++row)
      for (int col = 0; col < width; ++col) {
        const cv::Point2d& at = lit[static_cast<std::size_t>(row * width + col)];
        column_(row, col) = static_cast<float>(at.x);
        row_(row, col) = static_cast<float>(at.y);
        const Vec2 middle = on_board(row, col);
        const Vec2 by_col = on_board(row, col + 1) - middle;
        const Vec2 by_row = on_board(row + 1, col) - middle;
        albedo_(row, col) = mean_albedo(albedo, middle, by_col, by_row);
      }
  }

  // Of each camera pixel: reflectance of what it sees, and where the projector lights that.
  const cv::Mat1f& albedo() const { return albedo_; }
  const cv::Mat1f& column_px() const { return column_; }
  const cv::Mat1f& row_px() const { return row_; }

  Image<float> frame(const PatternKind& kind) {
    const Axis axis = axis_of(kind);
    const std::vector<float> line = blurred_line(kind, axis);
    const bool is_even = std::holds_alternative<White>(kind) || std::holds_alternative<Black>(kind);
    const float level = std::holds_alternative<White>(kind) ? 1 : 0;
    cv::Mat1f picture(albedo_.size());
    for (int row = 0; row < picture.rows; ++row)
      for (int col = 0; col < picture.cols; ++col) {
        const float u = column_(row, col), v = row_(row, col);
        const bool is_lit = u > -0.5F && v > -0.5F &&
                            u < static_cast<float>(rig_.projector.width_px) - 0.5F &&
                            v < static_cast<float>(rig_.projector.height_px) - 0.5F;
        const float light =
            !is_lit ? 0 : (is_even ? level : sample(line, axis == Axis::kColumn ? u : v));
        picture(row, col) = albedo_(row, col) * (static_cast<float>(settings_.signal) * light +
                                                 static_cast<float>(is_lit ? settings_.black : 0));
      }
    if (settings_.camera_blur_px > 0)
      cv::GaussianBlur(picture, picture, {}, settings_.camera_blur_px);
    Image<float> result(picture.rows, picture.cols);
    for (int row = 0; row < picture.rows; ++row)
      for (int col = 0; col < picture.cols; ++col) {
        const double signal =
            static_cast<double>(picture(row, col)) *
            settings_.site_gain[static_cast<std::size_t>(2 * (row % 2) + col % 2)];
        const double sd =
            std::sqrt(settings_.read_sd * settings_.read_sd + settings_.shot * signal);
        result.at(row, col) = static_cast<float>(signal + sd * deviate());
      }
    return result;
  }

 private:
  static constexpr int kFine = 16;  // samples a projector pixel of a pattern's profile

  static float mean_albedo(const Albedo& albedo, const Vec2& middle, const Vec2& by_col,
                           const Vec2& by_row) {
    constexpr int kParts = 4;
    double sum = 0;
    for (int i = 0; i < kParts * kParts; ++i) {
      // In rows and columns of their own: an edge along a row crosses 16 of them, not four at once.
      const int row = i / kParts, col = i % kParts;
      const double x = (col + (row + 0.5) / kParts) / kParts - 0.5;
      const double y = (row + (col + 0.5) / kParts) / kParts - 0.5;
      const Vec2 at = middle + x * by_col + y * by_row;
      sum += albedo(at[0], at[1]);
    }
    return static_cast<float>(sum / (kParts * kParts));
  }

  std::vector<cv::Point2d> rays_of(int width, int height) const {
    std::vector<cv::Point2d> pixels, rays;
    for (int row = 0; row < height; ++row)
      for (int col = 0; col < width; ++col) pixels.emplace_back(col, row);
    const Lens& lens = rig_.calibration.camera;
    const std::vector<double> distortion(lens.distortion.begin(), lens.distortion.end());
    cv::undistortPoints(pixels, rays, cv::Mat(lens.K), distortion);
    return rays;
  }

  std::vector<cv::Point2d> project(const std::vector<cv::Point3d>& points) const {
    const Calibration& c = rig_.calibration;
    Vec3 rotation;
    cv::Rodrigues(c.projector_from_camera, rotation);
    const std::vector<double> distortion(c.projector.distortion.begin(),
                                         c.projector.distortion.end());
    std::vector<cv::Point2d> pixels;
    cv::projectPoints(points, rotation, c.projector_from_camera_mm, cv::Mat(c.projector.K),
                      distortion, pixels);
    return pixels;
  }

  std::vector<float> blurred_line(const PatternKind& kind, Axis axis) const {
    if (std::holds_alternative<White>(kind) || std::holds_alternative<Black>(kind)) return {};
    const int size = axis == Axis::kColumn ? rig_.projector.width_px : rig_.projector.height_px;
    const BlurredPattern pattern(kind, settings_.projector_blur_px, size);
    std::vector<float> line;
    for (int i = 0; i <= size * kFine; ++i)
      line.push_back(static_cast<float>(pattern.at((i + 0.0) / kFine - 0.5)));
    return line;
  }

  static float sample(const std::vector<float>& line, float position_px) {
    const float at = (position_px + 0.5F) * kFine;
    const auto i = static_cast<std::size_t>(at);
    if (i + 1 >= line.size()) return line.back();
    return std::lerp(line[i], line[i + 1], at - static_cast<float>(i));
  }

  // Nearly normal: the sum of four uniform numbers, of variance 1.
  double deviate() {
    const std::uint64_t bits = random_();
    double sum = 0;
    for (int i = 0; i < 4; ++i) sum += static_cast<double>(bits >> (16 * i) & 0xffff) / 65536 - 0.5;
    return sum * std::sqrt(3.0);
  }

  const SyntheticRig& rig_;
  RenderSettings settings_;
  std::mt19937_64 random_;
  cv::Mat1f albedo_, column_, row_;
};

// Frames of all patterns of one pose; signals() borrows from them.
class RenderedFrames {
 public:
  RenderedFrames(RenderedPose pose, std::vector<PatternKind> kinds) : kinds_(std::move(kinds)) {
    for (const PatternKind& kind : kinds_) frames_.push_back(pose.frame(kind));
  }
  std::vector<PatternSignal> signals() const {
    std::vector<PatternSignal> signals;
    for (std::size_t i = 0; i < kinds_.size(); ++i)
      signals.push_back({&kinds_[i], frames_[i].view()});
    return signals;
  }

 private:
  std::vector<PatternKind> kinds_;
  std::vector<Image<float>> frames_;
};

// White and the paper's Gray code and fine stripes of both axes.
inline std::vector<PatternKind> board_kinds() {
  std::vector<PatternKind> kinds{White{}};
  for (const PatternKind& kind : paper_kinds()) {
    const auto* stripes = std::get_if<Stripes>(&kind);
    if (!stripes || stripes->period_px == 16) kinds.push_back(kind);
  }
  return kinds;
}

}  // namespace estimation::testing
