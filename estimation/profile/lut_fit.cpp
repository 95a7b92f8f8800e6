#include "estimation/profile/lut_fit.h"

#include <algorithm>
#include <cmath>

namespace estimation {
namespace {

// Beyond this standard deviation of ln l_d the value says nothing (design/estimation.md, section
// 3).
constexpr double kGreatestLogSd = 0.3;

bool is_in_table(const ProfileTable& table, double diffuse_reflectance) {
  return diffuse_reflectance >= table.range().least_reflectance &&
         diffuse_reflectance <= table.range().greatest_reflectance;
}

// Indirect light, not yet known, can make a bright surface look brighter than white; not by more
// than this.
constexpr double kGreatestFirstReflectance = 1.5;

// Below this a profile is the stripe itself: the match sees the optics and, through the table's
// last harmonic, the table (noise-free 0.16 reads as 0.14, everything below 0.08 as 0.10).
constexpr double kLeastTranslucencyPx = 0.2;

// Of the first match, where samples are missing: until R_d moves by less than noise does.
constexpr int kMostFirstMatches = 6;
constexpr double kSettledFrac = 0.003;

// The row of R_d, or the nearest one: the first R_d still contains the indirect light.
double nearest_row(const ProfileTable& table, double diffuse_reflectance) {
  return std::clamp(table.row_of(diffuse_reflectance), 0.0,
                    static_cast<double>(ProfileTable::kRows - 1));
}

LutFit failed(std::uint32_t reason) { return {.validity = reason}; }

}  // namespace

LutFit fit_with_table(ProfileMatcher& matcher, const ProfileTable& table,
                      double projector_black_frac) {
  const double duty = static_cast<double>(table.shape().width_px) / table.shape().period_px;

  // The fully lit image is the sum of the phases that together light every column once, that is the
  // mean of all over w/P. Projector black (a fraction of it) is constant under every phase.
  double fully_lit = matcher.mean() / (duty + projector_black_frac);
  double black = projector_black_frac * fully_lit;

  // First match, with R_d from the fully lit image.
  if (!(fully_lit > 0 && fully_lit < kGreatestFirstReflectance)) return failed(kOutsideModel);
  double row = nearest_row(table, fully_lit);
  ProfileMatch match = matcher.search(table, row, black);
  if (match.is_at_edge) return failed(kNotIdentifiable);
  ProfileMatcher::Curve curve = matcher.curve(table, row, match.col);
  // An incomplete sweep samples the profile unevenly; the matched curve says by how much its mean
  // differs from the mean over all phases, and the R_d that this makes has another curve. A full
  // sweep has 1.
  for (int i = 0; i < kMostFirstMatches; ++i) {
    const double before = fully_lit;
    fully_lit = matcher.mean() / (duty * curve.mean + projector_black_frac);
    black = projector_black_frac * fully_lit;
    if (std::abs(fully_lit - before) <= kSettledFrac * before) break;
    row = nearest_row(table, fully_lit);
    match = matcher.search(table, row, black);
    if (match.is_at_edge) return failed(kNotIdentifiable);
    curve = matcher.curve(table, row, match.col);
  }

  // Indirect light: the minimum of the input curve less the minimum of the matched curve.
  const double stripes_mean = matcher.mean() - black;
  const double indirect_per_phase = (curve.trough_of_samples - black) - stripes_mean * curve.trough;
  const double direct_mean = stripes_mean - indirect_per_phase;
  if (!(direct_mean > 0)) return failed(kNotIdentifiable);

  // Second match, with the indirect light subtracted from profile and R_d.
  const double diffuse_reflectance = direct_mean / (duty * curve.mean);
  if (!is_in_table(table, diffuse_reflectance)) return failed(kOutsideModel);
  row = table.row_of(diffuse_reflectance);
  match = matcher.search(table, row, black + indirect_per_phase, match.col);
  if (match.is_at_edge) return failed(kNotIdentifiable);

  const double translucency_px = table.translucency_px_at(match.col);
  if (translucency_px < kLeastTranslucencyPx) return failed(kNotIdentifiable);

  const double sample_count = static_cast<double>(matcher.sample_count());
  const double residual_variance = match.cost / (sample_count - 2);
  const double bend = match.curvature / (table.log_step() * table.log_step());
  const double log_sd = bend > 0 ? std::sqrt(2 * residual_variance / bend) : 1;
  if (log_sd > kGreatestLogSd) return failed(kNotIdentifiable);
  return {.diffuse_reflectance = diffuse_reflectance,
          .translucency_px = translucency_px,
          .indirect = indirect_per_phase / duty,
          .rms_residual = std::sqrt(residual_variance),
          .log_translucency_sd = log_sd};
}

}  // namespace estimation
