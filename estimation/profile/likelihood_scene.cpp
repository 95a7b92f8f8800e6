#include "estimation/profile/likelihood_scene.h"

#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "estimation/profile/gather_samples.h"
#include "estimation/profile/site_factors.h"
#include "estimation/session/maps.h"

namespace estimation {
namespace {

// Sites of a tile: its samples (160 kB at 40 shifts) stay in the second-level cache.
constexpr std::size_t kTile = 1024;
// From one row of a tile to the next: a power of two would put all of them into the same few places
// of the first-level cache (6% of the fit's time).
constexpr std::size_t kStride = kTile + 16;
constexpr std::size_t kPilotTile = 64;  // of the slow fits without a table
constexpr std::size_t kPilotCount = 2000;
// Fits where light's directions matter: what the surface does with them depends on the material.
constexpr int kDirectionRounds = 2;
// Around what the pilot found, in ln(R_d / (1 - R_d)) and ln l_d: its noise, and the sites between.
constexpr double kLogitMargin = 0.25, kLogMargin = 0.3;
// Of the pilot's values, fitted without the table: a stray pixel must not widen everybody's.
constexpr double kStrayFrac = 0.005;
// Of the mean; noise of a pixel's harmonics is ten times as much.
constexpr double kSmallestHarmonic = 1e-4;
constexpr int kGreatestHarmonicCount = 64;
// Optics and directions are told for this many at least: for pixels sharper than the table.
constexpr int kFewestFactors = 24;

std::size_t padded(std::size_t count) { return (count + 15) / 16 * 16; }

// Copies element `from` of one fit to `to` of another.
void copy_element(const BatchFit& source, std::size_t from, BatchFit& target, std::size_t to) {
  target.logit_reflectance[to] = source.logit_reflectance[from];
  target.log_translucency_px[to] = source.log_translucency_px[from];
  target.indirect[to] = source.indirect[from];
  target.phase_px[to] = source.phase_px[from];
  target.reduced_chi_square[to] = source.reduced_chi_square[from];
  target.validity[to] = source.validity[from];
  for (std::size_t c = 0; c < covariance_index(kUnknowns - 1, kUnknowns - 1) + 1; ++c)
    target.covariance[c * target.stride + to] = source.covariance[c * source.stride + from];
}

// As many harmonics as the sharpest material of the range shows. Those that a fit is not to use are
// in the samples all the same.
int visible_harmonics(const ScatteringModel& model, StripeShape shape, const ShapeRange& range) {
  constexpr int greatest = kGreatestHarmonicCount;
  const double duty = static_cast<double>(shape.width_px) / shape.period_px;
  const double l_d_px = std::exp(range.least.log_translucency_px);
  std::vector<double> k_times_l_d(static_cast<std::size_t>(greatest) + 1), transform;
  for (std::size_t n = 0; n < k_times_l_d.size(); ++n)
    k_times_l_d[n] = 2 * std::numbers::pi * static_cast<double>(n) / shape.period_px * l_d_px;
  transform.resize(k_times_l_d.size());
  int count = 1;
  for (const double logit : {range.least.logit_reflectance, range.greatest.logit_reflectance}) {
    model.transform(1 / (1 + std::exp(-logit)), k_times_l_d, transform);
    for (int n = count + 1; n <= greatest; ++n) {
      const double envelope = std::sin(std::numbers::pi * n * duty) / (std::numbers::pi * n * duty);
      if (std::abs(envelope * transform[static_cast<std::size_t>(n)]) >
          kSmallestHarmonic * transform[0])
        count = n;
    }
  }
  return count;
}

struct Spread {
  double least = 0, middle = 0, greatest = 0;
};

// Without the strays at both ends.
Spread spread_of(std::vector<double>& values) {
  std::sort(values.begin(), values.end());
  const std::size_t last = values.size() - 1;
  const auto strays = static_cast<std::size_t>(kStrayFrac * static_cast<double>(last));
  return {values[strays], values[last / 2], values[last - strays]};
}

struct Occupied {
  ShapeRange range;
  ShapePoint typical;
};

// What the valid fits occupy, with a margin; nullopt if there is none.
std::optional<Occupied> occupied(const BatchFit& fit, std::size_t count) {
  std::vector<double> logits, logs;
  for (std::size_t i = 0; i < count; ++i) {
    if ((fit.validity[i] & kValidityErrors) != 0) continue;
    logits.push_back(static_cast<double>(fit.logit_reflectance[i]));
    logs.push_back(static_cast<double>(fit.log_translucency_px[i]));
  }
  if (logits.empty()) return std::nullopt;
  const Spread logit = spread_of(logits), log = spread_of(logs);
  return Occupied{.range = {{logit.least - kLogitMargin, log.least - kLogMargin},
                            {logit.greatest + kLogitMargin, log.greatest + kLogMargin}},
                  .typical = {logit.middle, log.middle}};
}

// One tile's pixels as BatchFitter takes them. One per thread, used again and again.
class Tile {
 public:
  Tile(const StripeScene& scene, const BandRadiometry& radiometry, int harmonic_count,
       const SweepCorrection& correction)
      : scene_(scene),
        radiometry_(radiometry),
        offset_px_(correction.offset_px),
        channel_(channel_of(scene.camera, radiometry.band)),
        factors_(scene, radiometry.band, harmonic_count, correction.blur_px2),
        factor_count_(static_cast<std::size_t>(harmonic_count) + 1),
        factor_stride_(factors_.is_uniform() ? 1 : kStride),
        elements_(kTile),
        samples_(scene.signals.size() * kStride),
        position_px_(kStride),
        full_signal_(kStride) {
    if (!factors_.is_unity()) {
      factor_re_.resize(factor_count_ * factor_stride_);
      factor_im_.resize(factor_count_ * factor_stride_);
    }
    fit_.resize(kStride);
    if (factors_.is_uniform() && !factors_.is_unity()) set_factors(0, factors_.at({}, {}));
  }

  // Fits up to kTile sites; the result stays until the next call.
  const BatchFit& fit(const BatchFitter& fitter, std::span<const Site> sites, ShapePoint typical) {
    load(sites, typical);
    fitter.fit(batch(sites.size()), fit_);
    for (int round = 1; factors_.needs_material() && round < kDirectionRounds; ++round) {
      for (std::size_t i = 0; i < sites.size(); ++i)
        if ((fit_.validity[i] & kValidityErrors) == 0)
          set_factors(i, factors_.at(sites[i], {static_cast<double>(fit_.logit_reflectance[i]),
                                                static_cast<double>(fit_.log_translucency_px[i])}));
      fitter.fit(batch(sites.size()), fit_);
    }
    return fit_;
  }

 private:
  void load(std::span<const Site> sites, ShapePoint typical) {
    const ImageView<const float>& like = scene_.signals.front();
    for (std::size_t i = 0; i < sites.size(); ++i)
      elements_[i] =
          static_cast<std::uint32_t>(&like.at(sites[i].row, sites[i].col, channel_) - like.data);
    gather_samples(scene_.signals, std::span(elements_).first(sites.size()), kStride, samples_);
    const SceneGeometry& geometry = scene_.geometry;
    for (std::size_t i = 0; i < sites.size(); ++i) {
      position_px_[i] = geometry.position_px.at(sites[i].row, sites[i].col);
      full_signal_[i] =
          static_cast<float>(radiometry_.signal_per_us *
                             static_cast<double>(geometry.gain.at(sites[i].row, sites[i].col)));
      if (!factors_.is_uniform()) set_factors(i, factors_.at(sites[i], typical));
    }
    for (std::size_t i = sites.size(); i < padded(sites.size()); ++i) {
      position_px_[i] = 0;
      full_signal_[i] = 1;
    }
  }

  void set_factors(std::size_t i, std::span<const std::complex<double>> factors) {
    for (std::size_t n = 0; n < factors.size(); ++n) {
      factor_re_[n * factor_stride_ + i] = static_cast<float>(factors[n].real());
      factor_im_[n * factor_stride_ + i] = static_cast<float>(factors[n].imag());
    }
  }

  PixelBatch batch(std::size_t count) const {
    return {.count = count,
            .stride = kStride,
            .samples = samples_,
            .position_px = position_px_,
            .full_signal = full_signal_,
            .factor_re = factor_re_,
            .factor_im = factor_im_,
            .factor_count = factors_.is_unity() ? 0 : static_cast<int>(factor_count_),
            .offset_px = offset_px_};
  }

  const StripeScene& scene_;
  const BandRadiometry& radiometry_;
  std::span<const float> offset_px_;
  int channel_;
  SiteFactors factors_;
  std::size_t factor_count_, factor_stride_;
  std::vector<std::uint32_t> elements_;
  std::vector<float> samples_, position_px_, full_signal_, factor_re_, factor_im_;
  BatchFit fit_;
};

}  // namespace

BandLikelihood::BandLikelihood(const StripeScene& scene, const BandRadiometry& radiometry,
                               int harmonic_count, IndirectLight indirect,
                               const SweepCorrection& correction)
    : scene_(scene), radiometry_(radiometry), harmonic_limit_(harmonic_count), indirect_(indirect) {
  pilot_.sites = evenly_chosen(valid_sites(scene.camera, radiometry.band, scene.geometry.validity),
                               kPilotCount);
  if (pilot_.sites.empty()) return;
  const StripeShape shape = scene.stripes.shape;
  pilot_.fit.resize(padded(pilot_.sites.size()));
  fit_all(correction, pilot_);
  const std::optional<Occupied> found = occupied(pilot_.fit, pilot_.sites.size());
  if (!found) return;
  typical_ = found->typical;
  table_.emplace(scene.model, shape, found->range,
                 visible_harmonics(scene.model, shape, found->range));
}

double BandLikelihood::full_signal_per_us(Site site) const {
  return radiometry_.signal_per_us *
         static_cast<double>(scene_.geometry.gain.at(site.row, site.col));
}

FitProblem BandLikelihood::problem() const {
  return {.shape = scene_.stripes.shape,
          .shifts_px = scene_.stripes.shifts_px,
          .noise = radiometry_.noise,
          .projector_black_frac = radiometry_.projector_black_frac,
          .model = &scene_.model,
          .table = table_ ? &*table_ : nullptr,
          .harmonic_count = harmonic_limit_,
          .indirect = indirect_};
}

void BandLikelihood::fit_all(const SweepCorrection& correction, SiteFits& fits) const {
  const BatchFitter fitter(problem());
  const int factor_count = std::max(harmonic_count(), kFewestFactors);
  tbb::enumerable_thread_specific<Tile> tiles(
      [&] { return Tile(scene_, radiometry_, factor_count, correction); });
  const std::size_t tile_size = table_ ? kTile : kPilotTile;
  const std::size_t tile_count = (fits.sites.size() + tile_size - 1) / tile_size;
  tbb::parallel_for(std::size_t{0}, tile_count, [&](std::size_t tile) {
    const std::size_t first = tile * tile_size;
    const std::size_t count = std::min(tile_size, fits.sites.size() - first);
    const BatchFit& found =
        tiles.local().fit(fitter, std::span(fits.sites).subspan(first, count), typical_);
    for (std::size_t i = 0; i < count; ++i) copy_element(found, i, fits.fit, first + i);
  });
}

SiteFits BandLikelihood::fit(std::vector<Site> sites, const SweepCorrection& correction) const {
  SiteFits fits{.sites = std::move(sites), .fit = {}};
  fits.fit.resize(padded(fits.sites.size()));
  fit_all(correction, fits);
  return fits;
}

}  // namespace estimation
