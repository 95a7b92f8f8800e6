#include "estimation/calibration/transfer_contrast.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace estimation {
namespace {

constexpr double kLeastLevelFrac = 0.3;  // of the median: darker pixels are not the target

using Complex = std::complex<double>;
using Pixel = TransferPixel;

std::size_t index(int n) { return static_cast<std::size_t>(n); }

// What an infinitely sharp stripe has at harmonic n, over the mean.
double stripe_harmonic(int n, int width_px) {
  const double x = std::numbers::pi * n * width_px / kTransferPeriodPx;
  return 2 * std::sin(x) / x;
}

bool is_in_stripes(int n, int width_px) { return std::abs(stripe_harmonic(n, width_px)) > 0.05; }

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

}  // namespace

SweepReader::SweepReader(const TransferSweep& sweep, const CameraInfo& camera)
    : sweep_(sweep), camera_(camera) {
  for (const int shift_px : sweep.shift_px)
    for (int n = 1; n <= kTransferHarmonics; ++n)
      turns_.push_back(std::polar(
          1.0, 2 * std::numbers::pi * n * (shift_px % kTransferPeriodPx) / kTransferPeriodPx));
}

bool SweepReader::is_on_target(int row, int col) const {
  return std::isfinite(sweep_.position_px.at(row, col)) &&
         std::isfinite(sweep_.pitch_mm.at(row, col)) &&
         std::isfinite(sweep_.projector_distance_mm.at(row, col));
}

double SweepReader::mean(const Pixel& pixel) const {
  double sum = 0;
  for (const auto& signal : sweep_.signals)
    sum += static_cast<double>(signal.at(pixel.row, pixel.col, pixel.channel));
  return sum / static_cast<double>(sweep_.signals.size());
}

std::vector<Pixel> SweepReader::pixels(const cv::Rect& block, int band) const {
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

BlockSums SweepReader::sums(const std::vector<Pixel>& pixels) const {
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
    const Complex step = std::polar(1.0, -2 * std::numbers::pi * peak_px / kTransferPeriodPx);
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

}  // namespace estimation
