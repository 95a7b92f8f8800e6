#include "tests/bench/fit_speed_scene.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "estimation/base/check.h"

namespace bench {
namespace {

using namespace estimation;

constexpr double kElectronsPerDn = 5, kReadNoiseElectrons = 10;
constexpr double kBlurPx = 0.5;
constexpr double kIndirect = 0.02;
constexpr int kStepsPerPx = 16;  // positions are whole sixteenths
constexpr double kPitchMm = 0.3;
constexpr int kBackground = 3;
constexpr std::size_t kNormals = 1U << 16;

// The paper's cheek, red, green and blue.
struct Skin {
  double sigma_a_per_mm, sigma_s_prime_per_mm;
};
constexpr std::array<Skin, 3> kCheek = {{{0.0525, 1.2814}, {0.1653, 1.5}, {0.2216, 1.1248}}};

// The paper's equation 5 and its l_d.
ShapePoint shape_of(const Skin& skin) {
  constexpr double kEta = 1.4;
  const double f = -1.440 / (kEta * kEta) + 0.710 / kEta + 0.668 + 0.0636 * kEta;
  const double a = (1 + f) / (1 - f);
  const double extinction = skin.sigma_a_per_mm + skin.sigma_s_prime_per_mm;
  const double s = std::sqrt(3 * skin.sigma_a_per_mm / extinction);
  const double reflectance =
      skin.sigma_s_prime_per_mm / extinction / 2 * (1 + std::exp(-4.0 / 3 * a * s)) * std::exp(-s);
  return {std::log(reflectance / (1 - reflectance)),
          std::log(1 / std::sqrt(3 * skin.sigma_a_per_mm * extinction) / kPitchMm)};
}

double envelope(StripeShape shape, int n) {
  return std::sin(std::numbers::pi * n * shape.width_px / shape.period_px) / (std::numbers::pi * n);
}

double reflectance_of(ShapePoint point) { return 1 / (1 + std::exp(-point.logit_reflectance)); }

std::vector<double> harmonics_of(const ScatteringModel& model, StripeShape shape, ShapePoint point,
                                 int count) {
  std::vector<double> waves, values(static_cast<std::size_t>(count));
  for (int n = 1; n <= count; ++n)
    waves.push_back(2 * std::numbers::pi * n / shape.period_px *
                    std::exp(point.log_translucency_px));
  model.transform(reflectance_of(point), waves, values);
  for (int n = 1; n <= count; ++n) values[static_cast<std::size_t>(n - 1)] *= envelope(shape, n);
  return values;
}

}  // namespace

SpeedScene::SpeedScene(const SpeedOptions& options)
    : noise(merged_noise({kSpeedExposuresUs.begin(), kSpeedExposuresUs.end()},
                         {kElectronsPerDn, kReadNoiseElectrons},
                         kSpeedSaturationDn - kSpeedBlackDn)),
      height_px_(options.height_px),
      width_px_(options.width_px) {
  auto made = make_scattering_model("dipole", {});
  check(made.has_value(), "the dipole is a model");
  model = std::move(*made);
  for (int shift = 0; shift < shape.period_px; ++shift) shifts_px.push_back(shift);
  for (std::size_t band = 0; band < bands.size(); ++band) bands[band].skin = shape_of(kCheek[band]);

  const std::size_t count =
      static_cast<std::size_t>(height_px_) * static_cast<std::size_t>(width_px_);
  band_of_.assign(count, kBackground);
  const double radius = std::sqrt(options.valid_frac / std::numbers::pi);  // of an ellipse in 1 x 1
  for (int row = 0; row < height_px_; ++row)
    for (int col = 0; col < width_px_; ++col) {
      const bool is_face =
          std::hypot((row + 0.5) / height_px_ - 0.5, (col + 0.5) / width_px_ - 0.5) < radius;
      if (!is_face && !options.is_background_fitted) continue;
      const int band = row % 2 == 0 ? col % 2 : 1 + col % 2;  // RGGB
      const auto element = static_cast<std::uint32_t>(row) * static_cast<std::uint32_t>(width_px_) +
                           static_cast<std::uint32_t>(col);
      if (is_face) band_of_[element] = static_cast<std::uint8_t>(band);
      bands[static_cast<std::size_t>(band)].elements.push_back(element);
    }
  std::vector<std::vector<float>> by_band;
  for (const SpeedBand& band : bands) by_band.push_back(profiles(band));
  std::mt19937_64 random(1);
  std::normal_distribution<float> normal;
  std::vector<float> normals(kNormals);
  for (float& value : normals) value = normal(random);
  for (std::size_t frame = 0; frame < 2 * shifts_px.size(); ++frame)
    frames.emplace_back(height_px_, width_px_);
  tbb::parallel_for(std::size_t{0}, frames.size(),
                    [&](std::size_t frame) { expose(frame, by_band, normals); });
}

int SpeedScene::level(std::uint32_t element) const {
  const auto row = static_cast<int>(element) / width_px_,
             col = static_cast<int>(element) % width_px_;
  const auto step = [](double wave) {
    return std::clamp(static_cast<int>(kLevels * (0.5 + 0.5 * wave)), 0, kLevels - 1);
  };
  return kLevels * step(std::sin(row * 0.011) * std::cos(col * 0.007)) +
         step(std::sin(row * 0.005 + col * 0.009));
}

ShapePoint SpeedScene::truth(const SpeedBand& band, std::uint32_t element) const {
  const int at = level(element);
  const auto offset = [](int step) { return kVariation * (2.0 * step / (kLevels - 1) - 1); };
  return {band.skin.logit_reflectance + offset(at / kLevels),
          band.skin.log_translucency_px + offset(at % kLevels)};
}

float SpeedScene::position_px(std::uint32_t element) const {
  const auto row = static_cast<int>(element) / width_px_,
             col = static_cast<int>(element) % width_px_;
  return static_cast<float>(1600 + 7 * col + row / 3) / kStepsPerPx;
}

float SpeedScene::full_signal(std::uint32_t element) const {
  const auto col = static_cast<int>(element) % width_px_;
  const float across = static_cast<float>(col) / static_cast<float>(width_px_) - 0.5F;
  return static_cast<float>(kSpeedFullSignal) * (1 - across * across);
}

double SpeedScene::contrast(int harmonic) const {
  const double wave = 2 * std::numbers::pi * harmonic / shape.period_px * kBlurPx;
  return std::exp(-0.5 * wave * wave);
}

ShapeRange SpeedScene::range(const SpeedBand& band, bool is_wide) const {
  if (is_wide) return {};
  // As the estimator takes it: what the scene holds and a margin.
  const double logit = kVariation + 0.25, log = kVariation + 0.3;
  return {{band.skin.logit_reflectance - logit, band.skin.log_translucency_px - log},
          {band.skin.logit_reflectance + logit, band.skin.log_translucency_px + log}};
}

int SpeedScene::harmonic_count(const SpeedBand& band, bool is_wide, int limit) const {
  constexpr int kMost = 40;
  constexpr double kSmallest = 1e-4;  // of the mean: a tenth of the noise
  const ShapePoint sharpest{range(band, false).greatest.logit_reflectance,
                            range(band, is_wide).least.log_translucency_px};
  const auto harmonics = harmonics_of(*model, shape, sharpest, kMost);
  int count = 2;
  for (int n = 1; n <= (limit > 0 ? limit : kMost); ++n)
    if (std::abs(harmonics[static_cast<std::size_t>(n - 1)]) * contrast(n) >
        kSmallest * envelope(shape, 1) * reflectance_of(sharpest))
      count = n;
  return limit > 0 ? std::max(limit, 2) : count;
}

// [level][position in steps] reflectance factors.
std::vector<float> SpeedScene::profiles(const SpeedBand& band) const {
  constexpr int kMost = 60;
  const int positions = shape.period_px * kStepsPerPx;
  std::vector<float> values;
  for (int level = 0; level < kLevels * kLevels; ++level) {
    const auto offset = [](int step) { return kVariation * (2.0 * step / (kLevels - 1) - 1); };
    const ShapePoint point{band.skin.logit_reflectance + offset(level / kLevels),
                           band.skin.log_translucency_px + offset(level % kLevels)};
    const auto harmonics = harmonics_of(*model, shape, point, kMost);
    const double mean =
        (static_cast<double>(shape.width_px) / shape.period_px + kSpeedProjectorBlack) *
        (reflectance_of(point) + kIndirect);
    for (int position = 0; position < positions; ++position) {
      const double angle =
          2 * std::numbers::pi / shape.period_px *
          (static_cast<double>(position) / kStepsPerPx - 0.5 * (shape.width_px - 1));
      double sum = mean;
      for (int n = 1; n <= kMost; ++n)
        sum += 2 * harmonics[static_cast<std::size_t>(n - 1)] * contrast(n) * std::cos(n * angle);
      values.push_back(static_cast<float>(sum));
    }
  }
  return values;
}

void SpeedScene::expose(std::size_t frame, std::span<const std::vector<float>> profiles,
                        std::span<const float> normal) {
  const int positions = shape.period_px * kStepsPerPx;
  const int shift = shifts_px[frame / 2] * kStepsPerPx;
  const auto exposure_us = static_cast<float>(kSpeedExposuresUs[frame % 2]);
  std::uint64_t state = 0x9E3779B97F4A7C15ULL * (frame + 1);
  const std::span<std::uint16_t> out = frames[frame].samples();
  for (std::size_t element = 0; element < out.size(); ++element) {
    state ^= state << 13, state ^= state >> 7, state ^= state << 17;
    float light_dn = 0;
    if (band_of_[element] != kBackground) {
      const auto at = static_cast<std::uint32_t>(element);
      const int position =
          (static_cast<int>(position_px(at) * kStepsPerPx) - shift + 100 * positions) % positions;
      const float reflectance =
          profiles[band_of_[element]][static_cast<std::size_t>(level(at) * positions + position)];
      light_dn = reflectance * full_signal(at) * exposure_us;
    }
    constexpr float kReadVariance = static_cast<float>(kReadNoiseElectrons * kReadNoiseElectrons /
                                                       (kElectronsPerDn * kElectronsPerDn));
    const float sd_dn = std::sqrt(light_dn / static_cast<float>(kElectronsPerDn) + kReadVariance);
    const float dn =
        static_cast<float>(kSpeedBlackDn) + light_dn + sd_dn * normal[state % kNormals];
    out[element] = static_cast<std::uint16_t>(std::clamp(std::lround(dn), 0L, 4095L));
  }
}

}  // namespace bench
