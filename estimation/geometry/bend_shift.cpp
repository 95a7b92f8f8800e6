#include "estimation/geometry/bend_shift.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>
#include <vector>

#include "estimation/geometry/bends.h"
#include "estimation/geometry/spread.h"
#include "estimation/geometry/triangulation.h"

namespace estimation {
namespace {

// Of the predicted shift; what shows less of it is left as it is.
constexpr double kLeastShownShare = 0.3;
// More than this is no first-order effect.
constexpr double kMostShiftPx = 1.5;

// std::hypot looks after overflow, for ten times the time.
double root_of_squares(double a, double b) { return std::sqrt(a * a + b * b); }

// Projector px by which the coordinate reads too high. With q the stripes' frequency on the surface
// (2 pi / pitch / period), light's relative change g along it and the coordinate's second
// derivatives h, the integral of R(d) (1 + g d) exp(i (q d + q h d^2 / 2)) has the phase
// -g R~'/R~ - (q / 2) (h_along R~''/R~ + h_across R~'/(q R~)): linear in what bends, with these
// factors of a spread.
struct ShiftFactors {
  double light = 0, along = 0, across = 0;

  double shift_px(const Bend& bend) const {
    const double mm_per_px = 1 / double{bend.gradient_px_per_mm};
    return mm_per_px * (light * double{bend.light_per_mm} +
                        mm_per_px * (along * double{bend.along_px_per_mm2} +
                                     across * double{bend.across_px_per_mm2}));
  }
};

ShiftFactors factors_of(const SpreadShape& spread, int harmonic, double period_px) {
  const double px_per_rad = period_px / (2 * std::numbers::pi);
  const double first = spread.first(harmonic) * px_per_rad * px_per_rad;
  const double second = spread.second(harmonic) * px_per_rad * px_per_rad;
  return {-first / harmonic, -second / 2, -first / harmonic / 2};
}

// As `source` sees it: a fit weighs each harmonic's phase by what it tells of the coordinate.
ShiftFactors factors_of(const SpreadShape& spread, const SpreadCells& cells, PhaseSource source) {
  if (source == PhaseSource::kFirstHarmonic) return factors_of(spread, 1, cells.period_px);
  constexpr int kHarmonics = 6;
  ShiftFactors sum;
  double weights = 0;
  for (int n = 1; n <= kHarmonics; ++n) {
    const double amplitude = stripe_harmonic(cells.period_px, cells.width_px, n) *
                             std::exp(spread.log_transfer(n) - spread.log_transfer(1));
    const double weight = n * amplitude * n * amplitude;
    const ShiftFactors factors = factors_of(spread, n, cells.period_px);
    sum.light += weight * factors.light;
    sum.along += weight * factors.along;
    sum.across += weight * factors.across;
    weights += weight;
  }
  return {sum.light / weights, sum.along / weights, sum.across / weights};
}

// How much of the predicted shift the data show: about 0.6 on faces (bends have noise of their own,
// which a fit takes for a weaker effect), nothing where a bend is noise alone or where light does
// not spread. The first harmonic is moved more than the second, by a known share: what their
// coordinates differ by is fitted by that, by what oblique light may do to them (towards the
// projector and the camera), and a constant, each band for itself.
double shown_share(const BendNodes& bends, const SpreadCells& cells) {
  constexpr int kTerms = 4;
  constexpr double kPriorSd = 0.5;  // around zero: the effect has to be seen
  // A cell's spread is that of nine cells: so many fewer are independent.
  constexpr double kCellsShared = 9;
  constexpr double kMostOffPx = 0.5;  // beyond: an edge, not a bend
  double weights = 1 / (kPriorSd * kPriorSd), sum = 0;
  for (const auto& band : cells.bands) {
    cv::Matx<double, kTerms, kTerms> normal_matrix;
    cv::Vec<double, kTerms> right;
    double squares = 0;
    int count = 0;
    for (std::size_t i = 0; i < band.size(); ++i) {
      const Bend& bend = bends.nodes[i];
      if (!band[i] || !(bend.is_known > 0)) continue;
      const double predicted_px =
          factors_of(band[i]->shape, cells.second_harmonic, cells.period_px).shift_px(bend) -
          factors_of(band[i]->shape, 1, cells.period_px).shift_px(bend);
      const double measured_px = band[i]->second_less_first_px;
      if (std::abs(predicted_px) > kMostOffPx || std::abs(measured_px) > kMostOffPx) continue;
      const cv::Vec<double, kTerms> terms(predicted_px, double{bend.projector_px},
                                          double{bend.camera_px}, 1);
      normal_matrix += terms * terms.t();
      right += measured_px * terms;
      squares += measured_px * measured_px;
      ++count;
    }
    if (count <= kTerms * kCellsShared) continue;
    bool is_regular = false;
    const auto inverse = normal_matrix.inv(cv::DECOMP_CHOLESKY, &is_regular);
    if (!is_regular) continue;
    const cv::Vec<double, kTerms> fit = inverse * right;
    const double residual = std::max(squares - fit.dot(right), 0.0) / count;
    const double variance = kCellsShared * residual * inverse(0, 0);
    if (!(variance > 0)) continue;
    sum += fit[0] / variance;
    weights += 1 / variance;
  }
  return sum / weights;
}

double median_pixel_mm(const Surface& surface, double focal_px) {
  std::vector<float> depths_mm;
  const auto samples = surface.position_mm[2].samples();
  for (std::size_t i = 0; i < samples.size(); i += 7)
    if (!std::isnan(samples[i])) depths_mm.push_back(samples[i]);
  if (depths_mm.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto middle = depths_mm.begin() + static_cast<std::ptrdiff_t>(depths_mm.size() / 2);
  std::nth_element(depths_mm.begin(), middle, depths_mm.end());
  return double{*middle} / focal_px;
}

// What one axis needs in every pass.
struct AxisSpread {
  Axis axis = Axis::kColumn;
  SpreadCells spread;
  Image<float> measured_px, measured_sd_px;
  Image<float> doubt_px;  // what the correction may be wrong by, alike in neighbouring pixels
  std::array<std::vector<ShiftFactors>, 3> factors = {};  // [band][cell], where there is a spread
};

std::array<std::vector<ShiftFactors>, 3> factors_by_cell(const SpreadCells& spread,
                                                         PhaseSource source) {
  std::array<std::vector<ShiftFactors>, 3> factors;
  for (std::size_t band = 0; band < factors.size(); ++band)
    for (const auto& cell : spread.bands[band])
      factors[band].push_back(cell ? factors_of(cell->shape, spread, source) : ShiftFactors{});
  return factors;
}

void take_off(AxisSpread& from, const BendNodes& bends, const CameraInfo& camera,
              const BendOptions& options, Image<float>& position_px, Image<float>& sd_px) {
  tbb::parallel_for(0, camera.height_px, [&](int row) {
    for (int col = 0; col < camera.width_px; ++col) {
      position_px.at(row, col) = from.measured_px.at(row, col);
      sd_px.at(row, col) = from.measured_sd_px.at(row, col);
      from.doubt_px.at(row, col) = 0;
      if (std::isnan(position_px.at(row, col))) continue;
      const auto band = static_cast<std::size_t>(spread_band(camera, row, col));
      const std::size_t cell = from.spread.index(row, col);
      if (!from.spread.bands[band][cell]) continue;
      const Bend bend = bends.at(row, col);
      if (!(bend.is_known > 0)) continue;
      const double off_px = from.factors[band][cell].shift_px(bend);
      if (!(std::abs(off_px) < kMostShiftPx)) continue;
      position_px.at(row, col) -= static_cast<float>(off_px);
      const double doubt_px = options.relative_sd * std::abs(off_px);
      from.doubt_px.at(row, col) = static_cast<float>(doubt_px);
      sd_px.at(row, col) =
          static_cast<float>(root_of_squares(double{sd_px.at(row, col)}, doubt_px));
    }
  });
}

// Smoothing averages noise away, and not what neighbours share. Of two axes the one that is known
// better decides on the depth.
void add_doubt(const Stereo& stereo, std::span<const AxisSpread> axes,
               const Correspondence& correspondence, Surface& surface) {
  const auto sd_of = [&](Axis axis, int row, int col) {
    const Image<float>& sd_px =
        axis == Axis::kColumn ? correspondence.column_sd_px : correspondence.row_sd_px;
    return sd_px.at(row, col);
  };
  tbb::parallel_for(0, surface.validity.height_px(), [&](int row) {
    for (int col = 0; col < surface.validity.width_px(); ++col) {
      float& sd_mm = surface.position_sd_mm.at(row, col);
      if (std::isnan(sd_mm)) continue;
      const AxisSpread* from = &axes.front();
      if (axes.size() > 1 && sd_of(axes[1].axis, row, col) < sd_of(from->axis, row, col))
        from = &axes[1];
      const Vec3 here_mm = vector_at(surface.position_mm, row, col);
      const auto lit = stereo.project(here_mm);
      const double doubt_px = double{from->doubt_px.at(row, col)};
      if (!lit || !(doubt_px > 0)) continue;
      const Vec3 gradient = from->axis == Axis::kColumn ? lit->column_gradient_px_per_mm
                                                        : lit->row_gradient_px_per_mm;
      const double px_per_mm = std::abs(gradient.dot(here_mm)) / cv::norm(here_mm);
      if (px_per_mm > 0)
        sd_mm = static_cast<float>(root_of_squares(double{sd_mm}, doubt_px / px_per_mm));
    }
  });
}

}  // namespace

Surface reconstruct_bent_surface(std::span<const PatternSignal> signals,
                                 const Calibration& calibration, const CameraInfo& camera,
                                 const ProjectorInfo& projector, const SurfaceOptions& options,
                                 const BendOptions& bend_options, Correspondence& correspondence) {
  Surface surface;
  const auto reconstruct = [&](SurfaceParts parts) {
    reconstruct_surface_into(calibration, camera, projector, correspondence, options, parts,
                             surface);
  };
  reconstruct(SurfaceParts::kAll);
  const Stereo stereo(calibration, camera);
  const double pixel_mm = median_pixel_mm(surface, stereo.camera_focal_px());
  if (!(pixel_mm > 0)) return surface;
  constexpr double kMostRadiusPx = 60;
  const int radius_px = static_cast<int>(
      std::lround(std::clamp(bend_options.radius_mm / pixel_mm, 2.0, kMostRadiusPx)));
  const int side_px = std::max(2, radius_px / 4 * 2);  // even: whole quads of a Bayer mosaic
  std::vector<AxisSpread> axes;
  for (const Axis axis : {Axis::kColumn, Axis::kRow}) {
    const bool is_column = axis == Axis::kColumn;
    const Image<float>& position_px = is_column ? correspondence.column_px : correspondence.row_px;
    if (position_px.empty()) continue;
    auto spread =
        spread_of(signals, bend_options.levels, axis, camera, position_px.view(), side_px);
    if (!spread) continue;
    axes.push_back({axis, std::move(*spread), position_px,
                    is_column ? correspondence.column_sd_px : correspondence.row_sd_px,
                    Image<float>(camera.height_px, camera.width_px)});
    axes.back().factors = factors_by_cell(axes.back().spread, bend_options.source);
  }
  if (axes.empty()) return surface;
  bool is_shape_alone = false;
  for (int pass = 0; pass < bend_options.pass_count; ++pass) {
    bool is_moved = false;
    for (AxisSpread& from : axes) {
      const bool is_column = from.axis == Axis::kColumn;
      const BendNodes bends = bends_of(stereo, surface, from.axis, radius_px, side_px);
      if (shown_share(bends, from.spread) < kLeastShownShare) continue;
      take_off(from, bends, camera, bend_options,
               is_column ? correspondence.column_px : correspondence.row_px,
               is_column ? correspondence.column_sd_px : correspondence.row_sd_px);
      is_moved = true;
    }
    if (!is_moved) break;
    is_shape_alone = pass + 1 < bend_options.pass_count;
    reconstruct(is_shape_alone ? SurfaceParts::kShape : SurfaceParts::kAll);
  }
  if (is_shape_alone) reconstruct(SurfaceParts::kAll);
  add_doubt(stereo, axes, correspondence, surface);
  return surface;
}

}  // namespace estimation
