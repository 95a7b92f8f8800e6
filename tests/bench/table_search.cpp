// The paper's table: by its parabolic finder (the product's), and by trying all columns.
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "estimation/profile/lut_fit.h"
#include "tests/bench/methods.h"

namespace bench {
namespace {

using estimation::ProfileMatcher;
using estimation::ProfileTable;
using std::numbers::pi;

// The range that the pixels' subjects occupy, with room for noise and indirect light, as the
// product limits its table.
estimation::TableRange range_of(const PixelSet& pixels) {
  estimation::TableRange range{.least_reflectance = 1,
                               .greatest_reflectance = 0,
                               .least_translucency_px = 1e9,
                               .greatest_translucency_px = 0};
  for (const Subject& subject : pixels.subjects) {
    const double l_d_px = subject.translucency_mm / subject.pitch_mm;
    range.least_reflectance = std::min(range.least_reflectance, subject.diffuse_reflectance);
    range.greatest_reflectance = std::max(range.greatest_reflectance, subject.diffuse_reflectance);
    range.least_translucency_px = std::min(range.least_translucency_px, l_d_px);
    range.greatest_translucency_px = std::max(range.greatest_translucency_px, l_d_px);
  }
  return {.least_reflectance = std::max(0.5 * range.least_reflectance, 0.002),
          .greatest_reflectance = std::min(1.2 * range.greatest_reflectance + 0.12, 0.998),
          .least_translucency_px = std::max(0.4 * range.least_translucency_px, 0.05),
          .greatest_translucency_px = 4 * range.greatest_translucency_px};
}

class ParabolicTable : public Method {
 public:
  ParabolicTable(const estimation::ScatteringModel& model, const PixelSet& pixels)
      : table_(model, pixels.shape, range_of(pixels)) {}
  std::string name() const override { return "paper's table, parabolic"; }

  void run(const PixelSet& pixels, std::vector<Estimate>& estimates) const override {
    estimates.resize(pixels.count);
    const std::vector<float> contrast(static_cast<std::size_t>(table_.greatest_harmonic_count()),
                                      1);
    const estimation::StripeSet stripes{
        .shape = pixels.shape, .shifts_px = pixels.shifts_px, .sources = {}};
    tbb::enumerable_thread_specific<ProfileMatcher> matchers(
        [&] { return ProfileMatcher(stripes, table_.greatest_harmonic_count()); });
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, pixels.count, 64), [&](const auto& range) {
      ProfileMatcher& matcher = matchers.local();
      std::vector<double> samples(pixels.shifts_px.size());
      for (std::size_t pixel = range.begin(); pixel < range.end(); ++pixel)
        estimates[pixel] = fit(pixels, pixel, contrast, samples, matcher);
    });
  }

 private:
  Estimate fit(const PixelSet& pixels, std::size_t pixel, const std::vector<float>& contrast,
               std::vector<double>& samples, ProfileMatcher& matcher) const {
    const double scale = 1 / static_cast<double>(pixels.full_signal[pixel]);
    const float* row = pixels.samples_by_pixel.data() + pixel * samples.size();
    for (std::size_t i = 0; i < samples.size(); ++i) {
      if (!std::isfinite(row[i])) return {};
      samples[i] = static_cast<double>(row[i]) * scale;
    }
    matcher.load(samples, static_cast<double>(pixels.position_px[pixel]), contrast);
    const estimation::LutFit found = fit_with_table(matcher, table_, 0);
    return {.diffuse_reflectance = found.diffuse_reflectance,
            .translucency_px = found.translucency_px,
            .indirect = found.indirect,
            .log_translucency_sd = found.log_translucency_sd,
            .is_valid = (found.validity & estimation::kValidityErrors) == 0};
  }

  ProfileTable table_;
};

// The sum of squares over evenly spaced samples is, by Parseval, one over harmonics; the data's are
// turned by the pixel's phase, and the table's are real. Minimising over all columns of the row is
// then two multiplications a harmonic.
class BruteForceTable : public Method {
 public:
  static constexpr std::size_t kHarmonics = 19;
  static constexpr std::size_t kCols = ProfileTable::kCols, kRows = ProfileTable::kRows;

  BruteForceTable(const estimation::ScatteringModel& model, const PixelSet& pixels)
      : table_(model, pixels.shape, range_of(pixels)),
        shape_(pixels.shape),
        harmonic_count_(std::min(kHarmonics, (pixels.shifts_px.size() - 1) / 2)),
        entries_(kRows * kCols * kHarmonics),
        squares_(kRows * kCols),
        shifts_px_(pixels.shifts_px) {
    for (std::size_t row = 0; row < kRows; ++row)
      for (std::size_t col = 0; col < kCols; ++col) {
        const auto harmonics = table_.harmonics(static_cast<int>(row), static_cast<int>(col));
        for (std::size_t n = 0; n < std::min(harmonic_count_, harmonics.size()); ++n) {
          const auto harmonic = static_cast<float>(harmonics[n]);
          entries_[(row * kHarmonics + n) * kCols + col] = harmonic;
          squares_[row * kCols + col] += harmonic * harmonic;
        }
      }
    for (std::size_t n = 1; n <= harmonic_count_; ++n)
      for (const int shift : shifts_px_) {
        const double angle = 2 * pi * static_cast<double>(n) * shift / shape_.period_px;
        cos_.push_back(static_cast<float>(std::cos(angle)));
        sin_.push_back(static_cast<float>(std::sin(angle)));
      }
  }
  std::string name() const override { return "paper's table, brute force"; }

  void run(const PixelSet& pixels, std::vector<Estimate>& estimates) const override {
    estimates.resize(pixels.count);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, pixels.count, 64), [&](const auto& range) {
      for (std::size_t pixel = range.begin(); pixel < range.end(); ++pixel)
        estimates[pixel] = fit(pixels, pixel);
    });
  }

 private:
  struct Turned {
    float mean = 0;
    float re[kHarmonics] = {};
  };

  // Mean and harmonics of the samples, turned so that the stripe's centre is at zero phase.
  Turned turned(const float* samples, double scale, double position_px) const {
    Turned data;
    const std::size_t count = shifts_px_.size();
    const float share = static_cast<float>(scale) / static_cast<float>(count);
    for (std::size_t i = 0; i < count; ++i) data.mean += samples[i] * share;
    const double phase = 2 * pi * (position_px - 0.5 * (shape_.width_px - 1)) / shape_.period_px;
    for (std::size_t n = 0; n < harmonic_count_; ++n) {
      float re = 0, im = 0;
      for (std::size_t i = 0; i < count; ++i) {
        re += samples[i] * cos_[n * count + i];
        im += samples[i] * sin_[n * count + i];
      }
      const double angle = static_cast<double>(n + 1) * phase;
      data.re[n] = share * (re * static_cast<float>(std::cos(angle)) +
                            im * static_cast<float>(std::sin(angle)));
    }
    return data;
  }

  std::size_t row_of(float reflectance) const {
    const double row = table_.row_of(static_cast<double>(reflectance));
    return static_cast<std::size_t>(std::lround(std::clamp(row, 0.0, kRows - 1.0)));
  }

  std::size_t best_column(const Turned& data, std::size_t row, float mean) const {
    float cost[kCols];
    std::copy_n(squares_.data() + row * kCols, kCols, cost);
    for (std::size_t n = 0; n < harmonic_count_; ++n) {
      const float twice = 2 * data.re[n] / mean;
      const float* entry = entries_.data() + (row * kHarmonics + n) * kCols;
      for (std::size_t col = 0; col < kCols; ++col) cost[col] -= twice * entry[col];
    }
    return static_cast<std::size_t>(std::min_element(cost, cost + kCols) - cost);
  }

  // The mean of the darkest eighth of the curve with these harmonics, relative to its mean: the
  // product's reading of the paper's minimum (estimation/profile/lut_fit.h). The profile falls away
  // from the stripe, so the darkest shifts are those farthest from its centre.
  template <typename Harmonic>
  float trough(const Harmonic& harmonic) const {
    const std::size_t count = std::max<std::size_t>(1, shifts_px_.size() / 8);
    float sum = 0;
    for (std::size_t i = 0; i < count; ++i) {
      // Evenly over the darkest eighth of a period, around half a period away.
      const double x =
          pi + 2 * pi / 8 * ((static_cast<double>(i) + 0.5) / static_cast<double>(count) - 0.5);
      float value = 1;
      for (std::size_t n = 0; n < harmonic_count_; ++n)
        value += 2 * harmonic(n) * static_cast<float>(std::cos(static_cast<double>(n + 1) * x));
      sum += value / static_cast<float>(count);
    }
    return sum;
  }

  Estimate fit(const PixelSet& pixels, std::size_t pixel) const {
    const double scale = 1 / static_cast<double>(pixels.full_signal[pixel]);
    const Turned data = turned(pixels.samples_by_pixel.data() + pixel * shifts_px_.size(), scale,
                               static_cast<double>(pixels.position_px[pixel]));
    if (!(data.mean > 0)) return {};
    const float duty = static_cast<float>(shape_.width_px) / static_cast<float>(shape_.period_px);
    std::size_t row = row_of(data.mean / duty);
    std::size_t col = best_column(data, row, data.mean);
    const float* entry = entries_.data() + row * kHarmonics * kCols + col;
    const float matched = trough([&](std::size_t n) { return entry[n * kCols]; });
    const float seen = trough([&](std::size_t n) { return data.re[n] / data.mean; });
    const float indirect = data.mean * (seen - matched);
    const float direct = data.mean - indirect;
    if (!(direct > 0)) return {};
    row = row_of(direct / duty);
    col = best_column(data, row, direct);
    return {.diffuse_reflectance = static_cast<double>(direct / duty),
            .translucency_px = table_.translucency_px_at(static_cast<double>(col)),
            .indirect = static_cast<double>(indirect / duty),
            .is_valid = col > 0 && col + 1 < kCols};
  }

  ProfileTable table_;
  estimation::StripeShape shape_;
  std::size_t harmonic_count_;
  std::vector<float> entries_;  // [row][harmonic][col]
  std::vector<float> squares_;  // [row][col] sum of squared harmonics
  std::vector<int> shifts_px_;
  std::vector<float> cos_, sin_;  // [harmonic][shift]
};

}  // namespace

std::unique_ptr<Method> parabolic_table(const estimation::ScatteringModel& model,
                                        const PixelSet& for_pixels) {
  return std::make_unique<ParabolicTable>(model, for_pixels);
}

std::unique_ptr<Method> brute_force_table(const estimation::ScatteringModel& model,
                                          const PixelSet& for_pixels) {
  return std::make_unique<BruteForceTable>(model, for_pixels);
}

}  // namespace bench
