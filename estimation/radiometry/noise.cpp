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
// Just above saturation noise alone decides whether a sample has lost its long exposure.
constexpr double kClearlyBelow = 0.85;

template <typename T>
T median(std::vector<T>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

struct PixelNoise {
  double mean = 0, variance = 0;
};

// What five neighbouring shifts say about noise.
struct Window {
  double mean = 0, fourth_difference = 0;
};

PixelNoise noise_of(std::span<const Window> windows) {
  double sum = 0;
  std::vector<double> differences;
  for (const Window& window : windows) {
    sum += window.mean;
    differences.push_back(std::abs(window.fourth_difference));
  }
  const double sd = median(differences) * kSdFromMedian / kFourthDifference;
  return {.mean = sum / static_cast<double>(windows.size()), .variance = sd * sd};
}

// Of the pixel's darker shifts and of its brightest ones: on an even surface all pixels are alike,
// and only their own profile tells shot noise from read noise.
void add_noise_of_pixel(std::span<const ImageView<const float>> signals, int row, int col,
                        double below_dn_per_us, std::vector<PixelNoise>& noise) {
  const auto at = [&](std::size_t i) { return static_cast<double>(signals[i].at(row, col)); };
  std::vector<Window> windows;
  for (std::size_t i = 2; i + 2 < signals.size(); ++i) {
    double sum = 0, greatest = 0;
    for (std::size_t j = i - 2; j <= i + 2; ++j) {
      sum += at(j);
      greatest = std::max(greatest, at(j));
    }
    if (!std::isfinite(sum) || greatest >= kClearlyBelow * below_dn_per_us) continue;
    windows.push_back({sum / 5, at(i - 2) - 4 * at(i - 1) + 6 * at(i) - 4 * at(i + 1) + at(i + 2)});
  }
  if (windows.size() < 4) return;
  std::sort(windows.begin(), windows.end(),
            [](const Window& a, const Window& b) { return a.mean < b.mean; });
  const std::span<const Window> all = windows;
  // Odd numbers, which have a middle.
  noise.push_back(noise_of(all.first((all.size() / 2 - 1) | 1U)));
  noise.push_back(noise_of(all.last(all.size() / 5 | 1U)));
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

std::optional<SensorNoise> sensor_of(const MergedNoise& noise,
                                     std::span<const double> exposures_us) {
  double total_us = 0;
  for (const double exposure_us : exposures_us) total_us += exposure_us;
  if (!(noise.shot_dn_per_us > 0 && total_us > 0)) return std::nullopt;
  const double gain_e_per_dn = 1 / (noise.shot_dn_per_us * total_us);
  const double read_dn2 =
      noise.read_variance * total_us * total_us / static_cast<double>(exposures_us.size()) -
      1.0 / 12;
  return SensorNoise{gain_e_per_dn, gain_e_per_dn * std::sqrt(std::max(read_dn2, 0.0))};
}

std::optional<MergedNoise> noise_from_stripes(std::span<const ImageView<const float>> signals,
                                              double below_dn_per_us) {
  if (signals.size() < 8) return std::nullopt;
  const int height = signals.front().height_px, width = signals.front().width_px;
  const std::size_t pixel_count =
      static_cast<std::size_t>(height) * static_cast<std::size_t>(width);
  const std::size_t step = std::max<std::size_t>(1, pixel_count / kMostPixels);
  std::vector<PixelNoise> pixels;
  for (std::size_t i = 0; i < pixel_count; i += step)
    add_noise_of_pixel(signals, static_cast<int>(i / static_cast<std::size_t>(width)),
                       static_cast<int>(i % static_cast<std::size_t>(width)), below_dn_per_us,
                       pixels);
  if (pixels.size() < 100) return std::nullopt;
  std::stable_sort(pixels.begin(), pixels.end(),
                   [](const PixelNoise& a, const PixelNoise& b) { return a.mean < b.mean; });
  std::vector<double> means, variances, slopes;
  for (std::size_t i = 0; i < pixels.size() / 10; ++i) {
    means.push_back(pixels[i].mean);
    variances.push_back(pixels[i].variance);
  }
  const PixelNoise dark{median(means), median(variances)};
  for (std::size_t i = pixels.size() / 2; i < pixels.size(); ++i)
    if (pixels[i].mean > dark.mean)
      slopes.push_back((pixels[i].variance - dark.variance) / (pixels[i].mean - dark.mean));
  const double shot_dn_per_us = slopes.empty() ? 0 : std::max(median(slopes), 0.0);
  // The darkest have shot noise of their own; that all of their noise is that, no sensor does.
  constexpr double kLeastReadFrac = 0.05;
  const double read_variance = std::max(dark.variance - shot_dn_per_us * std::max(dark.mean, 0.0),
                                        kLeastReadFrac * dark.variance);
  return MergedNoise{.read_variance = read_variance, .shot_dn_per_us = shot_dn_per_us};
}

}  // namespace estimation
