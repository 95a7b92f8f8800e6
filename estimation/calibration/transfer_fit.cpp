#include "estimation/calibration/transfer_fit.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdio>
#include <limits>
#include <numbers>
#include <opencv2/core.hpp>
#include <optional>

#include "estimation/models/scattering_model.h"

namespace estimation {
namespace {

constexpr int kPeriodPx = 40;
constexpr std::size_t kLeastShifts = 20;  // harmonics 1 ... 9 without folding into each other
constexpr int kBlockCols = 8, kBlockRows = 6;
constexpr int kLeastPixels = 120;        // of a band in a block
constexpr double kLeastLevelFrac = 0.3;  // of the median: darker pixels are not the target
// What models of optics leave out (the shape of the blur, projector pixels' gaps): no contrast is
// held to be known better than this.
constexpr double kModelSd = 0.002;
// By how much of chi-square scattering must beat blur alone. A white plastic gives hundreds; a lens
// whose blur has a halo gave 14.
constexpr double kScatteringGain = 40;
constexpr double kTargetReflectance = 0.95;  // a white target's; the shape hardly depends on it

using Complex = std::complex<double>;
using Contrasts = std::array<Measured, kTransferHarmonics>;

std::size_t index(int n) { return static_cast<std::size_t>(n); }

// What an infinitely sharp stripe has at harmonic n, over the mean.
double stripe_harmonic(int n, int width_px) {
  const double x = std::numbers::pi * n * width_px / kPeriodPx;
  return 2 * std::sin(x) / x;
}

bool is_in_stripes(int n, int width_px) { return std::abs(stripe_harmonic(n, width_px)) > 0.05; }

// Of one band in one block: the harmonics of all pixels, turned to the phase that their position
// asks for, over the sum of means; in four parts whose scatter tells the uncertainty.
struct BlockSums {
  static constexpr std::size_t kParts = 8;
  std::array<std::array<Complex, kTransferHarmonics>, kParts> harmonic{};
  std::array<double, kParts> mean{};
  int count = 0;
};

struct Pixel {
  int row = 0, col = 0, channel = 0;
};

// A quadric through the block's positions: a pixel's own would carry its own noise. By least
// squares with Tukey's weights: one code that is wrong by a period outweighs hundreds of right
// ones.
class PositionFit {
 public:
  PositionFit(const ImageView<const float>& position, const std::vector<Pixel>& pixels) {
    origin_ = pixels[pixels.size() / 2];
    std::vector<double> value, weight(pixels.size(), 1), distance(pixels.size());
    for (const Pixel& pixel : pixels)
      value.push_back(static_cast<double>(position.at(pixel.row, pixel.col)));
    for (int round = 0; round < kRounds; ++round) {
      solve(pixels, value, weight);
      for (std::size_t i = 0; i < pixels.size(); ++i)
        distance[i] = std::abs(value[i] - at(pixels[i]));
      std::vector<double> sorted = distance;
      const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
      std::nth_element(sorted.begin(), middle, sorted.end());
      const double reach = kTukeySd * std::max(*middle / 0.6745, kLeastSdPx);
      for (std::size_t i = 0; i < pixels.size(); ++i) {
        const double u = distance[i] / reach;
        weight[i] = u < 1 ? (1 - u * u) * (1 - u * u) : 0;
      }
    }
  }
  double at(const Pixel& pixel) const { return coefficients_.dot(terms(pixel)); }

 private:
  static constexpr int kRounds = 8;
  static constexpr double kTukeySd = 4.7, kLeastSdPx = 0.005;

  void solve(const std::vector<Pixel>& pixels, const std::vector<double>& value,
             const std::vector<double>& weight) {
    cv::Matx66d normal = cv::Matx66d::zeros();
    cv::Matx61d right = cv::Matx61d::zeros();
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      if (weight[i] == 0) continue;
      const cv::Matx61d t = terms(pixels[i]);
      right += (weight[i] * value[i]) * t;
      normal += weight[i] * (t * t.t());
    }
    cv::Mat1d solution;
    cv::solve(normal, right, solution, cv::DECOMP_SVD);
    for (int i = 0; i < 6; ++i) coefficients_(i) = solution(i);
  }
  cv::Matx61d terms(const Pixel& pixel) const {
    const double x = (pixel.col - origin_.col) / 50.0, y = (pixel.row - origin_.row) / 50.0;
    return {1, x, y, x * x, x * y, y * y};
  }
  Pixel origin_;
  cv::Matx61d coefficients_;
};

class SweepReader {
 public:
  SweepReader(const TransferSweep& sweep, const CameraInfo& camera)
      : sweep_(sweep), camera_(camera) {
    for (const int shift_px : sweep.shift_px)
      for (int n = 1; n <= kTransferHarmonics; ++n)
        turns_.push_back(
            std::polar(1.0, 2 * std::numbers::pi * n * (shift_px % kPeriodPx) / kPeriodPx));
  }

  bool is_on_target(int row, int col) const {
    return std::isfinite(sweep_.position_px.at(row, col)) &&
           std::isfinite(sweep_.pitch_mm.at(row, col)) &&
           std::isfinite(sweep_.projector_distance_mm.at(row, col));
  }

  // NaN where a shift is missing.
  double mean(const Pixel& pixel) const {
    double sum = 0;
    for (const auto& signal : sweep_.signals)
      sum += static_cast<double>(signal.at(pixel.row, pixel.col, pixel.channel));
    return sum / static_cast<double>(sweep_.signals.size());
  }

  // Pixels of a band in a block of the picture, darker ones left out.
  std::vector<Pixel> pixels(const cv::Rect& block, int band) const {
    std::vector<Pixel> pixels;
    std::vector<double> means;
    for (int row = block.y; row < block.y + block.height; ++row)
      for (int col = block.x; col < block.x + block.width; ++col) {
        if (!is_on_target(row, col)) continue;
        const bool is_rgb = camera_.pixel_format.filter == ColorFilter::kRgb;
        if (!is_rgb && band_at(camera_, row, col) != band) continue;
        const Pixel pixel{row, col, is_rgb ? band : 0};
        const double level = mean(pixel);
        if (!(level > 0)) continue;
        pixels.push_back(pixel);
        means.push_back(level);
      }
    if (pixels.empty()) return {};
    std::vector<double> sorted = means;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    std::vector<Pixel> bright;
    for (std::size_t i = 0; i < pixels.size(); ++i)
      if (means[i] > kLeastLevelFrac * *middle) bright.push_back(pixels[i]);
    return bright;
  }

  BlockSums sums(const std::vector<Pixel>& pixels) const {
    const PositionFit position(sweep_.position_px, pixels);
    const auto shift_count = static_cast<double>(sweep_.signals.size());
    BlockSums sums;
    sums.count = static_cast<int>(pixels.size());
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      std::array<Complex, kTransferHarmonics> harmonic{};
      double level = 0;
      for (std::size_t s = 0; s < sweep_.signals.size(); ++s) {
        const auto value = static_cast<double>(
            sweep_.signals[s].at(pixels[i].row, pixels[i].col, pixels[i].channel));
        level += value / shift_count;
        for (std::size_t n = 0; n < kTransferHarmonics; ++n)
          harmonic[n] += value * turns_[s * kTransferHarmonics + n] * (2 / shift_count);
      }
      // A stripe at shift s is centred on s + (width - 1) / 2.
      const double peak_px = position.at(pixels[i]) - (sweep_.width_px - 1) / 2.0;
      const Complex step = std::polar(1.0, -2 * std::numbers::pi * peak_px / kPeriodPx);
      Complex turn = step;
      const std::size_t part = i % BlockSums::kParts;
      for (std::size_t n = 0; n < kTransferHarmonics; ++n) {
        sums.harmonic[part][n] += harmonic[n] * turn;
        turn *= step;
      }
      sums.mean[part] += level;
    }
    return sums;
  }

 private:
  const TransferSweep& sweep_;
  const CameraInfo& camera_;
  std::vector<Complex> turns_;  // [shift][n - 1]
};

// Contrast over what a sharp stripe would have. The phase common to the block is taken away: a
// position that is off by a little is no loss of contrast.
Contrasts contrasts_of(const BlockSums& sums, int width_px) {
  Contrasts contrasts;
  for (int n = 1; n <= kTransferHarmonics; ++n) {
    if (!is_in_stripes(n, width_px)) continue;
    Complex all = 0;
    double mean = 0;
    for (std::size_t part = 0; part < BlockSums::kParts; ++part) {
      all += sums.harmonic[part][index(n - 1)];
      mean += sums.mean[part];
    }
    const double sharp = stripe_harmonic(n, width_px);
    const Complex direction = std::abs(all) > 0 ? all / std::abs(all) : 1;
    double squares = 0;
    const double whole = std::abs(all) / mean;
    for (std::size_t part = 0; part < BlockSums::kParts; ++part) {
      const double own =
          (sums.harmonic[part][index(n - 1)] * std::conj(direction)).real() / sums.mean[part];
      squares += (own - whole) * (own - whole);
    }
    constexpr auto kParts = static_cast<double>(BlockSums::kParts);
    contrasts[index(n - 1)] = {whole / std::abs(sharp),
                               std::sqrt(squares / (kParts * (kParts - 1))) / std::abs(sharp)};
  }
  return contrasts;
}

// (2 pi n / 40)^2 / 2: minus the logarithm of a Gaussian's contrast, over its variance in px^2.
double blur_exponent(int n) {
  const double k = 2 * std::numbers::pi * n / kPeriodPx;
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
      k_times_l[index(n)] = 2 * std::numbers::pi * n / kPeriodPx * translucency_px;
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
  if (kPeriodPx % static_cast<int>(shifts.size()) != 0) return false;
  for (std::size_t i = 1; i < shifts.size(); ++i)
    if (shifts[i] - shifts[i - 1] != kPeriodPx / static_cast<int>(shifts.size())) return false;
  return true;
}

std::optional<TransferBlock> read_block(const SweepReader& reader, const TransferSweep& sweep,
                                        const cv::Rect& area, int band_count) {
  TransferBlock block{.col_px = area.x + (area.width - 1) / 2.0,
                      .row_px = area.y + (area.height - 1) / 2.0,
                      .bands = {}};
  for (int band = 0; band < band_count; ++band) {
    const std::vector<Pixel> pixels = reader.pixels(area, band);
    if (static_cast<int>(pixels.size()) < kLeastPixels) return std::nullopt;
    block.bands[index(band)] = curve_of(contrasts_of(reader.sums(pixels), sweep.width_px));
    if (band > 0) continue;
    for (const Pixel& pixel : pixels) {
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
