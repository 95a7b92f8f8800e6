#include "estimation/calibration/transfer_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>

#include "tests/estimation/geometry/synthetic_frames.h"

namespace estimation {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::NormalDeviates;

constexpr int kHarmonics = 16;  // of the synthetic stripes; 11 and more would fold at 20 shifts

// A flat target under 40 shifts: each harmonic of the stripes at its own contrast, with noise.
struct SyntheticTarget {
  int width_px = 200, height_px = 150;
  double pitch_mm = 0.3, distance_mm = 1030;
  double noise_frac = 0.02;  // of the fully lit signal
  double position_error_px = 0;
  // Contrast of n cycles per 40 px for a band at a column of the camera.
  std::function<double(int n, int band, int col)> contrast;
};

double gaussian(int n, double sigma_px) {
  const double k = 2 * std::numbers::pi * n / 40;
  return std::exp(-k * k * sigma_px * sigma_px / 2);
}

class SyntheticSweep {
 public:
  explicit SyntheticSweep(const SyntheticTarget& target) {
    camera_.width_px = target.width_px;
    camera_.height_px = target.height_px;
    camera_.pixel_format = {ColorFilter::kBayerRG, 12};
    position_ = pitch_ = distance_ = Image<float>(target.height_px, target.width_px);
    NormalDeviates deviates(3);
    const auto position = [](int row, int col) { return 300 + 0.93 * col - 0.05 * row; };
    for (int row = 0; row < target.height_px; ++row)
      for (int col = 0; col < target.width_px; ++col) {
        position_.at(row, col) = static_cast<float>(position(row, col) + target.position_error_px);
        pitch_.at(row, col) = static_cast<float>(target.pitch_mm);
        distance_.at(row, col) = static_cast<float>(target.distance_mm);
      }
    // [band][col][n - 1] amplitude
    std::vector<double> amplitude;
    for (int band = 0; band < 3; ++band)
      for (int col = 0; col < target.width_px; ++col)
        for (int n = 1; n <= kHarmonics; ++n) {
          const double x = std::numbers::pi * n / 5;
          amplitude.push_back(0.4 * std::sin(x) / x * target.contrast(n, band, col));
        }
    for (int shift = 0; shift < 40; ++shift) {
      Image<float> frame(target.height_px, target.width_px);
      for (int row = 0; row < target.height_px; ++row)
        for (int col = 0; col < target.width_px; ++col) {
          const int band = band_at(camera_, row, col);
          const double* own =
              &amplitude[static_cast<std::size_t>((band * target.width_px + col) * kHarmonics)];
          double value = 0.2;
          for (int n = 1; n <= kHarmonics; ++n)
            value += own[n - 1] *
                     std::cos(2 * std::numbers::pi * n * (position(row, col) - shift - 3.5) / 40);
          const double level = 0.15 * (1 + 0.2 * band);
          frame.at(row, col) =
              static_cast<float>(level * (value + target.noise_frac * deviates.next()));
        }
      frames_.push_back(std::move(frame));
    }
  }

  TransferSweep sweep() const {
    TransferSweep sweep;
    sweep.position_px = position_.view();
    sweep.pitch_mm = pitch_.view();
    sweep.projector_distance_mm = distance_.view();
    for (std::size_t i = 0; i < frames_.size(); ++i) {
      sweep.shift_px.push_back(static_cast<int>(i));
      sweep.signals.push_back(frames_[i].view());
    }
    return sweep;
  }
  const CameraInfo& camera() const { return camera_; }

 private:
  CameraInfo camera_;
  Image<float> position_, pitch_, distance_;
  std::vector<Image<float>> frames_;
};

TEST(TransferFit, BlurOfEachColourToATenthOfAPixel) {
  for (const double blur_px : {0.3, 0.6, 1.0, 2.0}) {
    SCOPED_TRACE(blur_px);
    SyntheticTarget target;
    target.position_error_px = 0.03;
    target.contrast = [&](int n, int band, int) { return gaussian(n, blur_px + 0.2 * band); };
    const SyntheticSweep sweep(target);
    const auto fit = fit_transfer(sweep.sweep(), sweep.camera());
    ASSERT_TRUE(fit) << fit.error().text();
    for (int band = 0; band < 3; ++band) {
      const TransferCurve& curve = fit->bands[static_cast<std::size_t>(band)];
      EXPECT_NEAR(curve.blur_px.value, blur_px + 0.2 * band, 0.02);
      std::printf("blur %.2f px: found %.4f +- %.4f\n", blur_px + 0.2 * band, curve.blur_px.value,
                  curve.blur_px.sd);
      for (int n = 1; n <= 6; ++n) {
        const Measured& m = curve.contrast[static_cast<std::size_t>(n - 1)];
        EXPECT_NEAR(m.value, gaussian(n, blur_px + 0.2 * band), 0.005) << n;
      }
    }
    EXPECT_FALSE(fit->scattering.is_scattering);
    EXPECT_THAT(fit->warnings, IsEmpty());
    EXPECT_NEAR(fit->distance_mm, 1030, 0.1);
  }
}

TEST(TransferFit, BlurThatGrowsAcrossTheFieldIsMapped) {
  SyntheticTarget target;
  target.noise_frac = 0.005;
  target.contrast = [&](int n, int, int col) { return gaussian(n, 0.5 + 1.0 * col / 200); };
  const SyntheticSweep sweep(target);
  const auto fit = fit_transfer(sweep.sweep(), sweep.camera());
  ASSERT_TRUE(fit) << fit.error().text();
  const auto maps = transfer_maps(*fit, sweep.camera());
  ASSERT_EQ(maps.size(), 27U);
  for (const int col : {25, 100, 175})
    for (const int n : {1, 2, 4, 6}) {
      SCOPED_TRACE(std::to_string(col) + " " + std::to_string(n));
      const float value = maps.at("G." + std::to_string(n)).at(75, col);
      EXPECT_NEAR(static_cast<double>(value), gaussian(n, 0.5 + 1.0 * col / 200), 0.015);
    }
  EXPECT_FALSE(fit->scattering.is_scattering);
}

// R~(k) of a half space, design/estimation.md section 1, over its value at 0.
double dipole_ratio(double k_per_mm, double sigma_a, double sigma_s) {
  constexpr double kBoundary = 2.9479;  // A at eta 1.4
  const double sigma_t = sigma_a + sigma_s, z_r = 1 / sigma_t;
  const double z_v = z_r * (1 + 4 * kBoundary / 3);
  const auto transform = [&](double k) {
    const double q = std::sqrt(3 * sigma_a * sigma_t + k * k);
    return std::exp(-z_r * q) + std::exp(-z_v * q);
  };
  return transform(k_per_mm) / transform(0);
}

TEST(TransferFit, AScatteringTargetIsTold) {
  // Like Spectralon: hardly any absorption, a scattering length of a fraction of a millimetre.
  for (const double sigma_s_per_mm : {1.5, 4.0, 10.0}) {
    SCOPED_TRACE(sigma_s_per_mm);
    SyntheticTarget target;
    target.contrast = [&](int n, int, int) {
      const double k_per_mm = 2 * std::numbers::pi * n / (40 * 0.3);
      return gaussian(n, 0.8) * dipole_ratio(k_per_mm, 5e-5, sigma_s_per_mm);
    };
    const SyntheticSweep sweep(target);
    const auto fit = fit_transfer(sweep.sweep(), sweep.camera());
    ASSERT_TRUE(fit) << fit.error().text();
    std::printf("chi-square %.0f as blur, %.0f as blur and scattering, l_d %.2f mm\n",
                fit->scattering.chi2_blur, fit->scattering.chi2_scattering,
                fit->scattering.translucency_mm);
    EXPECT_TRUE(fit->scattering.is_scattering);
    EXPECT_THAT(fit->warnings, Contains(HasSubstr("scatters")));
  }
}

// Defocus is no Gaussian, and still no scattering.
TEST(TransferFit, AnOpaqueTargetOutOfFocusIsNotAccused) {
  SyntheticTarget target;
  target.contrast = [](int n, int, int) {
    const double x = 2 * std::numbers::pi * n / 40 * 2.2;  // a disc of radius 2.2 px
    return 2 * std::cyl_bessel_j(1.0, x) / x;
  };
  const SyntheticSweep sweep(target);
  const auto fit = fit_transfer(sweep.sweep(), sweep.camera());
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_FALSE(fit->scattering.is_scattering);
  EXPECT_NEAR(fit->bands[1].contrast[1].value, target.contrast(2, 0, 0), 0.005);
}

TEST(TransferFit, AnUnevenSweepIsRefused) {
  SyntheticTarget target;
  target.contrast = [](int, int, int) { return 1.0; };
  const SyntheticSweep frames(target);
  TransferSweep sweep = frames.sweep();
  sweep.signals.pop_back();
  sweep.shift_px.pop_back();
  const auto fit = fit_transfer(sweep, frames.camera());
  ASSERT_FALSE(fit);
  EXPECT_THAT(fit.error().text(), HasSubstr("evenly spaced"));
}

}  // namespace
}  // namespace estimation
