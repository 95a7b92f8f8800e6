#include "estimation/refine/sample_correction.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "estimation/profile/site_factors.h"
#include "estimation/refine/spatial_correction.h"

namespace estimation {
namespace {

constexpr int kHarmonics = 8;  // above them a profile's harmonics are noise

// The correction of every sample of one site, as a reflectance factor. One per task.
class SiteCorrector {
 public:
  SiteCorrector(const CorrectionInput& input, int band, double projector_black_frac,
                const LitPatches& patches, const RadialProfile& profile)
      : surface_(input.surface),
        shape_(input.scene.stripes.shape),
        projector_black_frac_(projector_black_frac),
        factors_(input.scene, band, kHarmonics, 0),
        spatial_(input.surface, patches, profile, shape_.period_px, kHarmonics),
        change_(kHarmonics + 1) {}

  bool load(Site site, const SpreadMaterial& material) {
    if (!(material.diffuse_reflectance > 0 && material.diffuse_reflectance < 1 &&
          material.translucency_mm > 0))
      return false;
    if (!spatial_.at(site.row, site.col, material, change_)) return false;
    const double pitch_mm = static_cast<double>(surface_.pitch_mm.at(site.row, site.col));
    const auto factors = factors_.at(
        site, {.logit_reflectance =
                   std::log(material.diffuse_reflectance / (1 - material.diffuse_reflectance)),
               .log_translucency_px = std::log(material.translucency_mm / pitch_mm)});
    const double duty = static_cast<double>(shape_.width_px) / shape_.period_px;
    mean_ = (duty + projector_black_frac_) * (factors[0] * change_[0]).real();
    for (std::size_t n = 1; n <= kHarmonics; ++n) {
      const double angle = std::numbers::pi * static_cast<double>(n) * duty;
      change_[n] *= 2 * duty * std::sin(angle) / angle * factors[n];
    }
    position_px_ = static_cast<double>(surface_.position_px.at(site.row, site.col)) -
                   0.5 * (shape_.width_px - 1);
    return true;
  }

  double at(int shift_px) const {
    const auto turn =
        std::polar(1.0, 2 * std::numbers::pi * (position_px_ - shift_px) / shape_.period_px);
    std::complex<double> power = turn;
    double sum = mean_;
    for (std::size_t n = 1; n <= kHarmonics; ++n, power *= turn) sum += (change_[n] * power).real();
    return sum;
  }

 private:
  const LitSurface& surface_;
  StripeShape shape_;
  double projector_black_frac_;
  SiteFactors factors_;
  SpatialCorrection spatial_;
  std::vector<std::complex<double>> change_;
  double mean_ = 0, position_px_ = 0;
};

}  // namespace

SampleCorrection::SampleCorrection(const CameraInfo& camera, int band,
                                   std::span<const ImageView<const float>> signals,
                                   ImageView<const unsigned char> wanted)
    : band_(band), channel_(channel_of(camera, band)), sample_count_(signals.size()) {
  for (int row = 0; row < camera.height_px; ++row)
    for (int col = 0; col < camera.width_px; ++col)
      if (wanted.at(row, col) != 0 && is_site(camera, band, row, col)) sites_.push_back({row, col});
  measured_.reserve(sites_.size() * sample_count_);
  for (const Site& site : sites_)
    for (const auto& signal : signals) measured_.push_back(signal.at(site.row, site.col, channel_));
}

void SampleCorrection::apply(const CorrectionInput& input, const BandMaterial& material,
                             double signal_per_us, double projector_black_frac,
                             std::span<const ImageView<float>> signals) const {
  const double translucency_mm = typical_translucency_mm(input.surface, material);
  const double pixel_mm = typical_pixel_mm(input.surface);
  if (!(translucency_mm > 0 && pixel_mm > 0)) return restore(signals);
  const LitPatches patches(input.surface, LitPatches::side_for(translucency_mm, pixel_mm),
                           input.scene.stripes.shape.period_px);
  const RadialProfile profile(input.scene.model, 0.01, 0.99);
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, sites_.size(), 64), [&](const auto& range) {
    SiteCorrector corrector(input, band_, projector_black_frac, patches, profile);
    for (std::size_t i = range.begin(); i != range.end(); ++i) {
      const auto [row, col] = sites_[i];
      const SpreadMaterial here{static_cast<double>(material.diffuse_reflectance.at(row, col)),
                                static_cast<double>(material.translucency_mm.at(row, col))};
      const bool is_known = corrector.load({row, col}, here);
      const double full = signal_per_us * static_cast<double>(input.surface.gain.at(row, col));
      for (std::size_t k = 0; k < sample_count_; ++k) {
        const float measured = measured_[i * sample_count_ + k];
        signals[k].at(row, col, channel_) =
            is_known ? static_cast<float>(static_cast<double>(measured) -
                                          full * corrector.at(input.scene.stripes.shifts_px[k]))
                     : measured;
      }
    }
  });
}

void SampleCorrection::restore(std::span<const ImageView<float>> signals) const {
  for (std::size_t i = 0; i < sites_.size(); ++i)
    for (std::size_t k = 0; k < sample_count_; ++k)
      signals[k].at(sites_[i].row, sites_[i].col, channel_) = measured_[i * sample_count_ + k];
}

}  // namespace estimation
