#include "estimation/geometry/surface.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "estimation/base/check.h"
#include "estimation/geometry/smoothing.h"
#include "estimation/geometry/triangulation.h"

namespace estimation {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
// Of the normals, by one pixel's noise, radians. Phases on skin stay below it by themselves; whole
// columns of Gray code alone err together, so that their normals still err a few degrees.
constexpr double kMaxTiltNoise = 0.02;
constexpr int kMaxRadiusPx = 40;  // a window wider than this is not local on any camera of ours

template <typename Body>
void for_rows(int height_px, const Body& body) {
  oneapi::tbb::parallel_for(oneapi::tbb::blocked_range<int>(0, height_px, 4),
                            [&](const oneapi::tbb::blocked_range<int>& range) {
                              for (int row = range.begin(); row < range.end(); ++row) body(row);
                            });
}

// As triangulated, pixel by pixel; NaN where there is no point.
struct RawDepth {
  Image<float> inverse_per_mm;
  Image<float> relative_sd;
};

ProjectorReading reading_at(const Correspondence& correspondence, int row, int col) {
  ProjectorReading reading;
  const auto is_told = [&](const Image<float>& position_px) {
    return !position_px.empty() && !std::isnan(position_px.at(row, col));
  };
  if (is_told(correspondence.column_px)) {
    reading.column_px = double{correspondence.column_px.at(row, col)};
    reading.column_sd_px = double{correspondence.column_sd_px.at(row, col)};
  }
  if (is_told(correspondence.row_px)) {
    reading.row_px = double{correspondence.row_px.at(row, col)};
    reading.row_sd_px = double{correspondence.row_sd_px.at(row, col)};
  }
  return reading;
}

// A coarse reading, as of Gray code without its low bits, may disagree by its own coarseness.
double max_epipolar_px(const SurfaceOptions& options, const ProjectorReading& reading) {
  const auto variance_px2 = [](double sd_px) { return std::isfinite(sd_px) ? sd_px * sd_px : 0; };
  return options.max_epipolar_px +
         2 * std::sqrt(variance_px2(reading.column_sd_px) + variance_px2(reading.row_sd_px));
}

double max_depth_sd_mm(const SurfaceOptions& options, const Stereo::Ray& ray, double depth_mm) {
  return std::max(options.max_position_sd_mm / cv::norm(ray.direction),
                  options.max_position_sd_frac * depth_mm);
}

// Where both axes are decoded the correspondence has left the square out; with one alone, the point
// itself tells where it is lit from.
bool is_in_sync_square(const Stereo& stereo, const ProjectorInfo& projector,
                       const ProjectorReading& reading, const Vec3& point_mm) {
  const bool has_both = std::isfinite(reading.column_sd_px) && std::isfinite(reading.row_sd_px);
  if (!projector.sync_square || has_both) return false;
  const auto lit = stereo.project(point_mm);
  return lit && projector.sync_square->contains(static_cast<int>(std::lround(lit->pixel[1])),
                                                static_cast<int>(std::lround(lit->pixel[0])));
}

RawDepth triangulate_image(const Stereo& stereo, const ProjectorInfo& projector,
                           const Correspondence& correspondence, const SurfaceOptions& options,
                           Image<std::uint32_t>& validity) {
  const int height = validity.height_px(), width = validity.width_px();
  RawDepth raw{Image<float>(height, width, 1, kNaN), Image<float>(height, width, 1, kNaN)};
  for_rows(height, [&](int row) {
    for (int col = 0; col < width; ++col) {
      if (validity.at(row, col) & kValidityErrors) continue;
      const auto ray = stereo.ray(row, col);
      std::optional<Stereo::Depth> depth;
      const ProjectorReading reading = reading_at(correspondence, row, col);
      if (ray) depth = stereo.triangulate(*ray, reading);
      if (!depth || depth->epipolar_px > max_epipolar_px(options, reading) ||
          depth->sd_mm > max_depth_sd_mm(options, *ray, depth->depth_mm) ||
          is_in_sync_square(stereo, projector, reading, ray->direction * depth->depth_mm)) {
        validity.at(row, col) |= kNoCorrespondence;
        continue;
      }
      raw.inverse_per_mm.at(row, col) = static_cast<float>(1 / depth->depth_mm);
      raw.relative_sd.at(row, col) = static_cast<float>(depth->sd_mm / depth->depth_mm);
    }
  });
  return raw;
}

// Of the values that are there, every seventh looked at; 0 if none is.
double median_of(const Image<float>& image) {
  constexpr std::size_t kStride = 7;
  std::vector<float> values;
  for (std::size_t i = 0; i < image.samples().size(); i += kStride)
    if (!std::isnan(image.samples()[i])) values.push_back(image.samples()[i]);
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return double{*middle};
}

// The window whose normals are quiet enough: a least-squares slope under the window's Gaussian has
// 0.8 / radius^2 of one pixel's noise.
double quiet_radius_px(const RawDepth& raw, double focal_px) {
  constexpr double kSlopeGain = 0.8;
  return std::sqrt(kSlopeGain * median_of(raw.relative_sd) * focal_px / kMaxTiltNoise);
}

FitOptions fit_options(const SurfaceOptions& options, const RawDepth& raw, double focal_px) {
  // On a surface that faces the camera, at the median depth.
  const double px_per_mm = median_of(raw.inverse_per_mm) * focal_px;
  const auto rounded = [](double radius_px) {
    return static_cast<int>(std::lround(std::clamp(radius_px, 1.0, double{kMaxRadiusPx})));
  };
  const double smoothing_px = options.smoothing_radius_mm * px_per_mm;
  const double radius_px =
      smoothing_px > 0 ? std::max(smoothing_px, quiet_radius_px(raw, focal_px)) : 0;
  constexpr double kNoWindowPx = 0.5;  // that bends and noise ask for
  return {radius_px < kNoWindowPx ? 0 : rounded(radius_px), options.max_slope / focal_px,
          rounded(options.near_discontinuity_mm * px_per_mm)};
}

// Towards the camera. On a plane n . X = d inverse depth is n . (x, y, 1) / d, so its derivatives
// by x and y, and its value less both, are the normal's direction.
Vec3 normal_of(const Stereo::Ray& ray, double inverse_per_mm, double by_col, double by_row) {
  // Derivatives by px turned into those by the normalised coordinates x, y.
  const Vec2 by_xy = ray.normalized_by_pixel.inv().t() * Vec2(by_col, by_row);
  const Vec3 direction(by_xy[0], by_xy[1],
                       inverse_per_mm - by_xy.dot(Vec2(ray.direction[0], ray.direction[1])));
  const Vec3 normal = direction / cv::norm(direction);
  return normal.dot(ray.direction) > 0 ? -normal : normal;
}

// mm on the surface for one px of the coordinate with this gradient.
double pitch_mm(const Vec3& gradient_px_per_mm, const Vec3& normal) {
  return 1 / cv::norm(gradient_px_per_mm - normal.dot(gradient_px_per_mm) * normal);
}

struct SurfacePoint {
  Vec3 position_mm, normal;
  double column_pitch_mm = 0, row_pitch_mm = 0;
  double cos_projector = 0, cos_camera = 0, projector_distance_mm = 0;
};

std::optional<SurfacePoint> describe_point(const Stereo& stereo, const Stereo::Ray& ray,
                                           double inverse_per_mm, double by_col, double by_row) {
  SurfacePoint point;
  point.position_mm = ray.direction / inverse_per_mm;
  point.normal = normal_of(ray, inverse_per_mm, by_col, by_row);
  const auto lit = stereo.project(point.position_mm);
  if (!lit) return std::nullopt;
  const Vec3 to_projector = stereo.projector_centre_mm() - point.position_mm;
  point.projector_distance_mm = cv::norm(to_projector);
  point.cos_projector = point.normal.dot(to_projector) / point.projector_distance_mm;
  point.cos_camera = -point.normal.dot(ray.direction) / cv::norm(ray.direction);
  point.column_pitch_mm = pitch_mm(lit->column_gradient_px_per_mm, point.normal);
  point.row_pitch_mm = pitch_mm(lit->row_gradient_px_per_mm, point.normal);
  return point;
}

void store_shape(const SurfacePoint& point, int row, int col, Surface& out) {
  for (std::size_t i = 0; i < 3; ++i) {
    out.position_mm[i].at(row, col) = static_cast<float>(point.position_mm[static_cast<int>(i)]);
    out.normal[i].at(row, col) = static_cast<float>(point.normal[static_cast<int>(i)]);
  }
}

void store_light(const SurfacePoint& point, double sd_mm, double tilt_sd_rad, int row, int col,
                 Surface& out) {
  out.column_pitch_mm.at(row, col) = static_cast<float>(point.column_pitch_mm);
  out.row_pitch_mm.at(row, col) = static_cast<float>(point.row_pitch_mm);
  out.cos_projector.at(row, col) = static_cast<float>(point.cos_projector);
  out.cos_camera.at(row, col) = static_cast<float>(point.cos_camera);
  out.projector_distance_mm.at(row, col) = static_cast<float>(point.projector_distance_mm);
  out.position_sd_mm.at(row, col) = static_cast<float>(sd_mm);
  out.tilt_sd_rad.at(row, col) = static_cast<float>(tilt_sd_rad);
}

// Pixels that see the glow of their lit neighbours.
class Glow {
 public:
  Glow(const Correspondence& correspondence, const CameraInfo& camera,
       const SurfaceOptions& options, double px_per_mm)
      : correspondence_(correspondence),
        frac_(correspondence.modulation_dn_per_us.empty() ? 0
                                                          : static_cast<float>(options.glow_frac)) {
    const ColorFilter filter = camera.pixel_format.filter;
    const bool is_mosaic = filter != ColorFilter::kMono && filter != ColorFilter::kRgb;
    const int unit_px = is_mosaic ? 2 : 1;  // to the next pixel of the same colour
    const double radius_px =
        std::clamp(options.glow_radius_mm * px_per_mm, 1.0, double{kMaxRadiusPx});
    step_px_ = unit_px * std::max(1, static_cast<int>(std::lround(radius_px / kSamples / unit_px)));
  }

  bool is_at(int row, int col) const {
    if (!(frac_ > 0)) return false;
    const Image<float>& modulation = correspondence_.modulation_dn_per_us;
    const float limit = modulation.at(row, col) / frac_;
    for (int i = -kSamples; i <= kSamples; ++i)
      for (int j = -kSamples; j <= kSamples; ++j) {
        const int r = row + i * step_px_, c = col + j * step_px_;
        if (r < 0 || c < 0 || r >= modulation.height_px() || c >= modulation.width_px()) continue;
        if (correspondence_.validity.at(r, c) == 0 && modulation.at(r, c) > limit) return true;
      }
    return false;
  }

 private:
  static constexpr int kSamples = 3;  // on either side
  const Correspondence& correspondence_;
  float frac_;
  int step_px_ = 1;
};

void finish_pixel(const Stereo& stereo, const RawDepth& raw, const FitRow& fit, const Glow& glow,
                  const SurfaceOptions& options, SurfaceParts parts, int row, int col,
                  Surface& out) {
  const auto i = static_cast<std::size_t>(col);
  std::uint32_t& validity = out.validity.at(row, col);
  if (validity & kValidityErrors) return;
  const bool is_smoothed = options.smoothing_radius_mm > 0;
  const double inverse_per_mm =
      double{is_smoothed ? fit.inverse_depth_per_mm[i] : raw.inverse_per_mm.at(row, col)};
  const auto ray = stereo.ray(row, col);
  std::optional<SurfacePoint> point;
  if (inverse_per_mm > 0 && !std::isnan(fit.by_col[i])) {
    point =
        describe_point(stereo, *ray, inverse_per_mm, double{fit.by_col[i]}, double{fit.by_row[i]});
  }
  if (!point || (fit.is_near_discontinuity[i] && glow.is_at(row, col))) {
    validity |= kNoCorrespondence;
    return;
  }
  if (point->cos_projector < options.min_cos_projector) validity |= kGrazingProjector;
  if (point->cos_camera < options.min_cos_camera) validity |= kGrazingCamera;
  if (validity & kValidityErrors) return;
  if (fit.is_near_discontinuity[i]) validity |= kNearDiscontinuity;
  store_shape(*point, row, col, out);
  if (parts == SurfaceParts::kShape) return;
  const double gain = is_smoothed ? double{fit.noise_gain[i]} : 1;
  const double sd_mm = gain * double{raw.relative_sd.at(row, col)} * cv::norm(point->position_mm);
  // The normal's vector (normal_of) is as long as inverse depth over its part along the ray.
  const double tilt_sd_rad = double{fit.slope_gain[i]} * double{raw.relative_sd.at(row, col)} *
                             stereo.camera_focal_px() * cv::norm(ray->direction) *
                             point->cos_camera;
  store_light(*point, sd_mm, tilt_sd_rad, row, col, out);
}

std::vector<Image<float>*> images_of(Surface& surface, SurfaceParts parts) {
  std::vector<Image<float>*> images;
  for (std::size_t i = 0; i < 3; ++i) {
    images.push_back(&surface.position_mm[i]);
    images.push_back(&surface.normal[i]);
  }
  if (parts == SurfaceParts::kShape) return images;
  for (Image<float>* image :
       {&surface.column_pitch_mm, &surface.row_pitch_mm, &surface.cos_projector,
        &surface.cos_camera, &surface.projector_distance_mm, &surface.position_sd_mm,
        &surface.tilt_sd_rad})
    images.push_back(image);
  return images;
}

// All NaN. New memory is the system's to hand out, one image a thread.
void clear(const std::vector<Image<float>*>& images, int height_px, int width_px) {
  oneapi::tbb::parallel_for(std::size_t{0}, images.size(), [&](std::size_t i) {
    Image<float>& image = *images[i];
    if (image.height_px() == height_px && image.width_px() == width_px) {
      std::fill(image.samples().begin(), image.samples().end(), kNaN);
    } else {
      image = Image<float>(height_px, width_px, 1, kNaN);
    }
  });
}

}  // namespace

void reconstruct_surface_into(const Calibration& calibration, const CameraInfo& camera,
                              const ProjectorInfo& projector, const Correspondence& correspondence,
                              const SurfaceOptions& options, SurfaceParts parts, Surface& out) {
  check(projector.width_px > 0 && projector.height_px > 0, "a projector without pixels");
  check(correspondence.validity.height_px() == camera.height_px &&
            correspondence.validity.width_px() == camera.width_px,
        "a correspondence of another size than the frames");
  const Stereo stereo(calibration, camera);
  clear(images_of(out, parts), camera.height_px, camera.width_px);
  out.validity = correspondence.validity;
  const RawDepth raw = triangulate_image(stereo, projector, correspondence, options, out.validity);
  const Glow glow(correspondence, camera, options,
                  median_of(raw.inverse_per_mm) * stereo.camera_focal_px());
  fit_locally({raw.inverse_per_mm.view(), raw.relative_sd.view()},
              fit_options(options, raw, stereo.camera_focal_px()), [&](int row, const FitRow& fit) {
                for (int col = 0; col < camera.width_px; ++col)
                  finish_pixel(stereo, raw, fit, glow, options, parts, row, col, out);
              });
}

Surface reconstruct_surface(const Calibration& calibration, const CameraInfo& camera,
                            const ProjectorInfo& projector, const Correspondence& correspondence,
                            const SurfaceOptions& options) {
  Surface out;
  reconstruct_surface_into(calibration, camera, projector, correspondence, options,
                           SurfaceParts::kAll, out);
  return out;
}

}  // namespace estimation
