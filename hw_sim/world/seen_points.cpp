#include "hw_sim/world/seen_points.h"

#include <tbb/parallel_for.h>

#include <optional>

namespace hw_sim {

using estimation::Vec3;

namespace {

std::optional<SeenPoint> look(int row, int col, const estimation::CameraInfo& camera,
                              const Pinhole& eye, const Pinhole& lamp, int lamp_height_px,
                              int lamp_width_px, const Surface& surface, const SkinMap& skin) {
  const std::optional<Hit> hit =
      surface.first_hit(eye.ray(col + camera.roi_x_px, row + camera.roi_y_px));
  if (!hit) return std::nullopt;
  SeenPoint seen;
  seen.row = row;
  seen.col = col;
  seen.point_mm = hit->point_mm;
  seen.normal = normal_at(surface.shape(), hit->point_mm);
  seen.skin = skin.at(hit->point_mm);
  const auto cosine_to = [&](const Vec3& place_mm) {
    const Vec3 towards = place_mm - seen.point_mm;
    return towards.dot(seen.normal) / cv::norm(towards);
  };
  seen.cos_projector = cosine_to(lamp.center_mm());
  seen.cos_camera = cosine_to(eye.center_mm());
  seen.pixel_mm = cv::norm(seen.point_mm) / eye.focal_px();
  const ProjectedPoint at = lamp.project(seen.point_mm);
  seen.is_lit = at.is_in_front && at.col_px > -0.5 && at.row_px > -0.5 &&
                at.col_px < lamp_width_px - 0.5 && at.row_px < lamp_height_px - 0.5 &&
                surface.is_seen_from(lamp.center_mm(), seen.point_mm, seen.normal);
  return seen;
}

}  // namespace

SeenPoints find_seen_points(const estimation::CameraInfo& camera, const Pinhole& eye,
                            const Pinhole& lamp, int lamp_height_px, int lamp_width_px,
                            const Surface& surface, const SkinMap& skin, double crosstalk_frac) {
  std::vector<std::vector<SeenPoint>> rows(static_cast<std::size_t>(camera.height_px));
  tbb::parallel_for(0, camera.height_px, [&](int row) {
    for (int col = 0; col < camera.width_px; ++col)
      if (auto seen =
              look(row, col, camera, eye, lamp, lamp_height_px, lamp_width_px, surface, skin))
        rows[static_cast<std::size_t>(row)].push_back(std::move(*seen));
  });
  SeenPoints result;
  const auto filter = camera.pixel_format.filter;
  const bool is_mono = filter == estimation::ColorFilter::kMono;
  const int channels = estimation::sample_channel_count(filter);
  const auto add = [&](const SeenPoint& seen, int channel, int light_band, double share) {
    SeenSample sample;
    for (int axis = 0; axis < 3; ++axis) {
      const auto a = static_cast<std::size_t>(axis);
      sample.point_mm[a] = static_cast<float>(seen.point_mm[axis]);
      sample.normal[a] = static_cast<float>(seen.normal[axis]);
    }
    sample.sample = (seen.row * camera.width_px + seen.col) * channels + channel;
    sample.cos_projector = static_cast<float>(seen.cos_projector);
    sample.scattering = seen.skin.material.bands[static_cast<std::size_t>(light_band)];
    sample.share = static_cast<float>(share);
    result.samples.push_back(sample);
    result.bands.push_back(static_cast<std::uint8_t>(light_band));
    result.owners.push_back(static_cast<std::int32_t>(result.points.size() - 1));
  };
  for (const auto& row : rows)
    for (const SeenPoint& seen : row) {
      result.points.push_back(seen);
      for (int channel = 0; channel < channels; ++channel) {
        // A mono camera sees green light: its one band takes the materials' green.
        const int band = is_mono ? 1 : estimation::band_at(camera, seen.row, seen.col, channel);
        const double mixed = is_mono ? 0 : crosstalk_frac;
        for (int light = 0; light < 3; ++light) {
          const double share = light == band ? 1 - 2 * mixed : mixed;
          if (share > 0) add(seen, channel, light, share);
        }
      }
    }
  return result;
}

}  // namespace hw_sim
