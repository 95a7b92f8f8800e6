// Surfaces that are the same along y: a flat one whose light breaks off along a line, and a crease.
// What a pixel sees is a sum over strips of light (tests/estimation/truth), without any transform.
#pragma once

#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <vector>

#include "estimation/profile/likelihood.h"
#include "estimation/refine/sample_correction.h"
#include "estimation/session/maps.h"
#include "tests/estimation/truth/line_spread.h"

namespace estimation {

struct LineScene {
  static constexpr double kPitchMm = 0.3;
  static constexpr double kFullSignal = 3;  // DN/us

  int height_px = 61, width_px = 121;
  double pixel_mm = 0.5;
  double edge_mm = std::numeric_limits<double>::infinity();  // lit where x is less
  StripeShape shape{};
  std::vector<int> shifts_px{};
  CameraInfo camera{};

  std::array<Image<float>, 3> position_mm{}, normal{};
  Image<float> position_px{}, pitch_mm{}, gain{}, cos_projector{}, distance_mm{};
  Image<std::uint32_t> validity{};
  std::vector<Image<float>> signals{};  // [shift]

  double x_mm(int col) const { return pixel_mm * (col - width_px / 2); }

  // Light falls along z; the surface lies at z = 1000 - height(x), with the angle of its slope.
  struct Point {
    double height_mm = 0, tilt_rad = 0;
  };
  using Shape = std::function<Point(double x_mm)>;
  void place(const Shape& at) {
    camera.height_px = height_px;
    camera.width_px = width_px;
    const Image<float> zero(height_px, width_px);
    position_mm.fill(zero);
    normal.fill(zero);
    position_px = gain = cos_projector = pitch_mm = zero;
    distance_mm = Image<float>(height_px, width_px, 1, 1e6F);
    validity = Image<std::uint32_t>(height_px, width_px);
    for (int row = 0; row < height_px; ++row)
      for (int col = 0; col < width_px; ++col) {
        const Point point = at(x_mm(col));
        position_mm[0].at(row, col) = static_cast<float>(x_mm(col));
        position_mm[1].at(row, col) = static_cast<float>(pixel_mm * (row - height_px / 2));
        position_mm[2].at(row, col) = static_cast<float>(1000 - point.height_mm);
        normal[0].at(row, col) = static_cast<float>(-std::sin(point.tilt_rad));
        normal[2].at(row, col) = static_cast<float>(-std::cos(point.tilt_rad));
        const auto cosine = static_cast<float>(std::cos(point.tilt_rad));
        gain.at(row, col) = cos_projector.at(row, col) = cosine;
        pitch_mm.at(row, col) = static_cast<float>(kPitchMm) / cosine;
        position_px.at(row, col) = static_cast<float>(500 + x_mm(col) / kPitchMm);
        if (x_mm(col) > edge_mm) validity.at(row, col) = kBackground;
      }
    shifts_px.resize(static_cast<std::size_t>(shape.period_px));
    for (std::size_t i = 0; i < shifts_px.size(); ++i) shifts_px[i] = static_cast<int>(i);
  }

  // strip(x, start, end): what reaches the pixel at x of light of irradiance 1 from there to there.
  using Strip = std::function<double(double x_mm, double start_mm, double end_mm)>;
  void light(const Strip& strip) {
    signals.assign(shifts_px.size(), Image<float>(height_px, width_px));
    for (std::size_t i = 0; i < shifts_px.size(); ++i)
      for (int col = 0; col < width_px; ++col) {
        double sum = 0;
        for (int period = -30; period < 60; ++period) {
          const double first_px = shifts_px[i] + period * shape.period_px - 0.5;
          const double start_mm = (first_px - 500) * kPitchMm;
          const double end_mm = std::min(start_mm + shape.width_px * kPitchMm, edge_mm);
          if (end_mm > start_mm) sum += strip(x_mm(col), start_mm, end_mm);
        }
        for (int row = 0; row < height_px; ++row)
          signals[i].at(row, col) = static_cast<float>(kFullSignal * sum);
      }
  }

  LitSurface surface() const {
    return {.position_mm = {position_mm[0].view(), position_mm[1].view(), position_mm[2].view()},
            .normal = {normal[0].view(), normal[1].view(), normal[2].view()},
            .position_px = position_px.view(),
            .pitch_mm = pitch_mm.view(),
            .gain = gain.view(),
            .cos_projector = cos_projector.view(),
            .validity = validity.view(),
            .projector_centre_mm = {0, 0, -1e6}};
  }
};

// Maps of the ordinary fit of every column, the same in all rows.
struct FittedMaps {
  Image<float> diffuse_reflectance, translucency_mm, phase_px;
  BandMaterial material() const { return {diffuse_reflectance.view(), translucency_mm.view()}; }
};

inline FittedMaps fit_columns(const LineScene& scene, const ScatteringModel& model) {
  const std::vector<MergedNoise> noise{{.read_variance = 1e-6, .shot_dn_per_us = 1e-4}};
  const FitProblem problem{
      .shape = scene.shape, .shifts_px = scene.shifts_px, .noise = noise, .model = &model};
  const Image<float> blank(scene.height_px, scene.width_px, 1,
                           std::numeric_limits<float>::quiet_NaN());
  FittedMaps maps{blank, blank, blank};
  std::vector<float> samples(scene.shifts_px.size());
  for (int col = 0; col < scene.width_px; ++col) {
    if (scene.validity.at(scene.height_px / 2, col) != 0) continue;
    for (std::size_t i = 0; i < samples.size(); ++i)
      samples[i] = scene.signals[i].at(scene.height_px / 2, col);
    const float position_px = scene.position_px.at(0, col);
    const auto full = static_cast<float>(LineScene::kFullSignal) * scene.gain.at(0, col);
    PixelBatch batch;
    batch.count = batch.stride = 1;
    batch.samples = samples;
    batch.position_px = {&position_px, 1};
    batch.full_signal = {&full, 1};
    const PixelFit fit = fit_pixel(problem, batch, 0);
    if (fit.validity != 0) continue;
    for (int row = 0; row < scene.height_px; ++row) {
      maps.diffuse_reflectance.at(row, col) =
          static_cast<float>(1 / (1 + std::exp(-fit.logit_reflectance)));
      maps.translucency_mm.at(row, col) =
          static_cast<float>(std::exp(fit.log_translucency_px)) * scene.pitch_mm.at(row, col);
      maps.phase_px.at(row, col) = static_cast<float>(fit.phase_px);
    }
  }
  return maps;
}

// Fit, correct, fit again, `round_count` times.
inline FittedMaps refine_columns(LineScene& scene, const ScatteringModel& model, int round_count) {
  std::vector<ImageView<const float>> measured;
  std::vector<ImageView<float>> writable;
  for (Image<float>& signal : scene.signals) {
    writable.push_back(signal.view());
    measured.push_back(signal.view());
  }
  const auto transfer = HarmonicTransfer::create(std::nullopt, {}, scene.camera);
  const LitSurface surface = scene.surface();
  const StripeSet stripes{.shape = scene.shape, .shifts_px = scene.shifts_px};
  const SceneGeometry geometry{.position_px = scene.position_px.view(),
                               .gain = scene.gain.view(),
                               .projector_distance_mm = scene.distance_mm.view(),
                               .validity = scene.validity.view()};
  const StripeScene stripe_scene{.camera = scene.camera,
                                 .stripes = stripes,
                                 .signals = measured,
                                 .geometry = geometry,
                                 .transfer = *transfer,
                                 .model = model};
  const CorrectionInput input{.scene = stripe_scene, .surface = surface};
  FittedMaps maps = fit_columns(scene, model);
  const Image<unsigned char> wanted(scene.height_px, scene.width_px, 1, 1);
  const SampleCorrection correction(scene.camera, 0, measured, wanted.view());
  for (int round = 0; round < round_count; ++round) {
    correction.apply(input, maps.material(), LineScene::kFullSignal, 0, writable);
    maps = fit_columns(scene, model);
  }
  return maps;
}

}  // namespace estimation
