#include "estimation/refine/spread_field.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "estimation/profile/band_sites.h"
#include "estimation/refine/spatial_correction.h"

namespace estimation {
namespace {

constexpr double kNodeSpacing = 0.4;  // in l_d
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

double median_of(std::vector<double>& values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Every so many pixels of a large picture: medians need no more.
template <typename Value>
std::vector<double> sampled(const LitSurface& surface, const Value& value) {
  constexpr int kWanted = 20000;
  const int pixels = surface.height_px() * surface.width_px();
  const int step = std::max(1, static_cast<int>(std::sqrt(pixels / kWanted)));
  std::vector<double> values;
  for (int row = 0; row < surface.height_px(); row += step)
    for (int col = 0; col < surface.width_px(); col += step) {
      if (!surface.is_lit(row, col)) continue;
      const double found = value(row, col);
      if (std::isfinite(found)) values.push_back(found);
    }
  return values;
}

bool is_material(const SpreadMaterial& material) {
  return material.diffuse_reflectance > 0 && material.diffuse_reflectance < 1 &&
         material.translucency_mm > 0;
}

}  // namespace

double typical_translucency_mm(const LitSurface& surface, const BandMaterial& material) {
  auto values = sampled(surface, [&](int row, int col) {
    return static_cast<double>(material.translucency_mm.at(row, col));
  });
  return median_of(values);
}

double typical_pixel_mm(const LitSurface& surface) {
  auto values = sampled(surface, [&](int row, int col) {
    const LocalPlane plane = local_plane(surface, row, col);
    return plane.is_known ? plane.across_mm : std::numeric_limits<double>::quiet_NaN();
  });
  return median_of(values);
}

bool SpreadField::is_known(int node_row, int node_col) const {
  return std::isfinite(mean[index(node_row, node_col)]);
}

SpreadField spread_field(const CameraInfo& camera, int band, const LitSurface& surface,
                         const BandMaterial& material, const ScatteringModel& model,
                         StripeShape shape) {
  const double translucency_mm = typical_translucency_mm(surface, material);
  const double pixel_mm = typical_pixel_mm(surface);
  SpreadField field;
  if (!(translucency_mm > 0 && pixel_mm > 0)) return field;
  field.stride_px =
      std::max(1, static_cast<int>(std::lround(kNodeSpacing * translucency_mm / pixel_mm)));
  field.rows = (surface.height_px() + field.stride_px - 1) / field.stride_px;
  field.cols = (surface.width_px() + field.stride_px - 1) / field.stride_px;
  const auto count = static_cast<std::size_t>(field.rows) * static_cast<std::size_t>(field.cols);
  field.mean.assign(count, kNan);
  field.first.assign(count, {kNan, kNan});
  const RadialProfile profile(model, 0.01, 0.99);
  const LitPatches patches(surface, LitPatches::side_for(translucency_mm, pixel_mm),
                           shape.period_px);
  tbb::parallel_for(tbb::blocked_range<int>(0, field.rows), [&](const auto& range) {
    SpatialCorrection correction(surface, patches, profile, shape.period_px, 1);
    std::array<std::complex<double>, 2> change;
    for (int i = range.begin(); i != range.end(); ++i)
      for (int j = 0; j < field.cols; ++j) {
        const int row = i * field.stride_px, col = j * field.stride_px;
        if (field.stride_px == 1 && !is_site(camera, band, row, col)) continue;
        const SpreadMaterial here{static_cast<double>(material.diffuse_reflectance.at(row, col)),
                                  static_cast<double>(material.translucency_mm.at(row, col))};
        if (!is_material(here) || !correction.at(row, col, here, change)) continue;
        const double pitch_mm = static_cast<double>(surface.pitch_mm.at(row, col));
        const double k_times_l_d =
            2 * std::numbers::pi / (shape.period_px * pitch_mm) * here.translucency_mm;
        double first = 0;
        model.transform(here.diffuse_reflectance, {&k_times_l_d, 1}, {&first, 1});
        field.mean[field.index(i, j)] =
            static_cast<float>(1 + change[0].real() / here.diffuse_reflectance);
        field.first[field.index(i, j)] = std::complex<float>(1.0 + change[1] / first);
      }
  });
  return field;
}

}  // namespace estimation
