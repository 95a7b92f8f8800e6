#include "estimation/radiometry/noise.h"

#include <algorithm>
#include <cmath>
#include <functional>

namespace estimation {
namespace {

// Median absolute value of a normal variable is 0.6745 standard deviations.
constexpr double kSdFromMedian = 1 / 0.6745;
// Fourth differences, with weights 1 -4 6 -4 1, have sqrt(70) times the standard deviation of their
// samples; of a sinusoid of 40 shifts they leave 1/1600.
const double kFourthDifference = std::sqrt(70.0);
constexpr std::size_t kMostPixels = 20000;

template <typename T>
T median(std::vector<T>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

struct PixelNoise {
  double mean = 0, variance = 0;
};

std::optional<PixelNoise> noise_of_pixel(std::span<const ImageView<const float>> signals, int row,
                                         int col) {
  double sum = 0;
  for (const ImageView<const float>& signal : signals)
    sum += static_cast<double>(signal.at(row, col));
  if (!std::isfinite(sum)) return std::nullopt;
  const auto at = [&](std::size_t i) { return static_cast<double>(signals[i].at(row, col)); };
  std::vector<double> differences;
  for (std::size_t i = 2; i + 2 < signals.size(); ++i)
    differences.push_back(
        std::abs(at(i - 2) - 4 * at(i - 1) + 6 * at(i) - 4 * at(i + 1) + at(i + 2)));
  const double sd = median(differences) * kSdFromMedian / kFourthDifference;
  return PixelNoise{.mean = sum / static_cast<double>(signals.size()), .variance = sd * sd};
}

}  // namespace

std::vector<MergedNoise> merged_noise(std::vector<double> exposures_us, const SensorNoise& sensor,
                                      double headroom_dn) {
  std::sort(exposures_us.begin(), exposures_us.end(), std::greater<>());
  const double read_dn = sensor.read_noise_e / sensor.gain_e_per_dn;
  std::vector<MergedNoise> noise;
  for (std::size_t first = 0; first < exposures_us.size(); ++first) {
    if (first > 0 && exposures_us[first] == exposures_us[first - 1]) continue;
    double total_us = 0;
    for (std::size_t i = first; i < exposures_us.size(); ++i) total_us += exposures_us[i];
    const double frames = static_cast<double>(exposures_us.size() - first);
    noise.push_back(
        {.up_to_dn_per_us = headroom_dn / exposures_us[first],
         .read_variance = frames * (read_dn * read_dn + 1.0 / 12) / (total_us * total_us),
         .shot_dn_per_us = 1 / (sensor.gain_e_per_dn * total_us)});
  }
  if (!noise.empty()) noise.back().up_to_dn_per_us = std::numeric_limits<double>::infinity();
  return noise;
}

std::vector<MergedNoise> mean_noise(std::span<const SharedNoise> kinds) {
  if (kinds.size() == 1) return kinds.front().noise;
  std::vector<double> ends;
  double shares = 0;
  for (const SharedNoise& kind : kinds) {
    shares += kind.share;
    for (const MergedNoise& entry : kind.noise) ends.push_back(entry.up_to_dn_per_us);
  }
  std::sort(ends.begin(), ends.end());
  ends.erase(std::unique(ends.begin(), ends.end()), ends.end());
  std::vector<MergedNoise> mean;
  for (const double end : ends) {
    MergedNoise& sum = mean.emplace_back(MergedNoise{.up_to_dn_per_us = end});
    for (const SharedNoise& kind : kinds) {
      const auto own = std::find_if(kind.noise.begin(), kind.noise.end(),
                                    [&](const auto& e) { return end <= e.up_to_dn_per_us; });
      sum.read_variance += kind.share / shares * own->read_variance;
      sum.shot_dn_per_us += kind.share / shares * own->shot_dn_per_us;
    }
  }
  return mean;
}

std::vector<MergedNoise> above_background(std::vector<MergedNoise> noise,
                                          double background_dn_per_us) {
  for (MergedNoise& entry : noise) {
    entry.up_to_dn_per_us -= background_dn_per_us;  // infinity stays
    entry.read_variance += entry.shot_dn_per_us * background_dn_per_us;
  }
  return noise;
}

double variance_at(std::span<const MergedNoise> noise, double signal_dn_per_us) {
  if (noise.empty()) return 0;
  const auto of = [&](const MergedNoise& entry, double signal) {
    return entry.read_variance + entry.shot_dn_per_us * std::max(signal, 0.0);
  };
  double variance = of(noise.back(), signal_dn_per_us);
  for (std::size_t i = noise.size() - 1; i-- > 0;) {
    const double width = kMixtureWidth * std::sqrt(of(noise[i], noise[i].up_to_dn_per_us));
    const double beyond = signal_dn_per_us - noise[i].up_to_dn_per_us;
    const double share = width > 0 ? std::clamp(beyond / width + 0.5, 0.0, 1.0) : beyond > 0;
    variance = std::lerp(of(noise[i], signal_dn_per_us), variance, share);
  }
  return variance;
}

std::optional<MergedNoise> noise_from_stripes(std::span<const ImageView<const float>> signals) {
  if (signals.size() < 8) return std::nullopt;
  const int height = signals.front().height_px, width = signals.front().width_px;
  const std::size_t pixel_count =
      static_cast<std::size_t>(height) * static_cast<std::size_t>(width);
  const std::size_t step = std::max<std::size_t>(1, pixel_count / kMostPixels);
  std::vector<PixelNoise> pixels;
  for (std::size_t i = 0; i < pixel_count; i += step) {
    const int row = static_cast<int>(i / static_cast<std::size_t>(width));
    const int col = static_cast<int>(i % static_cast<std::size_t>(width));
    if (const auto pixel = noise_of_pixel(signals, row, col)) pixels.push_back(*pixel);
  }
  if (pixels.size() < 100) return std::nullopt;
  std::stable_sort(pixels.begin(), pixels.end(),
                   [](const PixelNoise& a, const PixelNoise& b) { return a.mean < b.mean; });
  std::vector<double> dark, shot;
  for (std::size_t i = 0; i < pixels.size() / 10; ++i) dark.push_back(pixels[i].variance);
  const double read_variance = median(dark);
  for (std::size_t i = pixels.size() / 2; i < pixels.size(); ++i)
    if (pixels[i].mean > 0) shot.push_back((pixels[i].variance - read_variance) / pixels[i].mean);
  const double shot_dn_per_us = shot.empty() ? 0 : std::max(median(shot), 0.0);
  return MergedNoise{.read_variance = read_variance, .shot_dn_per_us = shot_dn_per_us};
}

}  // namespace estimation
