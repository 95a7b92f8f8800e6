#include "tests/bench/sweep_errors_bench.h"

#include <cmath>

#include "estimation/models/dipole.h"
#include "estimation/profile/likelihood_scene.h"
#include "estimation/profile/sweep_errors.h"
#include "estimation/session/maps.h"
#include "tests/bench/errors.h"

namespace bench {
namespace {

using estimation::BandLikelihood;
using estimation::Image;
using estimation::ImageView;
using estimation::SweepCorrection;
using estimation::truth::PeriodicCurve;

constexpr double kPitchMm = 0.3;
constexpr int kSidePx = 96;
constexpr std::size_t kSites = static_cast<std::size_t>(kSidePx) * kSidePx;

struct Wrong {
  const char* name;
  double blur_px, drift_px;
};

// A mono camera's image whose pixels show the media in turn, each at its own place in the stripes.
class WrongScene {
 public:
  WrongScene(Bench& bench, const std::vector<NamedMedium>& media, const Wrong& wrong)
      : pixels_(simulate(plan(bench, media, wrong))),
        camera_(mono_camera()),
        gain_(kSidePx, kSidePx, 1, 1.0F),
        distance_(kSidePx, kSidePx, 1, 800.0F),
        validity_(kSidePx, kSidePx, 1, 0U),
        geometry_{.position_px = view(pixels_.position_px.data()),
                  .gain = std::as_const(gain_).view(),
                  .projector_distance_mm = std::as_const(distance_).view(),
                  .validity = std::as_const(validity_).view()},
        transfer_(*estimation::HarmonicTransfer::create(std::nullopt, {}, camera_)),
        radiometry_{.band = 0,
                    .signal_per_us = estimation::truth::Sensor{}.full_signal_dn_per_us(),
                    .noise = pixels_.noise} {
    stripes_.shape = pixels_.shape;
    stripes_.shifts_px = pixels_.shifts_px;
    for (std::size_t shift = 0; shift < pixels_.shifts_px.size(); ++shift)
      signals_.push_back(view(pixels_.samples.data() + shift * pixels_.stride));
  }

  estimation::StripeScene scene() const {
    return {.camera = camera_,
            .stripes = stripes_,
            .signals = signals_,
            .geometry = geometry_,
            .transfer = transfer_,
            .model = dipole_};
  }
  const estimation::BandRadiometry& radiometry() const { return radiometry_; }
  const PixelSet& pixels() const { return pixels_; }
  const estimation::ScatteringModel& model() const { return dipole_; }

 private:
  PixelPlan plan(Bench& bench, const std::vector<NamedMedium>& media, const Wrong& wrong) {
    PixelPlan made = bench.plan(kPitchMm, 0.02, 40, 1, kSites);
    made.subjects.clear();
    curves_.reserve(media.size());  // subjects point into it
    for (const NamedMedium& named : media) {
      Subject subject = bench.subject(named.medium, kPitchMm);
      curves_.push_back(subject.curve->blurred(wrong.blur_px));
      subject.curve = &curves_.back();
      made.subjects.push_back(subject);
    }
    made.view.drift_px = wrong.drift_px;
    return made;
  }
  static estimation::CameraInfo mono_camera() {
    estimation::CameraInfo camera;
    camera.width_px = camera.height_px = kSidePx;
    return camera;
  }
  static ImageView<const float> view(const float* data) {
    return {data, kSidePx, kSidePx, 1, kSidePx};
  }

  std::vector<PeriodicCurve> curves_;
  estimation::Dipole dipole_{kEta};
  PixelSet pixels_;
  estimation::CameraInfo camera_;
  Image<float> gain_, distance_;
  Image<std::uint32_t> validity_;
  estimation::SceneGeometry geometry_;
  estimation::HarmonicTransfer transfer_;
  estimation::StripeSet stripes_;
  std::vector<ImageView<const float>> signals_;
  estimation::BandRadiometry radiometry_;
};

// Of each medium by itself.
std::vector<Errors> errors_after(const WrongScene& wrong, const BandLikelihood& band,
                                 const SweepCorrection& correction) {
  const auto scene = wrong.scene();
  const estimation::SiteFits fits =
      band.fit(valid_sites(scene.camera, 0, scene.geometry.validity), correction);
  const std::size_t media = wrong.pixels().subjects.size();
  std::vector<Errors> all;
  for (std::size_t medium = 0; medium < media; ++medium) {
    PixelSet own;
    own.subjects = {wrong.pixels().subjects[medium]};
    own.indirect = wrong.pixels().indirect;
    std::vector<Estimate> estimates;
    for (std::size_t i = 0; i < fits.sites.size(); ++i) {
      const std::size_t pixel = static_cast<std::size_t>(fits.sites[i].row) * kSidePx +
                                static_cast<std::size_t>(fits.sites[i].col);
      if (pixel % media != medium) continue;
      const auto logit = static_cast<double>(fits.fit.logit_reflectance[i]);
      estimates.push_back(
          {.diffuse_reflectance = 1 / (1 + std::exp(-logit)),
           .translucency_px = std::exp(static_cast<double>(fits.fit.log_translucency_px[i])),
           .indirect = static_cast<double>(fits.fit.indirect[i]),
           .reduced_chi_square = static_cast<double>(fits.fit.reduced_chi_square[i]),
           .is_valid = (fits.fit.validity[i] & estimation::kValidityErrors) == 0});
    }
    own.count = estimates.size();
    all.push_back(errors_of(own, estimates, &wrong.model()));
  }
  return all;
}

std::string cell(const Errors& errors) {
  return percent(errors.translucency.bias, 2)
      .append(" / ")
      .append(percent(errors.sigma_a.bias, 2))
      .append(" / ")
      .append(percent(errors.sigma_s_prime.bias, 2))
      .append(" [")
      .append(digits(errors.median_chi_square, 3))
      .append("]");
}

}  // namespace

void show_estimated_sweep_errors(Bench& bench, const std::vector<NamedMedium>& media) {
  Table table{.name = "budget_estimated",
              .title =
                  "Blur and drift found in the data alone (9216 noisy pixels, B 0.02 and free): "
                  "bias of l_d / sigma_a / sigma_s' in percent [median reduced chi-square]",
              .columns = {"sweep", "blur found, px", "drift found, px", "corrected"}};
  for (const NamedMedium& named : media) table.columns.push_back(named.name);
  for (const Wrong& wrong : {Wrong{"nothing wrong", 0, 0}, Wrong{"blur, sigma 1 px", 1, 0},
                             Wrong{"drift of 0.5 px, in order", 0, 0.5}, Wrong{"both", 1, 0.5}}) {
    const WrongScene made(bench, media, wrong);
    const estimation::StripeScene scene = made.scene();
    std::vector<BandLikelihood> bands;
    bands.emplace_back(scene, made.radiometry(), 0, estimation::IndirectLight::kFree);
    std::vector<double> order;
    for (std::size_t i = 0; i < 40; ++i) order.push_back(static_cast<double>(i) / 39 - 0.5);
    const auto found = estimate_sweep_errors(scene, bands, order);
    if (!found) {
      table.rows.push_back({wrong.name, "too little to tell", "", ""});
      continue;
    }
    const auto earned = earned_correction(*found);
    const double blur_px = std::sqrt(std::abs(found->blur_px2));
    const auto rows = {std::pair{"no", SweepCorrection{}},
                       std::pair{"yes", correction_of(*found, earned, order)}};
    for (const auto& [is_corrected, correction] : rows) {
      if (&correction != &rows.begin()->second && !earned.any()) continue;
      table.rows.push_back(
          {wrong.name, digits(found->blur_px2 < 0 ? -blur_px : blur_px, 4),
           digits(found->drift_px, 4).append(" +- ").append(digits(found->drift_sd_px, 2)),
           is_corrected});
      for (const Errors& errors : errors_after(made, bands.front(), correction))
        table.rows.back().push_back(cell(errors));
    }
  }
  bench.report.table(table);
}

}  // namespace bench
