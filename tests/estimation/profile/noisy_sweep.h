// A sweep of stripes over a flat patch of skin, sample by sample in closed form, with the noise of
// design/estimation.md's rig, an optional blur and an optional drift.
#pragma once

#include <oneapi/tbb/parallel_for.h>

#include <cmath>
#include <cstdint>
#include <numbers>
#include <random>
#include <utility>
#include <vector>

#include "estimation/profile/likelihood_scene.h"
#include "estimation/session/maps.h"
#include "tests/estimation/profile/synthetic_profile.h"

namespace estimation::testing {

struct SweepOptions {
  Skin skin = kCheekRed;
  int width_px = 60, height_px = 50;
  ColorFilter filter = ColorFilter::kMono;
  double indirect = 0;
  double blur_px = 0;
  double drift_px = 0;  // over the sweep, in the order of the shifts
  bool is_background_half = false;
  // Of each pixel's light as the fit is told it, along and across the stripes' axis (TiltNoise).
  double tilt_along = 0, tilt_across = 0;
  std::uint64_t seed = 1;
};

// Owns what a StripeScene borrows. u is known to +-0.1 px; the pitch is 0.3 mm.
class NoisySweep {
 public:
  static constexpr double kPitchMm = 0.3, kEta = 1.4, kSignalPerUs = 17000;

  explicit NoisySweep(const SweepOptions& options)
      : stripes_(paper_stripes()), noise_(merged_noise({1, 4}, {1, 10}, 20000)), model_(kEta) {
    camera_.width_px = options.width_px;
    camera_.height_px = options.height_px;
    camera_.pixel_format = {options.filter, 16};
    const Image<float> blank(options.height_px, options.width_px);
    true_u_px = tilt_along = position_px_ = gain_ = distance_mm_ = blank;
    tilt_along_sd_ = tilt_across_sd_ = blank;
    validity_ = Image<std::uint32_t>(options.height_px, options.width_px);
    images_.assign(stripes_.shifts_px.size(), blank);
    for (std::size_t i = 0; i < order.size(); ++i)
      order[i] = static_cast<double>(i) / (static_cast<double>(order.size()) - 1) - 0.5;
    tbb::parallel_for(0, options.height_px, [&](int row) { fill_row(options, row); });
    for (const Image<float>& image : images_) signals_.push_back(image.view());
    geometry_ = {.position_px = position_px_.view(),
                 .gain = gain_.view(),
                 .projector_distance_mm = distance_mm_.view(),
                 .validity = validity_.view()};
    if (options.tilt_along > 0 || options.tilt_across > 0)
      geometry_.tilt = {.along = tilt_along_sd_.view(), .across = tilt_across_sd_.view()};
  }
  NoisySweep(const NoisySweep&) = delete;
  NoisySweep& operator=(const NoisySweep&) = delete;

  StripeScene scene() const { return scene(model_); }
  StripeScene scene(const ScatteringModel& model) const {
    return {.camera = camera_,
            .stripes = stripes_,
            .signals = signals_,
            .geometry = geometry_,
            .transfer = transfer_,
            .model = model};
  }
  BandRadiometry radiometry(int band = 0) const {
    return {
        .band = band, .signal_per_us = kSignalPerUs, .projector_black_frac = 0, .noise = noise_};
  }

  Image<float> true_u_px;
  Image<float> tilt_along;  // by how much the light is off because of it
  std::vector<double> order = std::vector<double>(40);  // [shift] as capture_order

 private:
  void fill_row(const SweepOptions& options, int row) {
    std::mt19937_64 random(options.seed * 100003 + static_cast<std::uint64_t>(row));
    const auto uniform = [&] {
      return static_cast<double>(random()) / static_cast<double>(random.max());
    };
    const auto normal = [&] {
      double sum = -6;
      for (int i = 0; i < 12; ++i) sum += uniform();
      return sum;
    };
    const double blur_harmonic =
        options.blur_px > 0 ? 40 / (std::numbers::sqrt2 * std::numbers::pi * options.blur_px) : 0;
    for (int col = 0; col < options.width_px; ++col) {
      const double u_px = 200 + 60 * uniform();
      const double gain = 0.7 + 0.3 * uniform();
      true_u_px.at(row, col) = static_cast<float>(u_px);
      position_px_.at(row, col) = static_cast<float>(u_px + 0.2 * (uniform() - 0.5));
      gain_.at(row, col) = static_cast<float>(gain);
      const bool is_background = options.is_background_half && col < options.width_px / 2;
      if (is_background) validity_.at(row, col) = kBackground;
      for (std::size_t i = 0; i < images_.size(); ++i) {
        const double full = kSignalPerUs * static_cast<double>(gain_.at(row, col));
        const double factor = reflectance_factors(
            stripe_set(40, 8, {stripes_.shifts_px[i]}), options.skin.medium, kEta, kPitchMm,
            static_cast<double>(true_u_px.at(row, col)) - options.drift_px * order[i],
            options.indirect, blur_harmonic, 60)[0];
        const double signal = is_background ? 0 : full * factor;
        images_[i].at(row, col) =
            static_cast<float>(signal + normal() * std::sqrt(variance_at(noise_, signal)));
      }
      if (options.tilt_along > 0 || options.tilt_across > 0) {
        tilt_along.at(row, col) = static_cast<float>(options.tilt_along * normal());
        const double off =
            static_cast<double>(tilt_along.at(row, col)) + options.tilt_across * normal();
        gain_.at(row, col) = static_cast<float>(gain * (1 + off));
        tilt_along_sd_.at(row, col) = static_cast<float>(options.tilt_along);
        tilt_across_sd_.at(row, col) = static_cast<float>(options.tilt_across);
      }
    }
  }

  CameraInfo camera_;
  StripeSet stripes_;
  std::vector<MergedNoise> noise_;
  Dipole model_;
  HarmonicTransfer transfer_;
  Image<float> position_px_, gain_, distance_mm_, tilt_along_sd_, tilt_across_sd_;
  Image<std::uint32_t> validity_;
  std::vector<Image<float>> images_;
  std::vector<ImageView<const float>> signals_;
  SceneGeometry geometry_;
};

}  // namespace estimation::testing
