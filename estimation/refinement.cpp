#include "estimation/refinement.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>
#include <utility>

#include "estimation/geometry/triangulation.h"
#include "estimation/lit_geometry.h"
#include "estimation/profile/site_factors.h"
#include "estimation/refine/apparent_position.h"
#include "estimation/refine/near_discontinuity.h"
#include "estimation/refine/sample_correction.h"
#include "estimation/stripe_signals.h"

namespace estimation {
namespace {

// Beyond one l_d from the end of the light three rounds leave 1.2% of sigma_a, four 0.5%.
constexpr int kRounds = 4;
// Light still comes from where the surface is too oblique for a fit.
constexpr double kLeastCosine = 0.1;
// A pixel whose surroundings change what it sees by this much is refined, wherever it lies.
constexpr float kLeastChange = 0.01F;

// Further round the surface's bends than a fit is tried.
SurfaceOptions lit_options(SurfaceOptions options) {
  options.min_cos_projector = std::min(options.min_cos_projector, kLeastCosine);
  options.min_cos_camera = std::min(options.min_cos_camera, kLeastCosine);
  return options;
}

// A surface as light falls on it. Borrows what it is given.
class LightScene {
 public:
  LightScene(const MaterialInput& input, const Surface& surface, Axis axis)
      : input_(input),
        surface_(surface),
        lit_(input, surface, axis),
        projector_centre_mm_(
            Stereo(input.manifest.calibration, input.manifest.camera).projector_centre_mm()) {}

  LitSurface view() const {
    const Surface& s = surface_;
    return {
        .position_mm = {s.position_mm[0].view(), s.position_mm[1].view(), s.position_mm[2].view()},
        .normal = {s.normal[0].view(), s.normal[1].view(), s.normal[2].view()},
        .position_px = lit_.position_px().view(),
        .pitch_mm = lit_.pitch_mm().view(),
        .gain = lit_.geometry().gain,
        .cos_projector = s.cos_projector.view(),
        .validity = lit_.geometry().validity,
        .projector_centre_mm = projector_centre_mm_};
  }

  // As the fit would see it; borrows from this.
  StripeScene stripe_scene(const StripeSet& stripes,
                           std::span<const ImageView<const float>> signals) const {
    return {.camera = input_.manifest.camera,
            .stripes = stripes,
            .signals = signals,
            .geometry = lit_.geometry(),
            .transfer = input_.transfer,
            .model = input_.model};
  }

 private:
  const MaterialInput& input_;
  const Surface& surface_;
  LitGeometry lit_;
  Vec3 projector_centre_mm_;
};

// The stripes as the fit sees them.
std::optional<StripeSet> sweep_of(const MaterialInput& input) {
  const auto placed = placed_stripes(input.signals.patterns, input.correspondence);
  if (!placed) return std::nullopt;
  return each_seen(*placed);
}

BandMaterial material_of(const Maps& maps, int band) {
  const auto b = static_cast<std::size_t>(band);
  return {maps.diffuse_reflectance[b].view(), maps.translucency_mm[b].view()};
}

bool has_material(const Maps& maps) { return !maps.translucency_mm[0].empty(); }

// Light reaches farthest in this one.
int widest_band(const LitSurface& surface, const Maps& maps) {
  int widest = 0;
  double widest_mm = 0;
  for (int band = 0; band < maps.band_count; ++band) {
    const double translucency_mm = typical_translucency_mm(surface, material_of(maps, band));
    if (translucency_mm > widest_mm) {
      widest = band;
      widest_mm = translucency_mm;
    }
  }
  return widest;
}

class Refinement {
 public:
  Refinement(const RefinementInput& input, StripeSet stripes, Maps& maps)
      : in_(input), stripes_(std::move(stripes)), maps_(maps) {
    for (const auto& sources : stripes_.sources) {
      Image<float>& rate = in_.signals.patterns[sources[0]].rate;
      signals_.push_back(rate.view());
      views_.push_back(rate.view());
    }
  }

  MaterialResult run() {
    // Once: the surface is in its place but for its creases already, and a second time feeds its
    // own noise back. Median error of a simulated face 0.0063 mm before, 0.0061 after one pass,
    // 0.0067 after two.
    if (moves_positions()) {
      correct_position();
      in_.surface = reconstructed(in_.surface_options);
    }
    const Surface lit_surface = reconstructed(lit_options(in_.surface_options));
    const LightScene scene(in_.material, lit_surface, stripes_.axis);
    const LitSurface surface = scene.view();
    const Image<unsigned char> wanted = pixels_to_refine(surface);
    std::vector<SampleCorrection> corrections;
    for (int band = 0; band < maps_.band_count; ++band)
      corrections.emplace_back(manifest().camera, band, views_, wanted.view());
    MaterialResult result;
    for (int round = 0; round < kRounds; ++round) {
      for (int band = 0; band < maps_.band_count; ++band)
        correct_samples(scene, surface, band, corrections[static_cast<std::size_t>(band)]);
      result = fit();
    }
    note(corrections, result);
    return result;
  }

 private:
  const Manifest& manifest() const { return in_.material.manifest; }

  // Where the fit's own phases have moved the surface they know better: under Monte Carlo skin the
  // median error was 0.0105 mm, 0.0149 after a pass.
  bool moves_positions() const { return !directionality_of(in_.material.model).has_shift; }

  Surface reconstructed(const SurfaceOptions& options) const {
    return reconstruct_surface(manifest().calibration, manifest().camera, manifest().projector,
                               in_.correspondence, options);
  }

  MaterialResult fit() {
    for (int band = 0; band < maps_.band_count; ++band)
      maps_.validity[static_cast<std::size_t>(band)] = in_.surface.validity;
    return estimate_material(in_.material, maps_);
  }

  std::vector<SpreadField> fields_of(const LitSurface& surface) const {
    std::vector<SpreadField> fields;
    for (int band = 0; band < maps_.band_count; ++band)
      fields.push_back(spread_field(manifest().camera, band, surface, material_of(maps_, band),
                                    in_.material.model, stripes_.shape));
    return fields;
  }

  void correct_position() {
    const Surface lit_surface = reconstructed(lit_options(in_.surface_options));
    const LightScene scene(in_.material, lit_surface, stripes_.axis);
    const LitSurface surface = scene.view();
    Correspondence& found = in_.correspondence;
    const bool is_column = stripes_.axis == Axis::kColumn;
    Image<float>& px = is_column ? found.column_px : found.row_px;
    Image<float>& sd_px = is_column ? found.column_sd_px : found.row_sd_px;
    Position corrected = true_position({.camera = manifest().camera,
                                        .stripes = stripes_,
                                        .signals = views_,
                                        .noise = in_.material.noise},
                                       surface, fields_of(surface), sd_px.view());
    px = std::move(corrected.px);
    // Beside noise: what the bends' correction may be wrong by, this one may be, too.
    for (std::size_t i = 0; i < sd_px.samples().size(); ++i)
      sd_px.samples()[i] = std::max(sd_px.samples()[i], corrected.sd_px.samples()[i]);
  }

  // Near a discontinuity, or where the spread light of the band in which it reaches farthest says
  // that the surface is not flat enough.
  Image<unsigned char> pixels_to_refine(const LitSurface& surface) const {
    const int band = widest_band(surface, maps_);
    Image<unsigned char> wanted = near_discontinuity(surface, material_of(maps_, band));
    const SpreadField field =
        spread_field(manifest().camera, band, surface, material_of(maps_, band), in_.material.model,
                     stripes_.shape);
    if (field.rows == 0) return wanted;
    const auto is_changed = [&](int i, int j) {
      return field.is_known(i, j) && (std::abs(field.mean_at(i, j) - 1) > kLeastChange ||
                                      std::abs(field.first_at(i, j) - 1.0F) > kLeastChange);
    };
    tbb::parallel_for(0, wanted.height_px(), [&](int row) {
      for (int col = 0; col < wanted.width_px(); ++col) {
        if (wanted.at(row, col) != 0 || !surface.is_lit(row, col)) continue;
        const int i0 = row / field.stride_px, j0 = col / field.stride_px;
        for (int i = i0; i <= std::min(i0 + 1, field.rows - 1); ++i)
          for (int j = j0; j <= std::min(j0 + 1, field.cols - 1); ++j)
            if (is_changed(i, j)) wanted.at(row, col) = 1;
      }
    });
    return wanted;
  }

  void correct_samples(const LightScene& scene, const LitSurface& surface, int band,
                       const SampleCorrection& correction) {
    const BandRadiometry radiometry = radiometry_of(in_.material, band);
    const StripeScene stripe_scene = scene.stripe_scene(stripes_, views_);
    correction.apply({.scene = stripe_scene, .surface = surface}, material_of(maps_, band),
                     radiometry.signal_per_us, radiometry.projector_black_frac, signals_);
  }

  void note(const std::vector<SampleCorrection>& corrections, MaterialResult& result) const {
    std::size_t refined = 0, valid = 0;
    for (int band = 0; band < maps_.band_count; ++band) {
      const auto b = static_cast<std::size_t>(band);
      refined += corrections[b].site_count();
      for (int row = 0; row < maps_.height_px; ++row)
        for (int col = 0; col < maps_.width_px; ++col) {
          valid += is_site(manifest().camera, band, row, col) &&
                   (maps_.validity[b].at(row, col) & kValidityErrors) == 0;
        }
    }
    const double percent =
        valid > 0 ? 100.0 * static_cast<double>(refined) / static_cast<double>(valid) : 0;
    char text[200];
    std::snprintf(text, sizeof text,
                  "refined with geometry: %sthe samples of %.0f%% of the sites, near "
                  "discontinuities and bends",
                  moves_positions() ? "the positions of all pixels, and " : "",
                  std::min(percent, 100.0));
    result.notes.emplace_back(text);
  }

  const RefinementInput& in_;
  StripeSet stripes_;
  Maps& maps_;
  std::vector<ImageView<float>> signals_;
  std::vector<ImageView<const float>> views_;
};

}  // namespace

void mark_near_discontinuity(const MaterialInput& input, Maps& maps) {
  const auto stripes = sweep_of(input);
  if (!stripes || !has_material(maps)) return;
  const LightScene scene(input, input.surface, stripes->axis);
  const LitSurface surface = scene.view();
  const Image<unsigned char> near =
      near_discontinuity(surface, material_of(maps, widest_band(surface, maps)));
  for (int band = 0; band < maps.band_count; ++band) {
    Image<std::uint32_t>& validity = maps.validity[static_cast<std::size_t>(band)];
    for (std::size_t i = 0; i < validity.samples().size(); ++i)
      if (near.samples()[i] != 0 && (validity.samples()[i] & kValidityErrors) == 0)
        validity.samples()[i] |= kNearDiscontinuity;
  }
}

std::optional<MaterialResult> refine_material(const RefinementInput& input, Maps& maps) {
  auto stripes = sweep_of(input.material);
  if (!stripes || !has_material(maps)) return std::nullopt;
  return Refinement(input, std::move(*stripes), maps).run();
}

}  // namespace estimation
