// A tilted plane of one material a band, photographed without noise: frames in memory, by the
// closed form of design/estimation.md, section 1, and its truth. Shares no code with the estimator
// but the dipole's R~.
#pragma once

#include <array>
#include <cmath>
#include <complex>
#include <cstdint>
#include <map>
#include <numbers>
#include <numeric>
#include <opencv2/core.hpp>
#include <string>
#include <utility>
#include <vector>

#include "estimation/models/dipole.h"
#include "estimation/session/manifest.h"
#include "tests/estimation/profile/synthetic_profile.h"

namespace estimation::testing {

struct SceneOptions {
  int width_px = 40, height_px = 32;
  PixelFormat format{ColorFilter::kMono, 16};
  std::vector<double> exposures_us{20000};
  Axis stripe_axis = Axis::kColumn;
  bool has_stripes = true, has_white = false, has_black = false, has_correspondence = true;
  double ambient_dn_per_us = 0;
  double projector_black_frac = 0;  // of signal_per_us
  double indirect = 0;
  double blur_harmonic = 0;   // of the optics, see reflectance_factors
  double gain_dn_per_us = 2;  // signal_per_us of band 0; the others 5% less each
  int background_cols = 0;    // leftmost columns that see nothing
  int projector_px = 256;     // both sides, a power of two
  // Of band 0's light instead of the dipole, with what oblique light does; borrowed.
  const ScatteringModel* model = nullptr;
};

struct Scene {
  Manifest manifest;
  std::vector<Image<std::uint16_t>> frames;  // as manifest.frames
  std::array<Coefficients, 3> medium;        // [band]
  std::array<double, 3> reflectance{}, l_d_mm{};
  Image<float> u_px, pitch_mm, gain;
};

// Where a camera pixel looks, and how the projector sees that place.
struct PlanePoint {
  double u_px = 0, v_px = 0, column_pitch_mm = 0, row_pitch_mm = 0, gain = 0;
  Directions column_light, row_light;  // azimuths from where the column, the row grows
};

inline PlanePoint plane_point(const Manifest& manifest, int row, int col) {
  const Vec3 normal(std::sin(0.2), 0, -std::cos(0.2));  // towards the camera
  const Vec3 ray = manifest.calibration.camera.K.inv() * Vec3(col, row, 1);
  const Vec3 on_plane(0, 0, 1000);
  const Vec3 point = ray * (on_plane.dot(normal) / ray.dot(normal));
  const Mat3& R = manifest.calibration.projector_from_camera;
  const Vec3& t = manifest.calibration.projector_from_camera_mm;
  const Mat3& K = manifest.calibration.projector.K;
  const Vec3 in_projector = R * point + t;
  const double depth = in_projector[2];
  PlanePoint result;
  std::array<double, 2> pitch{};
  std::array<Vec3, 2> along;
  for (int axis = 0; axis < 2; ++axis) {
    const double image = in_projector[axis] / depth;
    (axis == 0 ? result.u_px : result.v_px) = K(axis, axis) * image + K(axis, 2);
    Vec3 gradient;  // of the projector coordinate, px/mm
    for (int k = 0; k < 3; ++k)
      gradient[k] = K(axis, axis) * (R(axis, k) - image * R(2, k)) / depth;
    gradient -= normal * normal.dot(gradient);
    pitch[static_cast<std::size_t>(axis)] = 1 / cv::norm(gradient);
    along[static_cast<std::size_t>(axis)] = gradient / cv::norm(gradient);
  }
  result.column_pitch_mm = pitch[0];
  result.row_pitch_mm = pitch[1];
  const Vec3 to_projector = R.t() * (-t) - point;
  const Vec3 to_camera = -point;  // named: GCC 12's address sanitizer loses a temporary below
  const double distance_mm = cv::norm(to_projector);
  const double reference_mm = *manifest.calibration.irradiance->reference_distance_mm;
  for (std::size_t axis = 0; axis < 2; ++axis) {
    const Vec3 across = normal.cross(along[axis]);
    const auto azimuth = [&](const Vec3& way) {
      return std::atan2(way.dot(across), way.dot(along[axis]));
    };
    (axis == 0 ? result.column_light : result.row_light) = {
        .cos_incidence = normal.dot(to_projector) / distance_mm,
        .cos_exit = -normal.dot(point) / cv::norm(point),
        .incidence_azimuth_rad = azimuth(to_projector),
        .exit_azimuth_rad = azimuth(to_camera)};
  }
  result.gain = normal.dot(to_projector) / distance_mm * std::pow(reference_mm / distance_mm, 2);
  return result;
}

inline Manifest scene_manifest(const SceneOptions& options) {
  Manifest manifest;
  manifest.id = "synthetic";
  manifest.created = "2026-01-01T00:00:00Z";
  CameraInfo& camera = manifest.camera;
  camera.width_px = options.width_px;
  camera.height_px = options.height_px;
  camera.pixel_format = options.format;
  camera.black_level_dn = 200;
  camera.saturation_level_dn = (1 << options.format.bit_depth) - 1;
  camera.gain_e_per_dn = 100;  // a nearly noise-free camera
  camera.read_noise_e = 10;
  manifest.projector = {.width_px = options.projector_px,
                        .height_px = options.projector_px,
                        .sync_square = std::nullopt};
  Calibration& calibration = manifest.calibration;
  const double camera_f = 2000, projector_f = 3400;
  const double projector_middle = 0.5 * (options.projector_px - 1);
  calibration.camera.K = Mat3(camera_f, 0, 0.5 * (options.width_px - 1), 0, camera_f,
                              0.5 * (options.height_px - 1), 0, 0, 1);
  calibration.projector.K =
      Mat3(projector_f, 0, projector_middle, 0, projector_f, projector_middle, 0, 0, 1);
  const double angle = std::atan2(250, 1000);
  calibration.projector_from_camera =
      Mat3(std::cos(angle), 0, std::sin(angle), 0, 1, 0, -std::sin(angle), 0, std::cos(angle));
  calibration.projector_from_camera_mm = calibration.projector_from_camera * Vec3(-250, -20, 0);
  Irradiance irradiance;
  for (int band = 0; band < band_count(options.format.filter); ++band)
    irradiance.signal_per_us.push_back(options.gain_dn_per_us * (1 - 0.05 * band));
  irradiance.reference_distance_mm = 1000;
  calibration.irradiance = irradiance;
  for (const double signal : irradiance.signal_per_us)
    if (options.projector_black_frac > 0)
      calibration.projector_black_dn_per_us.push_back(options.projector_black_frac * signal);

  int highest_bit = 0;
  while (2 << highest_bit < options.projector_px) ++highest_bit;
  const auto add = [&](PatternKind kind) {
    manifest.patterns.push_back({static_cast<int>(manifest.patterns.size()), std::move(kind)});
  };
  for (int shift = 0; options.has_stripes && shift < 40; ++shift)
    add(Stripes{options.stripe_axis, 40, 8, shift});
  for (const Axis axis : {Axis::kColumn, Axis::kRow}) {
    if (!options.has_correspondence) continue;
    for (int bit = highest_bit; bit >= 0; --bit)
      for (const bool is_inverted : {false, true}) add(GrayCode{axis, bit, is_inverted});
    for (int shift = 0; shift < 16; shift += 4) add(Stripes{axis, 16, 8, shift});
  }
  if (options.has_white) add(White{});
  if (options.has_black) add(Black{});
  for (const Pattern& pattern : manifest.patterns)
    for (const double exposure_us : options.exposures_us) {
      FrameRecord frame;
      frame.pattern = pattern.index;
      frame.exposure_us = exposure_us;
      frame.file = "frames/" + std::to_string(manifest.frames.size()) + ".tiff";
      manifest.frames.push_back(frame);
    }
  return manifest;
}

// Gray code is not periodic: its edges are softened by an exponential of the diffuse length, which
// keeps their middle where it is.
inline double gray_response(const GrayCode& code, double position_px, double length_px,
                            int projector_px) {
  double sum = 0, weight = 0;
  const int middle = static_cast<int>(std::lround(position_px));
  for (int i = middle - 40; i <= middle + 40; ++i) {
    const double w = std::exp(-std::abs(i - position_px) / length_px);
    weight += w;
    if (i >= 0 && i < projector_px)
      sum += w * (code.axis == Axis::kColumn ? brightness(code, 0, i) : brightness(code, i, 0));
  }
  return sum / weight;
}

// r(s) of every shift under a model's own harmonics and what directions do to them.
inline std::vector<double> directed_sweep(const ScatteringModel& model, double reflectance,
                                          double l_d_px, const Directions& light,
                                          double position_px, int period_px, int width_px) {
  constexpr std::size_t kCount = 64;
  const double duty = static_cast<double>(width_px) / period_px;
  std::vector<double> k_times_l_d, transform(kCount);
  for (std::size_t n = 0; n < kCount; ++n)
    k_times_l_d.push_back(2 * std::numbers::pi * static_cast<double>(n) / period_px * l_d_px);
  std::vector<std::complex<double>> factors(kCount);
  model.transform(reflectance, k_times_l_d, transform);
  model.direction_factors(reflectance, k_times_l_d, light, factors);
  std::vector<double> sweep;
  for (int shift = 0; shift < period_px; ++shift) {
    const double angle =
        2 * std::numbers::pi * (position_px - shift - 0.5 * (width_px - 1)) / period_px;
    double sum = duty * transform[0] * factors[0].real();
    for (std::size_t n = 1; n < kCount; ++n) {
      const double order = static_cast<double>(n);
      sum += 2 * std::sin(std::numbers::pi * order * duty) / (std::numbers::pi * order) *
             transform[n] * (factors[n] * std::polar(1.0, order * angle)).real();
    }
    sweep.push_back(sum);
  }
  return sweep;
}

// Reflectance factors of a pixel under all patterns.
inline std::vector<double> responses(const Manifest& manifest, const Coefficients& medium,
                                     const PlanePoint& point, const SceneOptions& options) {
  constexpr int kTerms = 160;
  const double reflectance = dipole_reflectance(medium, 1.4);
  const double l_d_mm = diffuse_mean_free_path_mm(medium);
  std::map<std::pair<Axis, int>, std::vector<double>> sweeps;  // [axis, period] every shift
  std::vector<double> result;
  for (const Pattern& pattern : manifest.patterns) {
    if (const auto* stripes = std::get_if<Stripes>(&pattern.kind)) {
      const bool is_column = stripes->axis == Axis::kColumn;
      std::vector<double>& sweep = sweeps[{stripes->axis, stripes->period_px}];
      if (sweep.empty() && options.model != nullptr)
        sweep = directed_sweep(*options.model, reflectance,
                               l_d_mm / (is_column ? point.column_pitch_mm : point.row_pitch_mm),
                               is_column ? point.column_light : point.row_light,
                               is_column ? point.u_px : point.v_px, stripes->period_px,
                               stripes->width_px);
      if (sweep.empty()) {
        std::vector<int> shifts(static_cast<std::size_t>(stripes->period_px));
        std::iota(shifts.begin(), shifts.end(), 0);
        sweep = reflectance_factors(
            stripe_set(stripes->period_px, stripes->width_px, shifts), medium, 1.4,
            is_column ? point.column_pitch_mm : point.row_pitch_mm,
            is_column ? point.u_px : point.v_px, options.indirect, options.blur_harmonic, kTerms);
      }
      result.push_back(sweep[static_cast<std::size_t>(stripes->shift_px)]);
    } else if (const auto* code = std::get_if<GrayCode>(&pattern.kind)) {
      const bool is_column = code->axis == Axis::kColumn;
      const double lit = gray_response(
          *code, is_column ? point.u_px : point.v_px,
          l_d_mm / (is_column ? point.column_pitch_mm : point.row_pitch_mm), options.projector_px);
      result.push_back(reflectance * lit + 0.5 * options.indirect);
    } else {
      const bool is_white = std::holds_alternative<White>(pattern.kind);
      result.push_back(is_white ? reflectance + options.indirect : 0);
    }
  }
  return result;
}

inline Scene make_scene(const SceneOptions& options) {
  Scene scene;
  scene.manifest = scene_manifest(options);
  scene.medium = {kCheekRed.medium, kCheekGreen.medium, kLipsBlue.medium};
  for (std::size_t band = 0; band < 3; ++band) {
    scene.reflectance[band] = dipole_reflectance(scene.medium[band], 1.4);
    scene.l_d_mm[band] = diffuse_mean_free_path_mm(scene.medium[band]);
  }
  const Manifest& manifest = scene.manifest;
  const CameraInfo& camera = manifest.camera;
  const int channels = sample_channel_count(camera.pixel_format.filter);
  scene.u_px = Image<float>(camera.height_px, camera.width_px);
  scene.pitch_mm = scene.u_px;
  scene.gain = scene.u_px;
  for (std::size_t i = 0; i < manifest.frames.size(); ++i)
    scene.frames.emplace_back(camera.height_px, camera.width_px, channels);
  for (int row = 0; row < camera.height_px; ++row)
    for (int col = 0; col < camera.width_px; ++col) {
      const PlanePoint point = plane_point(manifest, row, col);
      scene.u_px.at(row, col) = static_cast<float>(point.u_px);
      scene.pitch_mm.at(row, col) = static_cast<float>(
          options.stripe_axis == Axis::kColumn ? point.column_pitch_mm : point.row_pitch_mm);
      scene.gain.at(row, col) = static_cast<float>(point.gain);
      for (int channel = 0; channel < channels; ++channel) {
        const auto band = static_cast<std::size_t>(band_at(camera, row, col, channel));
        const double full = manifest.calibration.irradiance->signal_per_us[band] * point.gain;
        const double black =
            full * options.projector_black_frac * (scene.reflectance[band] + options.indirect);
        std::size_t frame = 0;
        for (const double factor : responses(manifest, scene.medium[band], point, options)) {
          const double rate = col < options.background_cols ? 0 : full * factor + black;
          for (const double exposure_us : options.exposures_us) {
            const double dn =
                *camera.black_level_dn + (rate + options.ambient_dn_per_us) * exposure_us;
            scene.frames[frame++].at(row, col, channel) = static_cast<std::uint16_t>(
                std::min(std::lround(dn), std::lround(*camera.saturation_level_dn)));
          }
        }
      }
    }
  return scene;
}

}  // namespace estimation::testing
