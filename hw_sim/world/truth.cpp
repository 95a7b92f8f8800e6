#include "hw_sim/world/truth.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "estimation/session/maps.h"
#include "hw_sim/world/dipole.h"

namespace hw_sim {

namespace {

using estimation::Image;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// Where the surface or its light breaks off: beside background, across a jump in depth, across the
// edge of a cast shadow. Distance from each pixel to the nearest such place, px.
Image<float> distance_to_break_px(const estimation::CameraInfo& camera, const SeenPoints& seen) {
  constexpr double kJumpMm = 4;  // between neighbouring pixels
  Image<float> depth_mm(camera.height_px, camera.width_px, 1, kNan);
  Image<unsigned char> lit(camera.height_px, camera.width_px, 1, 0);
  for (const SeenPoint& point : seen.points) {
    depth_mm.at(point.row, point.col) = static_cast<float>(point.point_mm[2]);
    lit.at(point.row, point.col) = point.is_lit ? 1 : 0;
  }
  cv::Mat whole(camera.height_px, camera.width_px, CV_8U, cv::Scalar(255));
  const auto breaks_between = [&](const SeenPoint& here, int row, int col) {
    if (row < 0 || col < 0 || row >= camera.height_px || col >= camera.width_px) return true;
    const float there_mm = depth_mm.at(row, col);
    if (std::isnan(there_mm)) return true;
    if ((lit.at(row, col) != 0) != here.is_lit) return true;
    return std::abs(static_cast<double>(there_mm) - here.point_mm[2]) > kJumpMm;
  };
  for (const SeenPoint& point : seen.points)
    if (breaks_between(point, point.row - 1, point.col) ||
        breaks_between(point, point.row + 1, point.col) ||
        breaks_between(point, point.row, point.col - 1) ||
        breaks_between(point, point.row, point.col + 1))
      whole.at<unsigned char>(point.row, point.col) = 0;
  cv::Mat distance_px;
  cv::distanceTransform(whole, distance_px, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  Image<float> result(camera.height_px, camera.width_px);
  for (int row = 0; row < camera.height_px; ++row)
    for (int col = 0; col < camera.width_px; ++col)
      result.at(row, col) = distance_px.at<float>(row, col);
  return result;
}

struct TruthImages {
  estimation::Maps maps;
  Image<float> region, border_distance_mm, cos_projector, cos_camera, lit;

  explicit TruthImages(const estimation::CameraInfo& camera) {
    const auto blank = [&](float fill) {
      return Image<float>(camera.height_px, camera.width_px, 1, fill);
    };
    maps.height_px = camera.height_px;
    maps.width_px = camera.width_px;
    maps.band_count = estimation::band_count(camera.pixel_format.filter);
    maps.method = "truth";
    for (std::size_t band = 0; band < static_cast<std::size_t>(maps.band_count); ++band)
      for (auto* each : {&maps.sigma_a_per_mm, &maps.sigma_s_prime_per_mm, &maps.translucency_mm,
                         &maps.diffuse_reflectance, &maps.indirect})
        (*each)[band] = blank(kNan);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      maps.position_mm[axis] = blank(kNan);
      maps.normal[axis] = blank(kNan);
    }
    for (auto& axis : maps.correspondence_px) axis = blank(kNan);
    region = blank(0);
    for (auto* each : {&border_distance_mm, &cos_projector, &cos_camera}) *each = blank(kNan);
    lit = blank(0);
  }
};

void set_material(const SeenPoint& point, const std::array<float, 3>& received, double gain,
                  const TotalReflectance& reflectance_of, estimation::Maps& maps) {
  const int row = point.row, col = point.col;
  for (std::size_t band = 0; band < static_cast<std::size_t>(maps.band_count); ++band) {
    // A mono camera's one band is the materials' green (seen_points.cpp).
    const std::size_t color = maps.band_count == 1 ? 1 : band;
    const Scattering& scattering = point.skin.material.bands[color];
    const double reflectance = reflectance_of(scattering);
    maps.sigma_a_per_mm[band].at(row, col) = static_cast<float>(scattering.sigma_a_per_mm);
    maps.sigma_s_prime_per_mm[band].at(row, col) =
        static_cast<float>(scattering.sigma_s_prime_per_mm);
    maps.translucency_mm[band].at(row, col) = static_cast<float>(scattering.translucency_mm());
    maps.diffuse_reflectance[band].at(row, col) = static_cast<float>(reflectance);
    maps.indirect[band].at(row, col) =
        gain > 0 ? static_cast<float>(static_cast<double>(received[color]) * reflectance / gain)
                 : kNan;
  }
}

}  // namespace

estimation::Result<void> write_truth(const std::filesystem::path& folder,
                                     const estimation::CameraInfo& camera, const SeenPoints& seen,
                                     const ProjectorLight& light,
                                     const std::vector<std::array<float, 3>>& received,
                                     ScatteringModel model,
                                     const TotalReflectance& reflectance_of) {
  TruthImages out(camera);
  out.maps.scattering_model = model == ScatteringModel::kDipole ? "dipole" : "monte_carlo";
  const Image<float> break_px = distance_to_break_px(camera, seen);
  const Pinhole& lamp = light.projector();
  for (std::size_t i = 0; i < seen.points.size(); ++i) {
    const SeenPoint& point = seen.points[i];
    const int row = point.row, col = point.col;
    const double ratio =
        light.reference_distance_mm() / cv::norm(point.point_mm - lamp.center_mm());
    const double gain = point.cos_projector * ratio * ratio;  // G of the session contract
    set_material(point, received.empty() ? std::array<float, 3>{} : received[i], gain,
                 reflectance_of, out.maps);
    for (int axis = 0; axis < 3; ++axis) {
      const auto a = static_cast<std::size_t>(axis);
      out.maps.position_mm[a].at(row, col) = static_cast<float>(point.point_mm[axis]);
      out.maps.normal[a].at(row, col) = static_cast<float>(point.normal[axis]);
    }
    const ProjectedPoint at = lamp.project(point.point_mm);
    out.maps.correspondence_px[0].at(row, col) = static_cast<float>(at.col_px);
    out.maps.correspondence_px[1].at(row, col) = static_cast<float>(at.row_px);
    // Pixels are not stretched by the slope here: never more than the distance is.
    out.border_distance_mm.at(row, col) =
        static_cast<float>(std::min(point.skin.border_distance_mm,
                                    static_cast<double>(break_px.at(row, col)) * point.pixel_mm));
    out.region.at(row, col) = static_cast<float>(point.skin.region);
    out.cos_projector.at(row, col) = static_cast<float>(point.cos_projector);
    out.cos_camera.at(row, col) = static_cast<float>(point.cos_camera);
    out.lit.at(row, col) = point.is_lit ? 1.0F : 0.0F;
  }
  if (auto written = estimation::write_maps(folder, out.maps); !written) return written;
  return estimation::write_exr(
      folder / "scene.exr",
      {{"region", std::as_const(out.region).view()},
       {"border_distance_mm", std::as_const(out.border_distance_mm).view()},
       {"cos_projector", std::as_const(out.cos_projector).view()},
       {"cos_camera", std::as_const(out.cos_camera).view()},
       {"lit", std::as_const(out.lit).view()}},
      {{"software", "ssrig-sim"}});
}

}  // namespace hw_sim
