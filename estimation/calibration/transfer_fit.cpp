#include "estimation/calibration/transfer_fit.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>
#include <optional>

#include "estimation/calibration/transfer_contrast.h"
#include "estimation/models/scattering_model.h"

namespace estimation {
namespace {

constexpr std::size_t kLeastShifts = 20;  // harmonics 1 ... 9 without folding into each other
constexpr int kBlockCols = 8, kBlockRows = 6;
constexpr int kLeastPixels = 120;  // of a band in a block
// What models of optics leave out (the shape of the blur, projector pixels' gaps): no contrast is
// held to be known better than this.
constexpr double kModelSd = 0.002;
// By how much of chi-square scattering must beat blur alone. A white plastic gives hundreds; a lens
// whose blur has a halo gave 14.
constexpr double kScatteringGain = 40;
constexpr double kTargetReflectance = 0.95;  // a white target's; the shape hardly depends on it

std::size_t index(int n) { return static_cast<std::size_t>(n); }

// (2 pi n / 40)^2 / 2: minus the logarithm of a Gaussian's contrast, over its variance in px^2.
double blur_exponent(int n) {
  const double k = 2 * std::numbers::pi * n / kTransferPeriodPx;
  return k * k / 2;
}

struct BlurFit {
  Measured variance_px2;
  double chi2 = 0;
  int freedom = 0;
};

// Gaussian blur times `shape` (a scattering target's own contrast; 1 for an opaque one), by
// weighted least squares on the contrasts: one Gauss-Newton parameter, the variance, which may come
// out negative by noise. With `only_positive` it may not.
BlurFit fit_blur(const Contrasts& contrasts, std::span<const double> shape, bool only_positive) {
  BlurFit fit;
  double variance = 1;
  for (int round = 0; round < 30; ++round) {
    double information = 0, gradient = 0;
    for (int n = 1; n <= kTransferHarmonics; ++n) {
      const Measured& m = contrasts[index(n - 1)];
      if (m.sd == 0) continue;
      const double weight = 1 / (m.sd * m.sd + kModelSd * kModelSd);
      const double model = shape[index(n - 1)] * std::exp(-blur_exponent(n) * variance);
      const double slope = -blur_exponent(n) * model;
      information += weight * slope * slope;
      gradient += weight * slope * (m.value - model);
    }
    if (!(information > 0)) return fit;
    double next = variance + std::clamp(gradient / information, -1.0, 1.0);
    if (only_positive) next = std::max(next, 0.0);
    fit.variance_px2 = {next, 1 / std::sqrt(information)};
    if (std::abs(next - variance) < 1e-10) break;
    variance = next;
  }
  for (int n = 1; n <= kTransferHarmonics; ++n) {
    const Measured& m = contrasts[index(n - 1)];
    if (m.sd == 0) continue;
    const double model = shape[index(n - 1)] * std::exp(-blur_exponent(n) * fit.variance_px2.value);
    fit.chi2 += std::pow(m.value - model, 2) / (m.sd * m.sd + kModelSd * kModelSd);
    ++fit.freedom;
  }
  --fit.freedom;
  return fit;
}

constexpr std::array<double, kTransferHarmonics> kOpaque{1, 1, 1, 1, 1, 1, 1, 1, 1};

// The harmonics that the stripes do not contain lie between their neighbours, as a Gaussian would.
void interpolate_missing(Contrasts& contrasts) {
  for (int n = 2; n < kTransferHarmonics; ++n) {
    Measured& missing = contrasts[index(n - 1)];
    const Measured &below = contrasts[index(n - 2)], &above = contrasts[index(n)];
    if (missing.sd != 0 || !(below.value > 0 && above.value > 0)) continue;
    const double fraction = (n * n - (n - 1) * (n - 1)) / (4.0 * n);
    missing.value = std::exp(std::lerp(std::log(below.value), std::log(above.value), fraction));
    missing.sd = std::max(below.sd, above.sd);
  }
}

TransferCurve curve_of(Contrasts contrasts) {
  const BlurFit blur = fit_blur(contrasts, kOpaque, false);
  TransferCurve curve;
  const double sigma = std::sqrt(std::max(blur.variance_px2.value, 0.0));
  // Near no blur at all the variance, not its root, is what is known.
  const double root_sd = std::sqrt(blur.variance_px2.sd);
  curve.blur_px = {sigma, std::min(root_sd, blur.variance_px2.sd / (2 * std::max(sigma, 1e-6)))};
  curve.chi2 = blur.chi2;
  curve.freedom = blur.freedom;
  interpolate_missing(contrasts);
  curve.contrast = contrasts;
  return curve;
}

// Blocks averaged; their scatter beyond their own uncertainty is in the mean's.
TransferCurve average(const std::vector<TransferBlock>& blocks, std::size_t band) {
  Contrasts contrasts;
  for (std::size_t n = 0; n < kTransferHarmonics; ++n) {
    double weight_sum = 0, sum = 0, chi2 = 0, count = 0;
    for (const TransferBlock& block : blocks) {
      const Measured& m = block.bands[band].contrast[n];
      if (m.sd == 0) continue;
      const double weight = 1 / (m.sd * m.sd);
      weight_sum += weight;
      sum += weight * m.value;
      ++count;
    }
    if (count == 0) continue;
    const double mean = sum / weight_sum;
    for (const TransferBlock& block : blocks) {
      const Measured& m = block.bands[band].contrast[n];
      if (m.sd != 0) chi2 += std::pow((m.value - mean) / m.sd, 2);
    }
    const double excess = std::max(1.0, chi2 / std::max(1.0, count - 1));
    contrasts[n] = {mean, std::sqrt(excess / weight_sum)};
  }
  return curve_of(contrasts);
}

ScatteringTest test_scattering(const Contrasts& contrasts, double pitch_mm) {
  ScatteringTest test;
  test.chi2_blur = test.chi2_scattering = fit_blur(contrasts, kOpaque, true).chi2;
  const auto model = make_scattering_model("dipole", {});
  if (!model) return test;
  constexpr int kSteps = 60;
  for (int i = 0; i <= kSteps; ++i) {
    const double translucency_px = 0.1 * std::pow(2000.0, 1.0 * i / kSteps);
    std::array<double, kTransferHarmonics + 1> k_times_l{}, reflectance{};
    for (int n = 0; n <= kTransferHarmonics; ++n)
      k_times_l[index(n)] = 2 * std::numbers::pi * n / kTransferPeriodPx * translucency_px;
    (*model)->transform(kTargetReflectance, k_times_l, reflectance);
    std::array<double, kTransferHarmonics> shape{};
    for (std::size_t n = 0; n < kTransferHarmonics; ++n)
      shape[n] = reflectance[n + 1] / reflectance[0];
    const double chi2 = fit_blur(contrasts, shape, true).chi2;
    if (chi2 >= test.chi2_scattering) continue;
    test.chi2_scattering = chi2;
    test.translucency_mm = translucency_px * pitch_mm;
  }
  test.is_scattering = test.chi2_blur - test.chi2_scattering > kScatteringGain;
  return test;
}

double median_of(ImageView<const float> image) {
  std::vector<float> values;
  for (int row = 0; row < image.height_px; ++row)
    for (const float value : image.row(row))
      if (std::isfinite(value)) values.push_back(value);
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return static_cast<double>(*middle);
}

tl::unexpected<InputError> refuse(InputFault fault, const std::string& expectation) {
  return tl::unexpected(InputError{fault, "", "", expectation});
}

bool is_even_sweep(const TransferSweep& sweep) {
  std::vector<int> shifts = sweep.shift_px;
  std::ranges::sort(shifts);
  if (shifts.size() < kLeastShifts || shifts.size() != sweep.signals.size()) return false;
  if (kTransferPeriodPx % static_cast<int>(shifts.size()) != 0) return false;
  for (std::size_t i = 1; i < shifts.size(); ++i)
    if (shifts[i] - shifts[i - 1] != kTransferPeriodPx / static_cast<int>(shifts.size()))
      return false;
  return true;
}

std::optional<TransferBlock> read_block(const SweepReader& reader, const TransferSweep& sweep,
                                        const cv::Rect& area, int band_count) {
  TransferBlock block{.col_px = area.x + (area.width - 1) / 2.0,
                      .row_px = area.y + (area.height - 1) / 2.0,
                      .bands = {}};
  for (int band = 0; band < band_count; ++band) {
    const std::vector<TransferPixel> pixels = reader.pixels(area, band);
    if (static_cast<int>(pixels.size()) < kLeastPixels) return std::nullopt;
    block.bands[index(band)] = curve_of(contrasts_of(reader.sums(pixels), sweep.width_px));
    if (band > 0) continue;
    for (const TransferPixel& pixel : pixels) {
      const double share = 1.0 / static_cast<double>(pixels.size());
      block.distance_mm +=
          share * static_cast<double>(sweep.projector_distance_mm.at(pixel.row, pixel.col));
      block.pitch_mm += share * static_cast<double>(sweep.pitch_mm.at(pixel.row, pixel.col));
    }
  }
  return block;
}

void judge(TransferFit& fit, double pitch_mm) {
  for (int band = 0; band < fit.band_count; ++band) {
    const ScatteringTest test = test_scattering(fit.bands[index(band)].contrast, pitch_mm);
    const double gain = test.chi2_blur - test.chi2_scattering;
    if (band == 0 || gain > fit.scattering.chi2_blur - fit.scattering.chi2_scattering)
      fit.scattering = test;
  }
  if (!fit.scattering.is_scattering) return;
  char text[256];
  std::snprintf(text, sizeof text,
                "the target scatters light over about %.1f mm: its contrasts are not the optics' "
                "alone (chi-square %.0f as blur, %.0f as blur and scattering). Measure on an "
                "opaque target, such as thin matte paint on metal",
                fit.scattering.translucency_mm, fit.scattering.chi2_blur,
                fit.scattering.chi2_scattering);
  fit.warnings.emplace_back(text);
}

}  // namespace

Result<TransferFit> fit_transfer(const TransferSweep& sweep, const CameraInfo& camera) {
  if (!is_even_sweep(sweep))
    return refuse(InputFault::kInvalid,
                  "the transfer needs stripes of period 40 at 20 or 40 evenly spaced shifts");
  const SweepReader reader(sweep, camera);
  TransferFit fit;
  fit.band_count = band_count(camera.pixel_format.filter);
  for (int i = 0; i < kBlockRows * kBlockCols; ++i) {
    const int row = i / kBlockCols, col = i % kBlockCols;
    const int left = camera.width_px * col / kBlockCols, top = camera.height_px * row / kBlockRows;
    const cv::Rect area(left, top, camera.width_px * (col + 1) / kBlockCols - left,
                        camera.height_px * (row + 1) / kBlockRows - top);
    if (const auto block = read_block(reader, sweep, area, fit.band_count))
      fit.blocks.push_back(*block);
  }
  if (fit.blocks.empty())
    return refuse(InputFault::kInsufficient,
                  "no part of the picture shows enough of the target under the stripes");
  for (int band = 0; band < fit.band_count; ++band)
    fit.bands[index(band)] = average(fit.blocks, index(band));
  fit.distance_mm = median_of(sweep.projector_distance_mm);
  judge(fit, median_of(sweep.pitch_mm));
  return fit;
}

}  // namespace estimation
