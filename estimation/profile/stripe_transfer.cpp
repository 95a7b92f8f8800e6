#include "estimation/profile/stripe_transfer.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "estimation/session/transfer_file.h"

namespace estimation {
namespace {

constexpr double kCalibratedPeriodPx = 40;

const std::vector<double>& curve_of(const TransferByBand& transfer, int band) {
  const std::vector<double>& own = transfer.harmonics[static_cast<std::size_t>(band)];
  return own.empty() ? transfer.harmonics[0] : own;
}

// Beyond the last one known, as a Gaussian would go on; noise may have put the last above 1, which
// must not grow.
double continued(std::span<const double> curve, double cycles) {
  const double end = std::min(curve.back(), 1.0);
  const double ratio = cycles / static_cast<double>(curve.size());
  return end > 0 ? std::pow(end, ratio * ratio) : 0;
}

// Of a whole number of cycles per 40 projector px: 1 at none, and alike on its other side.
double contrast_of(std::span<const double> curve, int cycles) {
  const auto count = static_cast<std::size_t>(std::abs(cycles));
  if (count == 0) return 1;
  return count <= curve.size() ? curve[count - 1] : continued(curve, std::abs(cycles));
}

// Contrast at `cycles` per 40 projector px from the values at 1, 2, ... by a cubic through four
// neighbours: straight lines lose up to 0.3% of contrast under a blur of 1 px, which was 0.9% of
// sigma_a under stripes of period 64.
double contrast_at(std::span<const double> curve, double cycles) {
  if (curve.empty()) return 1;
  if (cycles > static_cast<double>(curve.size())) return continued(curve, cycles);
  const int below = static_cast<int>(cycles);
  const double t = cycles - below, b = contrast_of(curve, below);
  if (t == 0) return b;
  const double a = contrast_of(curve, below - 1), c = contrast_of(curve, below + 1);
  const double d = contrast_of(curve, below + 2);
  const double cubic =
      b + t / 2 * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)));
  return std::max(cubic, 0.0);
}

}  // namespace

Result<HarmonicTransfer> HarmonicTransfer::create(const std::optional<StripeTransfer>& calibration,
                                                  const std::map<std::string, Image<float>>& file,
                                                  const CameraInfo& camera) {
  HarmonicTransfer transfer;
  if (!calibration) return transfer;
  if (const auto* by_band = std::get_if<TransferByBand>(&*calibration))
    transfer.depths_ = {{.distance_mm = 0, .transfer = *by_band}};
  if (const auto* by_depth = std::get_if<TransferByDepth>(&*calibration))
    transfer.depths_ = by_depth->entries;
  if (!std::holds_alternative<TransferFile>(*calibration)) return transfer;
  if (const auto problem = transfer_file_problem(file, camera))
    return tl::unexpected(
        InputError{InputFault::kInvalid, "", "/calibration/stripe_transfer", *problem});
  const ColorFilter filter = camera.pixel_format.filter;
  for (int band = 0; band < band_count(filter); ++band)
    for (int n = 1; const Image<float>* contrast = transfer_channel(file, filter, band, n); ++n)
      transfer.maps_[static_cast<std::size_t>(band)].push_back(*contrast);
  return transfer;
}

void HarmonicTransfer::at(int row, int col, int band, double distance_mm, int period_px,
                          std::span<float> out) const {
  const double cycles_per_harmonic = kCalibratedPeriodPx / period_px;
  std::vector<double> own_curve;
  std::span<const double> low, high;
  double fraction = 0;
  if (const auto& maps = maps_[static_cast<std::size_t>(band)]; !maps.empty()) {
    for (const Image<float>& map : maps) own_curve.push_back(static_cast<double>(map.at(row, col)));
    low = high = own_curve;
  } else if (!depths_.empty()) {
    const auto after = std::find_if(depths_.begin(), depths_.end(), [&](const auto& entry) {
      return entry.distance_mm >= distance_mm;
    });
    const auto upper = after == depths_.end() ? depths_.end() - 1 : after;
    const auto lower = upper == depths_.begin() || after == depths_.end() ? upper : upper - 1;
    if (lower != upper)
      fraction = (distance_mm - lower->distance_mm) / (upper->distance_mm - lower->distance_mm);
    low = curve_of(lower->transfer, band);
    high = curve_of(upper->transfer, band);
  }
  for (std::size_t i = 0; i < out.size(); ++i) {
    const double cycles = static_cast<double>(i + 1) * cycles_per_harmonic;
    out[i] = static_cast<float>(
        std::lerp(contrast_at(low, cycles), contrast_at(high, cycles), fraction));
  }
}

}  // namespace estimation
