#include "estimation/calibration/sensor_fit.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <utility>

namespace estimation {
namespace {

constexpr double kTrimFrac = 1e-3;          // of a dark frame's pixels, at either end: hot and dead
constexpr double kUsableFrac = 0.9;         // of the range: above, clipping cuts the noise
constexpr double kLeastSignalFrac = 0.05;   // of the range, for linearity
constexpr int kBins = 64;                   // of the photon transfer curve, even in the root
constexpr double kLeastSamples = 200;       // of a bin
constexpr double kClipSd = 6;               // pixels that flicker are no photon noise
constexpr double kQuantisation = 1.0 / 12;  // DN^2
constexpr int kClasses = 16;                // of pixels by their rate, for linearity
constexpr double kLinearityLimit = 0.01;    // costs 0.7% of l_d (estimation.md section 4)

tl::unexpected<InputError> insufficient(const std::string& expectation) {
  return tl::unexpected(InputError{InputFault::kInsufficient, "", "", expectation});
}

std::string percent(double frac) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f%%", 100 * frac);
  return text;
}

double trimmed_mean(ImageView<const std::uint16_t> dn) {
  std::array<double, 65536> histogram{};
  double count = 0;
  for (int row = 0; row < dn.height_px; ++row)
    for (const std::uint16_t value : dn.row(row)) {
      ++histogram[value];
      ++count;
    }
  double below = 0, sum = 0, kept = 0;
  for (std::size_t value = 0; value < histogram.size(); ++value) {
    const double first = std::max(below, kTrimFrac * count);
    below += histogram[value];
    const double last = std::min(below, (1 - kTrimFrac) * count);
    if (last <= first) continue;
    sum += static_cast<double>(value) * (last - first);
    kept += last - first;
  }
  return sum / kept;
}

// y = a + b x by weighted least squares.
struct Line {
  Measured offset, slope;
};

Line fit_line(std::span<const double> x, std::span<const double> y,
              std::span<const double> weight) {
  double w = 0, wx = 0, wy = 0, wxx = 0, wxy = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    w += weight[i];
    wx += weight[i] * x[i];
    wy += weight[i] * y[i];
    wxx += weight[i] * x[i] * x[i];
    wxy += weight[i] * x[i] * y[i];
  }
  const double determinant = w * wxx - wx * wx;
  Line line;
  line.slope = {(w * wxy - wx * wy) / determinant, std::sqrt(w / determinant)};
  line.offset = {(wxx * wy - wx * wxy) / determinant, std::sqrt(wxx / determinant)};
  return line;
}

void fit_black(std::span<const SeriesFrame> frames, SensorFit& fit) {
  std::vector<double> exposure_us, level_dn;
  for (const SeriesFrame& frame : frames) {
    if (!frame.is_dark) continue;
    exposure_us.push_back(frame.exposure_us);
    level_dn.push_back(trimmed_mean(frame.dn));
  }
  const auto [least, most] = std::minmax_element(exposure_us.begin(), exposure_us.end());
  const std::vector<double> ones(exposure_us.size(), 1);
  const double count = static_cast<double>(level_dn.size());
  Line line;
  if (*least < *most) {
    line = fit_line(exposure_us, level_dn, ones);
  } else {
    for (const double level : level_dn) line.offset.value += level / count;
    line.offset.sd = 1 / std::sqrt(count);
  }
  double squares = 0;
  for (std::size_t i = 0; i < level_dn.size(); ++i)
    squares += std::pow(level_dn[i] - line.offset.value - line.slope.value * exposure_us[i], 2);
  const double freedom = std::max(1.0, count - (*least < *most ? 2 : 1));
  const double scatter = std::sqrt(squares / freedom);
  fit.black_level_dn = {line.offset.value, line.offset.sd * scatter};
  fit.dark_signal_dn_per_us = {line.slope.value, line.slope.sd * scatter};
}

double black_at(const SensorFit& fit, double exposure_us) {
  return fit.black_level_dn.value + fit.dark_signal_dn_per_us.value * exposure_us;
}

struct Sums {
  double count = 0, signal = 0, squares = 0;
};

// Half the mean square difference of two frames, by signal. A ratio takes the light's drift out,
// one for each site of a 2 x 2 mosaic and each channel: a colour wheel's light drifts by colour.
class DifferenceBins {
 public:
  explicit DifferenceBins(double range_dn) : range_dn_(range_dn) {}

  // A dark pair has one bin of its own: sorted by their noise, its samples would pass for light.
  void add(ImageView<const std::uint16_t> a, ImageView<const std::uint16_t> b, double black_dn,
           bool is_dark) {
    std::vector<double> sum_a(kSites * static_cast<std::size_t>(a.channel_count)), sum_b = sum_a;
    for_each(a, b, black_dn, [&](double x, double y, std::size_t site) {
      sum_a[site] += x;
      sum_b[site] += y;
    });
    std::vector<double> ratios(sum_a.size(), 1);
    for (std::size_t site = 0; site < ratios.size(); ++site)
      if (!is_dark && sum_a[site] > 0 && sum_b[site] > 0) ratios[site] = sum_a[site] / sum_b[site];
    std::array<Sums, kAllBins> all{}, kept{};
    const auto pass = [&](std::array<Sums, kAllBins>& into,
                          const std::array<Sums, kAllBins>* limits) {
      for_each(a, b, black_dn, [&](double x, double y, std::size_t site) {
        const double ratio = ratios[site];
        const double signal = (x + ratio * y) / 2, difference = x - ratio * y;
        // The difference's variance is v (1 + ratio^2).
        const double square = difference * difference / (1 + ratio * ratio);
        const std::size_t bin = is_dark ? 0 : 1 + bin_of(signal);
        if (limits != nullptr) {
          const Sums& s = (*limits)[bin];
          if (square > kClipSd * kClipSd * s.squares / s.count) return;
        }
        into[bin].count += 1;
        into[bin].signal += signal;
        into[bin].squares += square;
      });
    };
    pass(all, nullptr);
    pass(kept, &all);
    for (std::size_t i = 0; i < kAllBins; ++i) {
      sums_[i].count += kept[i].count;
      sums_[i].signal += kept[i].signal;
      sums_[i].squares += kept[i].squares;
    }
  }

  std::vector<SensorFit::PhotonPoint> points() const {
    std::vector<SensorFit::PhotonPoint> points;
    for (const Sums& s : sums_) {
      if (s.count < kLeastSamples || s.signal > kUsableFrac * range_dn_ * s.count) continue;
      points.push_back({s.signal / s.count, s.squares / s.count, 0, s.count});
    }
    return points;
  }

 private:
  template <typename Use>
  static void for_each(ImageView<const std::uint16_t> a, ImageView<const std::uint16_t> b,
                       double black_dn, const Use& use) {
    for (int row = 0; row < a.height_px; ++row) {
      const auto row_a = a.row(row), row_b = b.row(row);
      for (std::size_t i = 0; i < row_a.size(); ++i)
        use(row_a[i] - black_dn, row_b[i] - black_dn, mosaic_site(row, i, a.channel_count));
    }
  }
  std::size_t bin_of(double signal) const {
    const double at = std::sqrt(std::clamp(signal / range_dn_, 0.0, 1.0)) * kBins;
    return std::min<std::size_t>(kBins - 1, static_cast<std::size_t>(at));
  }

  static constexpr std::size_t kAllBins = kBins + 1, kSites = 4;
  double range_dn_;
  std::array<Sums, kAllBins> sums_{};
};

// Indices of the frames of each exposure.
std::map<double, std::vector<std::size_t>> by_exposure(std::span<const SeriesFrame> frames,
                                                       bool is_dark) {
  std::map<double, std::vector<std::size_t>> groups;
  for (std::size_t i = 0; i < frames.size(); ++i)
    if (frames[i].is_dark == is_dark) groups[frames[i].exposure_us].push_back(i);
  return groups;
}

Result<void> fit_photon_transfer(std::span<const SeriesFrame> frames, double saturation_dn,
                                 SensorFit& fit) {
  DifferenceBins bins(saturation_dn - fit.black_level_dn.value);
  int lit_pairs = 0;
  for (const bool is_dark : {true, false})
    for (const auto& [exposure_us, indices] : by_exposure(frames, is_dark))
      for (std::size_t i = 0; i + 1 < indices.size(); i += 2) {
        bins.add(frames[indices[i]].dn, frames[indices[i + 1]].dn, black_at(fit, exposure_us),
                 is_dark);
        lit_pairs += is_dark ? 0 : 1;
      }
  std::vector<SensorFit::PhotonPoint> points = bins.points();
  if (lit_pairs == 0 || points.size() < 3)
    return insufficient(
        "gain and read noise need two frames or more of the same exposure, lit from dark to "
        "nearly saturated");
  std::vector<double> x, y, weight;
  for (const auto& point : points) {
    x.push_back(point.signal_dn);
    y.push_back(point.variance_dn2);
    weight.push_back(1);
  }
  Line line;
  // A variance from n samples has a standard deviation of sqrt(2 / n) of itself; of the fit's, not
  // of its own, or low ones would win.
  for (int round = 0; round < 4; ++round) {
    for (std::size_t i = 0; i < x.size(); ++i) {
      const double expected = round == 0 ? y[i] : line.offset.value + line.slope.value * x[i];
      weight[i] = points[i].sample_count / (2 * std::pow(std::max(expected, 1e-3), 2));
    }
    line = fit_line(x, y, weight);
  }
  for (auto& point : points)
    point.fitted_dn2 = line.offset.value + line.slope.value * point.signal_dn;
  fit.photon_transfer = std::move(points);
  if (!(line.slope.value > 0))
    return insufficient(
        "the noise does not grow with the signal: is the light steady and the "
        "series long enough?");
  const double gain = 1 / line.slope.value;
  fit.gain_e_per_dn = {gain, gain * line.slope.sd / line.slope.value};
  const double read_dn2 = std::max(line.offset.value - kQuantisation, 0.0);
  const double read_dn = std::sqrt(read_dn2);
  const double read_sd_dn = read_dn > 0 ? line.offset.sd / (2 * read_dn) : line.offset.sd;
  fit.read_noise_e = {read_dn * gain,
                      std::hypot(read_sd_dn * gain, read_dn * fit.gain_e_per_dn.sd)};
  return {};
}

// Mean signal of classes of pixels (by their rate) at each exposure.
class RateClasses {
 public:
  RateClasses(std::span<const SeriesFrame> frames, const SensorFit& fit, double saturation_dn)
      : frames_(frames), fit_(fit), range_dn_(saturation_dn - fit.black_level_dn.value) {
    // The shortest exposure has the least to clip: it sorts the pixels, and its own noise with
    // them, so it is not averaged if there are others.
    const SeriesFrame& first = *std::ranges::min_element(frames, [](const auto& a, const auto& b) {
      return std::pair(a.is_dark, a.exposure_us) < std::pair(b.is_dark, b.exposure_us);
    });
    sorting_ = static_cast<std::size_t>(&first - frames.data());
    std::vector<std::uint16_t> sorted;
    for (int row = 0; row < first.dn.height_px; ++row)
      for (const std::uint16_t value : first.dn.row(row)) sorted.push_back(value);
    std::vector<std::uint16_t> values = sorted;
    std::ranges::sort(sorted);
    class_of_.reserve(values.size());
    for (const std::uint16_t value : values) {
      const auto rank = std::ranges::lower_bound(sorted, value) - sorted.begin();
      class_of_.push_back(
          static_cast<unsigned char>(rank * kClasses / static_cast<std::ptrdiff_t>(sorted.size())));
    }
  }

  // By class: exposure and mean signal, those near the range's end left out.
  std::vector<std::vector<std::pair<double, double>>> curves() const {
    std::vector<std::vector<std::pair<double, double>>> curves(kClasses);
    for (const auto& [exposure_us, indices] : by_exposure(frames_, false)) {
      std::array<Sums, kClasses> sums{};
      std::array<double, kClasses> highest{};
      for (const std::size_t index : indices)
        if (index != sorting_ || indices.size() == 1) add(frames_[index], sums, highest);
      for (std::size_t c = 0; c < kClasses; ++c)
        if (sums[c].count > 0 && highest[c] < 0.97 * range_dn_)
          curves[c].emplace_back(exposure_us, sums[c].signal / sums[c].count);
    }
    return curves;
  }

 private:
  void add(const SeriesFrame& frame, std::array<Sums, kClasses>& sums,
           std::array<double, kClasses>& highest) const {
    const double black_dn = black_at(fit_, frame.exposure_us);
    std::size_t i = 0;
    for (int row = 0; row < frame.dn.height_px; ++row)
      for (const std::uint16_t value : frame.dn.row(row)) {
        const std::size_t c = class_of_[i++];
        const double signal = value - black_dn;
        sums[c].count += 1;
        sums[c].signal += signal;
        highest[c] = std::max(highest[c], signal);
      }
  }

  std::span<const SeriesFrame> frames_;
  const SensorFit& fit_;
  double range_dn_;
  std::size_t sorting_ = 0;              // index of the frame that sorts
  std::vector<unsigned char> class_of_;  // [sample]
};

void fit_linearity(std::span<const SeriesFrame> frames, double saturation_dn, SensorFit& fit) {
  const double range_dn = saturation_dn - fit.black_level_dn.value;
  double largest = 0, largest_sd = 0;
  for (const auto& curve : RateClasses(frames, fit, saturation_dn).curves()) {
    // Through the origin, each point with the same relative weight.
    double rate = 0, count = 0;
    for (const auto& [exposure_us, signal_dn] : curve) {
      if (signal_dn < kLeastSignalFrac * range_dn) continue;
      rate += signal_dn / exposure_us;
      ++count;
    }
    if (count < 2) continue;
    rate /= count;
    for (const auto& [exposure_us, signal_dn] : curve) {
      if (signal_dn < kLeastSignalFrac * range_dn) continue;
      const double deviation = signal_dn / (rate * exposure_us) - 1;
      fit.linearity.push_back({exposure_us, signal_dn, deviation});
      if (std::abs(deviation) > largest) {
        largest = std::abs(deviation);
        largest_sd = fit.black_level_dn.sd / signal_dn;
      }
    }
  }
  if (fit.linearity.empty())
    fit.warnings.push_back(
        "linearity was not measured: it needs two exposures or more that reach 5% of the range");
  fit.linearity_max_frac = {largest, largest_sd};
  if (largest > kLinearityLimit)
    fit.warnings.push_back("the camera deviates from linearity by " + percent(largest) +
                           "; expected at most " + percent(kLinearityLimit) +
                           ": is its gamma off, is the light steady, is the black level right?");
}

}  // namespace

Result<SensorFit> fit_sensor(std::span<const SeriesFrame> frames, double saturation_dn) {
  const auto is_dark = [](const SeriesFrame& frame) { return frame.is_dark; };
  if (!std::ranges::any_of(frames, is_dark))
    return insufficient("the series has no dark frame; cap the lens and take two at least");
  if (std::ranges::all_of(frames, is_dark)) return insufficient("the series has no lit frame");
  for (const SeriesFrame& frame : frames)
    if (frame.dn.height_px != frames[0].dn.height_px ||
        frame.dn.width_px != frames[0].dn.width_px ||
        frame.dn.channel_count != frames[0].dn.channel_count || !(frame.exposure_us > 0))
      return tl::unexpected(InputError{InputFault::kInvalid, "", "",
                                       "the frames of a series are of one size, with exposures "
                                       "above 0"});
  SensorFit fit;
  fit_black(frames, fit);
  if (const auto fitted = fit_photon_transfer(frames, saturation_dn, fit); !fitted)
    return tl::unexpected(fitted.error());
  fit_linearity(frames, saturation_dn, fit);
  return fit;
}

}  // namespace estimation
