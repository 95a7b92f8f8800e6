#include "estimation/refine/spatial_correction.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "estimation/base/check.h"

namespace estimation {
namespace {

// A reach of more camera pixels than this is no neighbourhood but a failed reconstruction.
constexpr double kMostPx = 1000;
constexpr std::size_t kLanes = 8;

// The centre of a block, in pixels from `origin`.
double centre_px(int block, int side_px, int origin) {
  return (block + 0.5) * side_px - 0.5 - origin;
}

}  // namespace

SpatialCorrection::SpatialCorrection(const LitSurface& surface, const LitPatches& patches,
                                     const RadialProfile& profile, int period_px,
                                     int harmonic_count)
    : surface_(surface),
      patches_(patches),
      profile_(profile),
      period_px_(period_px),
      count_(static_cast<std::size_t>(harmonic_count) + 1) {}

bool SpatialCorrection::at(int row, int col, const SpreadMaterial& material,
                           std::span<std::complex<double>> out) {
  check(out.size() == count_, "one number for the mean and each harmonic");
  std::fill(out.begin(), out.end(), std::complex<double>());
  if (!surface_.is_lit(row, col)) return false;
  plane_ = local_plane(surface_, row, col);
  const double reach_mm = RadialProfile::kRadius * material.translucency_mm;
  if (!plane_.is_known || !(reach_mm < kMostPx * plane_.across_mm)) return false;

  row_ = row;
  col_ = col;
  here_mm_ = surface_.position(row, col);
  own_phase_rad_ =
      2 * std::numbers::pi / period_px_ * static_cast<double>(surface_.position_px.at(row, col));
  const double gain = static_cast<double>(surface_.gain.at(row, col));
  const double block_px2 = static_cast<double>(patches_.side_px * patches_.side_px);
  plane_flux_mm2_ = gain * cv::norm(plane_.by_col_mm.cross(plane_.by_row_mm)) * block_px2;
  reach2_mm2_ = static_cast<float>(reach_mm * reach_mm);
  steps_per_mm_ = static_cast<float>(RadialProfile::kStepsPerUnit / material.translucency_mm);
  profile_.line(material.diffuse_reflectance, line_);

  arrivals_.clear();
  // Beyond the picture the plane is taken to go on, as lit as here: no difference.
  const int reach_px = static_cast<int>(reach_mm / plane_.across_mm) + 1;
  const int side = patches_.side_px;
  const int first_col = std::max(0, (col - reach_px) / side);
  const int last_col = std::min(patches_.cols, (col + reach_px) / side + 1);
  for (int block = std::max(0, (row - reach_px) / side);
       block < std::min(patches_.rows, (row + reach_px) / side + 1); ++block) {
    collect_surface(block, first_col, last_col);
    collect_plane(block, first_col, last_col);
  }
  sum_arrivals(out);
  const double scale = 1 / (gain * material.translucency_mm * material.translucency_mm);
  for (std::complex<double>& number : out) number *= scale;
  return true;
}

float SpatialCorrection::profile_at(float distance2_mm2) const {
  const float place = std::sqrt(distance2_mm2) * steps_per_mm_;
  const auto index = static_cast<std::size_t>(place);
  const float fraction = place - static_cast<float>(index);
  return line_[index] + fraction * (line_[index + 1] - line_[index]);
}

void SpatialCorrection::collect_surface(int block_row, int first, int last) {
  const std::size_t base =
      static_cast<std::size_t>(block_row) * static_cast<std::size_t>(patches_.cols);
  const auto x = static_cast<float>(here_mm_[0]);
  const auto y = static_cast<float>(here_mm_[1]);
  const auto z = static_cast<float>(here_mm_[2]);
  const auto own_cos = static_cast<float>(std::cos(own_phase_rad_));
  const auto own_sin = static_cast<float>(std::sin(own_phase_rad_));
  for (int col = first; col < last; ++col) {
    const std::size_t i = base + static_cast<std::size_t>(col);
    const float dx = patches_.x_mm[i] - x, dy = patches_.y_mm[i] - y, dz = patches_.z_mm[i] - z;
    const float distance2 = dx * dx + dy * dy + dz * dz;
    if (!(distance2 < reach2_mm2_)) continue;
    const float c = patches_.cos_phase[i], s = patches_.sin_phase[i];
    arrivals_.add(patches_.flux_mm2[i] * profile_at(distance2), c * own_cos + s * own_sin,
                  s * own_cos - c * own_sin);
  }
}

void SpatialCorrection::collect_plane(int block_row, int first, int last) {
  const double rad_per_px = 2 * std::numbers::pi / period_px_;
  const double down_px = centre_px(block_row, patches_.side_px, row_);
  const double right_px = centre_px(first, patches_.side_px, col_);
  const Vec3 start = down_px * plane_.by_row_mm + right_px * plane_.by_col_mm;
  const Vec3 step = patches_.side_px * plane_.by_col_mm;
  const auto flux = static_cast<float>(plane_flux_mm2_);
  // Along a row the phase grows evenly.
  std::complex<double> turn =
      std::polar(1.0, rad_per_px * (right_px * plane_.px_by_col + down_px * plane_.px_by_row));
  const std::complex<double> turn_step =
      std::polar(1.0, rad_per_px * patches_.side_px * plane_.px_by_col);
  const double along = start.dot(step), start2 = start.dot(start), step2 = step.dot(step);
  for (int i = 0; i < last - first; ++i) {
    const auto distance2 = static_cast<float>(start2 + i * (2 * along + i * step2));
    if (distance2 < reach2_mm2_)
      arrivals_.add(-flux * profile_at(std::max(distance2, 0.0F)), static_cast<float>(turn.real()),
                    static_cast<float>(turn.imag()));
    turn = {turn.real() * turn_step.real() - turn.imag() * turn_step.imag(),
            turn.real() * turn_step.imag() + turn.imag() * turn_step.real()};
  }
}

// Lanes side by side, for the compiler to vectorise; the harmonics by rotation.
void SpatialCorrection::sum_arrivals(std::span<std::complex<double>> out) {
  while (arrivals_.weight.size() % kLanes != 0) arrivals_.add(0, 1, 0);
  const std::size_t count = arrivals_.weight.size();
  float* re = arrivals_.weight.data();
  im_.assign(count, 0.0F);
  float* im = im_.data();
  const float* cosine = arrivals_.cosine.data();
  const float* sine = arrivals_.sine.data();
  for (std::size_t n = 0; n < count_; ++n) {
    float sum_re[kLanes] = {}, sum_im[kLanes] = {};
    for (std::size_t begin = 0; begin < count; begin += kLanes)
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        const std::size_t i = begin + lane;
        sum_re[lane] += re[i];
        sum_im[lane] += im[i];
        const float next = re[i] * cosine[i] - im[i] * sine[i];
        im[i] = re[i] * sine[i] + im[i] * cosine[i];
        re[i] = next;
      }
    double total_re = 0, total_im = 0;
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      total_re += static_cast<double>(sum_re[lane]);
      total_im += static_cast<double>(sum_im[lane]);
    }
    out[n] = {total_re, total_im};
  }
}

}  // namespace estimation
