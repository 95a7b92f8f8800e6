#include "estimation/refine/apparent_position.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "estimation/geometry/phase.h"

namespace estimation {
namespace {

// Standard deviation of the Gaussian that averages nodes, in node distances: half of l_d. The
// shift feeds back on itself through the surface; finer detail than that would grow from pass to
// pass.
constexpr double kAverageNodes = 1.25;
constexpr int kReachNodes = 3;
// A shift by more than this is no shift of a surface's light but a failed reconstruction.
constexpr double kMostShiftPx = 2;

struct Reading {
  double px = 0, variance_px2 = 0;
};

// The shift at a pixel, from the nodes nearby on the same piece of the surface.
std::optional<double> shift_px(const LitSurface& surface, const SpreadField& field, int row,
                               int col, double node_mm, int period_px) {
  if (field.rows == 0) return std::nullopt;
  const Vec3 here = surface.position(row, col);
  const double scale = -0.5 / (kAverageNodes * kAverageNodes * node_mm * node_mm);
  const int i0 = row / field.stride_px, j0 = col / field.stride_px;
  std::complex<double> sum = 0;
  double weight = 0;
  for (int i = std::max(0, i0 - kReachNodes); i <= std::min(field.rows - 1, i0 + kReachNodes + 1);
       ++i)
    for (int j = std::max(0, j0 - kReachNodes); j <= std::min(field.cols - 1, j0 + kReachNodes + 1);
         ++j) {
      if (!field.is_known(i, j)) continue;
      const Vec3 offset = surface.position(i * field.stride_px, j * field.stride_px) - here;
      const double w = std::exp(scale * offset.dot(offset));
      sum += w * std::complex<double>(field.first_at(i, j));
      weight += w;
    }
  // A pixel alone, far from every node's surface.
  if (!(weight > 1e-3)) return std::nullopt;
  return std::arg(sum) * period_px / (2 * std::numbers::pi);
}

class PhaseReader {
 public:
  explicit PhaseReader(const StripeSweep& sweep) : sweep_(sweep) {
    PhaseFamily family{.axis = sweep.stripes.axis,
                       .period_px = static_cast<double>(sweep.stripes.shape.period_px),
                       .width_px = sweep.stripes.shape.width_px,
                       .shift_px = {}};
    for (const int shift : sweep.stripes.shifts_px) family.shift_px.push_back(shift);
    centre_px_ = family.centre_px();
    weights_ = make_demodulation(family, std::vector<char>(family.shift_px.size(), 1), 1);
  }

  // The coordinate nearest to `near_px`; nullopt if a sample is lost.
  std::optional<Reading> read(int row, int col, int channel, double near_px) const {
    if (!weights_) return std::nullopt;
    double cosine = 0, sine = 0;
    for (std::size_t i = 0; i < sweep_.signals.size(); ++i) {
      const double signal = static_cast<double>(sweep_.signals[i].at(row, col, channel));
      cosine += static_cast<double>(weights_->cosine[i]) * signal;
      sine += static_cast<double>(weights_->sine[i]) * signal;
    }
    const double amplitude = std::hypot(cosine, sine);
    if (!(amplitude > 0) || !std::isfinite(amplitude)) return std::nullopt;
    double variance = 0;  // across the phasor
    for (std::size_t i = 0; i < sweep_.signals.size(); ++i) {
      const double across = (static_cast<double>(weights_->sine[i]) * cosine -
                             static_cast<double>(weights_->cosine[i]) * sine) /
                            amplitude;
      variance +=
          across * across *
          variance_at(sweep_.noise, static_cast<double>(sweep_.signals[i].at(row, col, channel)));
    }
    const double period_px = sweep_.stripes.shape.period_px;
    const double px_per_rad = period_px / (2 * std::numbers::pi);
    const double phase_px = centre_px_ + px_per_rad * std::atan2(sine, cosine);
    return Reading{phase_px + period_px * std::round((near_px - phase_px) / period_px),
                   std::pow(px_per_rad / amplitude, 2) * variance};
  }

 private:
  const StripeSweep& sweep_;
  double centre_px_ = 0;
  std::optional<Demodulation> weights_;
};

}  // namespace

Position true_position(const StripeSweep& sweep, const LitSurface& surface,
                       std::span<const SpreadField> fields, ImageView<const float> sd_px) {
  const int height = surface.height_px(), width = surface.width_px();
  Position out{Image<float>(height, width), Image<float>(height, width)};
  const PhaseReader reader(sweep);
  const double pixel_mm = typical_pixel_mm(surface);
  const int channels = sample_channel_count(sweep.camera.pixel_format.filter);
  tbb::parallel_for(0, height, [&](int row) {
    for (int col = 0; col < width; ++col) {
      const float old_px = surface.position_px.at(row, col);
      out.px.at(row, col) = old_px;
      out.sd_px.at(row, col) = sd_px.at(row, col);
      if (!surface.is_lit(row, col)) continue;
      double sum = 0, weight = 0;
      for (int channel = 0; channel < channels; ++channel) {
        const auto band = static_cast<std::size_t>(band_at(sweep.camera, row, col, channel));
        const SpreadField& field = fields[band];
        const auto shift = shift_px(surface, field, row, col, field.stride_px * pixel_mm,
                                    sweep.stripes.shape.period_px);
        const auto reading = reader.read(row, col, channel, static_cast<double>(old_px));
        if (!shift || !reading || !(reading->variance_px2 > 0)) continue;
        const double corrected_px = reading->px - *shift;
        if (!(std::abs(corrected_px - static_cast<double>(old_px)) < kMostShiftPx)) continue;
        sum += corrected_px / reading->variance_px2;
        weight += 1 / reading->variance_px2;
      }
      if (!(weight > 0)) continue;
      out.px.at(row, col) = static_cast<float>(sum / weight);
      out.sd_px.at(row, col) = static_cast<float>(1 / std::sqrt(weight));
    }
  });
  return out;
}

}  // namespace estimation
