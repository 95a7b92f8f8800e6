#include "capture/profile_points.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>

#include "estimation/base/image.h"
#include "estimation/base/linear.h"
#include "estimation/session/frame_io.h"

namespace capture {
namespace {

using estimation::FrameRecord;
using estimation::Image;
using estimation::Manifest;
using estimation::ProfilePoint;
using estimation::Result;
using estimation::Stripes;

constexpr std::size_t kPointCount = 4;  // what the picture has room for

bool is_valid(const estimation::Maps& maps, int row, int col) {
  for (std::size_t band = 0; band < static_cast<std::size_t>(maps.band_count); ++band) {
    const auto& validity = maps.validity[band];
    if (validity.empty() || (validity.at(row, col) & estimation::kValidityErrors) != 0)
      return false;
  }
  return true;
}

// At a fifth, two fifths ... of the valid pixels, row by row.
std::vector<ProfilePoint> choose_points(const estimation::Maps& maps) {
  std::vector<ProfilePoint> valid;
  for (int row = 1; row + 1 < maps.height_px; ++row)
    for (int col = 1; col + 1 < maps.width_px; ++col)
      if (is_valid(maps, row, col)) {
        ProfilePoint point;
        point.row = row;
        point.col = col;
        valid.push_back(point);
      }
  if (valid.size() < kPointCount || maps.correspondence_px[0].empty()) return {};
  std::vector<ProfilePoint> points;
  for (std::size_t i = 1; i <= kPointCount; ++i)
    points.push_back(valid[i * valid.size() / (kPointCount + 1)]);
  return points;
}

// The stripes of the method: columns of the paper's period.
const Stripes* method_stripes(const Manifest& manifest, int pattern) {
  const auto* found = manifest.find_pattern(pattern);
  const auto* stripes = found ? std::get_if<Stripes>(&found->kind) : nullptr;
  const bool is_method = stripes && stripes->axis == estimation::Axis::kColumn &&
                         stripes->period_px == Stripes{}.period_px;
  return is_method ? stripes : nullptr;
}

// The sample of `band` at the pixel or, in a Bayer mosaic, beside it.
std::optional<std::uint16_t> sample(const Manifest& manifest, const Image<std::uint16_t>& frame,
                                    const ProfilePoint& point, int band) {
  if (frame.channel_count() == 3) return frame.at(point.row, point.col, band);
  for (const int row : {point.row, point.row + 1})
    for (const int col : {point.col, point.col + 1})
      if (estimation::band_at(manifest.camera, row, col) == band) return frame.at(row, col);
  return std::nullopt;
}

// What a perfect diffuse reflector in the point's place would add, DN/us; vignetting apart.
double reflector_dn_per_us(const Manifest& manifest, const estimation::Maps& maps,
                           const ProfilePoint& point, std::size_t band) {
  const estimation::Calibration& calibration = manifest.calibration;
  const auto at_point = [&point](const std::array<Image<float>, 3>& map) {
    const auto value = [&](std::size_t axis) {
      return static_cast<double>(map[axis].at(point.row, point.col));
    };
    return estimation::Vec3(value(0), value(1), value(2));
  };
  const estimation::Vec3 projector_mm =
      -(calibration.projector_from_camera.t() * calibration.projector_from_camera_mm);
  const estimation::Vec3 ray_mm = projector_mm - at_point(maps.position_mm);
  const double distance_mm = cv::norm(ray_mm);
  const double cosine = at_point(maps.normal).dot(ray_mm) / distance_mm;
  const double fall_off =
      calibration.irradiance->reference_distance_mm.value_or(distance_mm) / distance_mm;
  const auto& signal_per_us = calibration.irradiance->signal_per_us;
  return signal_per_us[std::min(band, signal_per_us.size() - 1)] * cosine * fall_off * fall_off;
}

// Frames come in the order of growing exposure: a longer one replaces a shorter.
void add_frame(const Manifest& manifest, const FrameRecord& record, double shift_px,
               const Image<std::uint16_t>& frame, ProfilePoint& point) {
  if (point.shift_px.empty() || point.shift_px.back() != shift_px) {
    point.shift_px.push_back(shift_px);
    for (auto& measured : point.measured)
      measured.push_back(std::numeric_limits<double>::quiet_NaN());
  }
  const double saturation_dn =
      manifest.camera.saturation_level_dn.value_or(std::numeric_limits<double>::infinity());
  const int band_count = estimation::band_count(manifest.camera.pixel_format.filter);
  for (int band = 0; band < band_count; ++band) {
    const auto dn = sample(manifest, frame, point, band);
    if (dn && *dn < saturation_dn)
      point.measured[static_cast<std::size_t>(band)].back() =
          (*dn - manifest.camera.black_level_dn.value_or(0)) / record.exposure_us;
  }
}

}  // namespace

Result<std::vector<ProfilePoint>> read_profile_points(const std::filesystem::path& session,
                                                      const Manifest& manifest,
                                                      const estimation::Maps& maps) {
  std::vector<ProfilePoint> points = choose_points(maps);
  const bool has_geometry = !maps.position_mm[0].empty() && !maps.normal[0].empty();
  const auto& irradiance = manifest.calibration.irradiance;
  if (!has_geometry || !irradiance || irradiance->signal_per_us.empty()) points.clear();
  if (points.empty()) return points;
  std::vector<FrameRecord> records;
  for (const FrameRecord& record : manifest.frames)
    if (method_stripes(manifest, record.pattern)) records.push_back(record);
  if (records.empty()) return std::vector<ProfilePoint>{};
  std::stable_sort(records.begin(), records.end(), [&](const auto& a, const auto& b) {
    const int shift_a = method_stripes(manifest, a.pattern)->shift_px;
    const int shift_b = method_stripes(manifest, b.pattern)->shift_px;
    return shift_a != shift_b ? shift_a < shift_b : a.exposure_us < b.exposure_us;
  });
  for (const FrameRecord& record : records) {
    const auto frame = estimation::read_frame(session, manifest, record.file);
    if (!frame) return tl::unexpected(frame.error());
    const double shift_px = method_stripes(manifest, record.pattern)->shift_px;
    for (ProfilePoint& point : points) add_frame(manifest, record, shift_px, *frame, point);
  }
  const Stripes* stripes = method_stripes(manifest, records.front().pattern);
  for (ProfilePoint& point : points) {
    for (std::size_t band = 0; band < point.measured.size(); ++band)
      for (double& signal : point.measured[band])
        signal /= reflector_dn_per_us(manifest, maps, point, band);
    point.period_px = stripes->period_px;
    // A stripe is centred on column u when its shift is u less half its width.
    const double u_px = static_cast<double>(maps.correspondence_px[0].at(point.row, point.col));
    const double peak_px = u_px - (stripes->width_px - 1) / 2.0;
    point.peak_px = peak_px - std::floor(peak_px / point.period_px) * point.period_px;
  }
  return points;
}

}  // namespace capture
