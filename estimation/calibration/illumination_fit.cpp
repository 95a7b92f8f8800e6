#include "estimation/calibration/illumination_fit.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <opencv2/core.hpp>
#include <optional>
#include <tuple>

#include "estimation/calibration/standard_target.h"
#include "estimation/geometry/triangulation.h"

namespace estimation {
namespace {

constexpr int kCellPx = 24;       // of the projector; the light changes little within
constexpr int kLeastPixels = 12;  // of a cell
constexpr int kLeastCells = 4;    // of a band
constexpr double kTukeySd = 4.7;
constexpr double kFlatnessLimitMm = 1;
constexpr double kResidualLimitFrac = 0.02;

tl::unexpected<InputError> insufficient(const std::string& expectation) {
  return tl::unexpected(InputError{InputFault::kInsufficient, "", "", expectation});
}

double quantile(std::vector<double> values, double share) {
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

struct CellSums {
  std::vector<double> white, black;  // over reflectance, cosine and distance
  double column_sum = 0, row_sum = 0;
};
using CellKey = std::tuple<int, int, int, int>;  // view, band, cell row, cell column

// Signals over reflectance, cosine and distance (to 1 mm) by cell of the projector's picture.
class Collector {
 public:
  Collector(const Calibration& calibration, const CameraInfo& camera,
            const StandardOptions& options)
      : stereo_(calibration, camera), camera_(camera), options_(options) {}

  bool add(const StandardView& view, IlluminationFit& fit) {
    const Sampler sampler{camera_, view.white.channel_count};
    const auto target = find_target(view, sampler, stereo_.camera_focal_px(), options_);
    if (!target) return false;
    fit.flatness_mm = std::max(fit.flatness_mm, target->plane.rms_mm);
    for (int row = 0; row < target->mask.rows; ++row)
      for (int col = 0; col < target->mask.cols; ++col)
        if (target->mask(row, col)) add_pixel(view, target->plane, sampler, row, col);
    ++view_count_;
    return true;
  }

  const std::map<CellKey, CellSums>& cells() const { return cells_; }
  double mean_distance_mm() const { return distance_sum_mm_ / count_; }

 private:
  void add_pixel(const StandardView& view, const Plane& plane, const Sampler& sampler, int row,
                 int col) {
    const auto ray = stereo_.ray(row, col);
    if (!ray) return;
    const auto column_px = static_cast<double>(view.column_px.at(row, col));
    const auto row_px = static_cast<double>(view.row_px.at(row, col));
    if (!std::isfinite(column_px) || !std::isfinite(row_px)) return;
    // The plane's own point: a pixel's position has noise that the cosine law would keep.
    const Vec3 point = ray->direction * (plane.offset_mm / plane.normal.dot(ray->direction));
    const Vec3 to_projector = stereo_.projector_centre_mm() - point;
    const double distance_mm = cv::norm(to_projector);
    const double cosine = plane.normal.dot(to_projector) / distance_mm;
    if (!(cosine > 0.2)) return;
    distance_sum_mm_ += distance_mm;
    ++count_;
    const double gain = cosine / (distance_mm * distance_mm);
    sampler.for_each_band(row, col, [&](int band, int channel) {
      const double over = gain * options_.reflectance[static_cast<std::size_t>(band)];
      const auto white = static_cast<double>(view.white.at(row, col, channel));
      if (!std::isfinite(white)) return;
      CellSums& cell = cells_[{view_count_, band, static_cast<int>(row_px) / kCellPx,
                               static_cast<int>(column_px) / kCellPx}];
      cell.white.push_back(white / over);
      if (!view.black.empty())
        cell.black.push_back(static_cast<double>(view.black.at(row, col, channel)) / over);
      cell.column_sum += column_px;
      cell.row_sum += row_px;
    });
  }

  Stereo stereo_;
  const CameraInfo& camera_;
  StandardOptions options_;
  int view_count_ = 0;
  std::map<CellKey, CellSums> cells_;
  double distance_sum_mm_ = 0, count_ = 0;
};

// Robust mean: a few specks and scratches do not matter.
double middle_mean(std::vector<double> values) {
  std::ranges::sort(values);
  const std::size_t trim = values.size() / 10;
  double sum = 0;
  for (std::size_t i = trim; i + trim < values.size(); ++i) sum += values[i];
  return sum / static_cast<double>(values.size() - 2 * trim);
}

// Monomials of total degree up to `order` around the projector picture's centre.
std::vector<double> monomials(double column_px, double row_px, const ProjectorInfo& projector,
                              int order) {
  const double x = 2 * (column_px - (projector.width_px - 1) / 2.0) / projector.width_px;
  const double y = 2 * (row_px - (projector.height_px - 1) / 2.0) / projector.width_px;
  std::vector<double> terms;
  for (int degree = 0; degree <= order; ++degree)
    for (int i = 0; i <= degree; ++i) terms.push_back(std::pow(x, degree - i) * std::pow(y, i));
  return terms;
}

struct Polynomial {
  cv::Mat1d coefficients;
  double centre_sd = 0;
};

// Least squares with Tukey's weights over the cells of one band; fills in their residuals.
Polynomial fit_polynomial(std::vector<IlluminationFit::Cell*>& cells,
                          const ProjectorInfo& projector, int order) {
  const auto terms = static_cast<int>(monomials(0, 0, projector, order).size());
  std::vector<double> weight(cells.size(), 1);
  Polynomial polynomial;
  for (int round = 0; round < 6; ++round) {
    cv::Mat1d normal(terms, terms, 0.0), right(terms, 1, 0.0);
    for (std::size_t k = 0; k < cells.size(); ++k) {
      const auto t = monomials(cells[k]->column_px, cells[k]->row_px, projector, order);
      for (int i = 0; i < terms; ++i) {
        right(i) += weight[k] * t[static_cast<std::size_t>(i)] * cells[k]->signal_per_us;
        for (int j = 0; j < terms; ++j)
          normal(i, j) +=
              weight[k] * t[static_cast<std::size_t>(i)] * t[static_cast<std::size_t>(j)];
      }
    }
    cv::solve(normal, right, polynomial.coefficients, cv::DECOMP_SVD);
    std::vector<double> size;
    for (IlluminationFit::Cell* cell : cells) {
      const auto t = monomials(cell->column_px, cell->row_px, projector, order);
      double value = 0;
      for (int i = 0; i < terms; ++i)
        value += polynomial.coefficients(i) * t[static_cast<std::size_t>(i)];
      cell->residual_frac = cell->signal_per_us / value - 1;
      size.push_back(std::abs(cell->residual_frac));
    }
    const double scale = std::max(quantile(size, 0.5) / 0.6745, 1e-9);
    for (std::size_t k = 0; k < cells.size(); ++k) {
      const double u = size[k] / (kTukeySd * scale);
      weight[k] = u < 1 ? (1 - u * u) * (1 - u * u) : 0;
    }
    cv::Mat1d inverse;
    cv::invert(normal, inverse, cv::DECOMP_SVD);
    polynomial.centre_sd = scale * polynomial.coefficients(0) * std::sqrt(inverse(0, 0));
  }
  return polynomial;
}

// As much freedom as the part of the projector's picture that was seen can hold.
int choose_order(const IlluminationFit& fit, const ProjectorInfo& projector,
                 std::size_t cells_of_band) {
  const double share = (fit.last_column_px - fit.first_column_px) / projector.width_px *
                       (fit.last_row_px - fit.first_row_px) / projector.height_px;
  if (share > 0.4 && cells_of_band >= 60) return 4;
  if (share > 0.15 && cells_of_band >= 20) return 2;
  return 0;
}

void take_cells(const Collector& collector, IlluminationFit& fit) {
  const double square_mm2 = std::pow(fit.reference_distance_mm, 2);
  fit.first_column_px = fit.first_row_px = std::numeric_limits<double>::infinity();
  for (const auto& [key, sums] : collector.cells()) {
    const auto count = static_cast<double>(sums.white.size());
    if (count < kLeastPixels) continue;
    IlluminationFit::Cell cell{.column_px = sums.column_sum / count,
                               .row_px = sums.row_sum / count,
                               .band = std::get<1>(key),
                               .signal_per_us = middle_mean(sums.white) / square_mm2};
    fit.cells.push_back(cell);
    fit.first_column_px = std::min(fit.first_column_px, cell.column_px);
    fit.last_column_px = std::max(fit.last_column_px, cell.column_px);
    fit.first_row_px = std::min(fit.first_row_px, cell.row_px);
    fit.last_row_px = std::max(fit.last_row_px, cell.row_px);
  }
}

void draw_vignetting(const std::vector<Polynomial>& bands, const ProjectorInfo& projector,
                     IlluminationFit& fit) {
  fit.vignetting = Image<float>(projector.height_px, projector.width_px);
  for (int row = 0; row < projector.height_px; ++row)
    for (int col = 0; col < projector.width_px; ++col) {
      const auto t = monomials(std::clamp<double>(col, fit.first_column_px, fit.last_column_px),
                               std::clamp<double>(row, fit.first_row_px, fit.last_row_px),
                               projector, fit.order);
      double sum = 0;
      for (const Polynomial& band : bands)
        for (std::size_t i = 0; i < t.size(); ++i)
          sum += t[i] * band.coefficients(static_cast<int>(i)) / band.coefficients(0);
      fit.vignetting.at(row, col) =
          static_cast<float>(std::max(sum / static_cast<double>(bands.size()), 0.01));
    }
}

void fit_black(const Collector& collector, IlluminationFit& fit) {
  std::array<std::vector<double>, 3> values;
  const double square_mm2 = std::pow(fit.reference_distance_mm, 2);
  for (const auto& [key, sums] : collector.cells())
    if (sums.black.size() >= static_cast<std::size_t>(kLeastPixels))
      values[static_cast<std::size_t>(std::get<1>(key))].push_back(middle_mean(sums.black) /
                                                                   square_mm2);
  for (std::size_t band = 0; band < 3; ++band) {
    if (values[band].empty()) continue;
    fit.has_black = true;
    const double mean = middle_mean(values[band]);
    double squares = 0;
    for (const double value : values[band]) squares += (value - mean) * (value - mean);
    const auto count = static_cast<double>(values[band].size());
    fit.projector_black_dn_per_us[band] = {std::max(mean, 0.0), std::sqrt(squares) / count};
  }
}

void warn(const ProjectorInfo& projector, IlluminationFit& fit) {
  char text[200];
  if (fit.residual_rms_frac > kResidualLimitFrac) {
    std::snprintf(
        text, sizeof text,
        "the standard's signal is off a smooth field by %.1f%% rms: is it flat, clean and "
        "alone under the light?",
        100 * fit.residual_rms_frac);
    fit.warnings.emplace_back(text);
  }
  if (fit.flatness_mm > kFlatnessLimitMm) {
    std::snprintf(text, sizeof text, "the standard's points are %.2f mm rms off a plane",
                  fit.flatness_mm);
    fit.warnings.emplace_back(text);
  }
  const double column = (projector.width_px - 1) / 2.0, row = (projector.height_px - 1) / 2.0;
  if (column < fit.first_column_px || column > fit.last_column_px || row < fit.first_row_px ||
      row > fit.last_row_px)
    fit.warnings.emplace_back(
        "the projector's centre was not on the standard: signal_per_us is extrapolated; hold the "
        "standard in the middle too");
  if (fit.order < 4)
    fit.warnings.emplace_back(
        "the standard covered a small part of the projector's picture: the vignetting is " +
        std::string(fit.order == 0 ? "taken as none" : "a quadric") +
        "; show the standard in several places");
}

Result<IlluminationFit> fit(std::span<const StandardView> views, const Calibration& calibration,
                            const CameraInfo& camera, const ProjectorInfo& projector,
                            const StandardOptions& options) {
  IlluminationFit fit;
  fit.band_count = band_count(camera.pixel_format.filter);
  Collector collector(calibration, camera, options);
  for (const StandardView& view : views)
    if (!collector.add(view, fit))
      return insufficient("the standard is not found: no bright plane in the picture");
  if (collector.cells().empty())
    return insufficient("nothing of the standard is left beside its border; hold it nearer");
  fit.reference_distance_mm = collector.mean_distance_mm();
  take_cells(collector, fit);
  std::vector<std::vector<IlluminationFit::Cell*>> by_band(
      static_cast<std::size_t>(fit.band_count));
  for (IlluminationFit::Cell& cell : fit.cells)
    by_band[static_cast<std::size_t>(cell.band)].push_back(&cell);
  std::size_t least_cells = fit.cells.size();
  for (const auto& cells : by_band) least_cells = std::min(least_cells, cells.size());
  if (least_cells < kLeastCells)
    return insufficient("too little of the standard is lit and seen by every band");
  fit.order = choose_order(fit, projector, least_cells);
  std::vector<Polynomial> polynomials;
  for (std::size_t band = 0; band < by_band.size(); ++band) {
    polynomials.push_back(fit_polynomial(by_band[band], projector, fit.order));
    fit.signal_per_us[band] = {polynomials.back().coefficients(0), polynomials.back().centre_sd};
  }
  double squares = 0;
  for (const IlluminationFit::Cell& cell : fit.cells)
    squares += cell.residual_frac * cell.residual_frac;
  fit.residual_rms_frac = std::sqrt(squares / static_cast<double>(fit.cells.size()));
  draw_vignetting(polynomials, projector, fit);
  fit_black(collector, fit);
  warn(projector, fit);
  return fit;
}

}  // namespace

Result<IlluminationFit> fit_illumination(std::span<const StandardView> views,
                                         const Calibration& calibration, const CameraInfo& camera,
                                         const ProjectorInfo& projector,
                                         const StandardOptions& options) {
  try {  // OpenCV says by exceptions what it cannot do
    return fit(views, calibration, camera, projector, options);
  } catch (const cv::Exception& error) {
    return insufficient("the standard cannot be measured (" + error.err + ")");
  }
}

}  // namespace estimation
