#include "tests/bench/two_frequency.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <cmath>
#include <numbers>

#include "tests/bench/methods.h"

namespace bench {
namespace {

using std::numbers::pi;

constexpr double kLeastReflectance = 0.002, kGreatestReflectance = 0.998;
constexpr double kLeastContrast = 0.002, kGreatestContrast = 0.998;

// The model's contrast falls as l_d grows: bisection over ln l_d.
double log_translucency_of(const estimation::ScatteringModel& model, double reflectance,
                           double contrast, double k_per_px) {
  double low = std::log(1e-3), high = std::log(1e4);
  for (int step = 0; step < 50; ++step) {
    const double middle = 0.5 * (low + high);
    const double k_times_l_d[2] = {0, k_per_px * std::exp(middle)};
    double transform[2];
    model.transform(reflectance, k_times_l_d, transform);
    (transform[1] > contrast * transform[0] ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

class TwoFrequencyMethod : public Method {
 public:
  TwoFrequencyMethod(const estimation::ScatteringModel& model, const PixelSet& pixels)
      : table_(model, pixels.shape) {
    for (const int shift : pixels.shifts_px) {
      const double angle = 2 * pi * shift / pixels.shape.period_px;
      const auto count = static_cast<double>(pixels.shifts_px.size());
      cos_.push_back(static_cast<float>(std::cos(angle) / count));
      sin_.push_back(static_cast<float>(std::sin(angle) / count));
    }
  }
  std::string name() const override { return "SFDI, two frequencies"; }

  void run(const PixelSet& pixels, std::vector<Estimate>& estimates) const override {
    estimates.resize(pixels.count);
    const std::size_t shift_count = cos_.size();
    const float share = 1 / static_cast<float>(shift_count);
    tbb::parallel_for(
        tbb::blocked_range<std::size_t>(0, pixels.count, 1024), [&](const auto& range) {
          constexpr std::size_t kBlock = 64;
          for (std::size_t first = range.begin(); first < range.end(); first += kBlock) {
            const std::size_t count = std::min(kBlock, range.end() - first);
            float mean[kBlock] = {}, re[kBlock] = {}, im[kBlock] = {};
            for (std::size_t i = 0; i < shift_count; ++i) {
              const float* row = pixels.samples.data() + i * pixels.stride + first;
              for (std::size_t p = 0; p < count; ++p) {
                mean[p] += row[p] * share;
                re[p] += row[p] * cos_[i];
                im[p] += row[p] * sin_[i];
              }
            }
            for (std::size_t p = 0; p < count; ++p) {
              const float scale = 1 / pixels.full_signal[first + p];
              const auto found = table_.find(
                  static_cast<double>(mean[p] * scale),
                  static_cast<double>(std::sqrt(re[p] * re[p] + im[p] * im[p]) * scale));
              estimates[first + p] = {.diffuse_reflectance = found.diffuse_reflectance,
                                      .translucency_px = std::exp(found.log_translucency_px),
                                      .is_valid = found.is_inside};
            }
          }
        });
  }

 private:
  TwoFrequencyTable table_;
  std::vector<float> cos_, sin_;
};

}  // namespace

TwoFrequencyTable::TwoFrequencyTable(const estimation::ScatteringModel& model,
                                     estimation::StripeShape shape)
    : duty_(static_cast<double>(shape.width_px) / shape.period_px),
      stripe_(std::sin(pi * duty_) / pi),
      log_translucency_px_(static_cast<std::size_t>(kSize) * kSize) {
  tbb::parallel_for(0, kSize, [&](int row) {
    const double reflectance =
        std::lerp(kLeastReflectance, kGreatestReflectance, row / (kSize - 1.0));
    for (int col = 0; col < kSize; ++col)
      log_translucency_px_[static_cast<std::size_t>(row * kSize + col)] =
          static_cast<float>(log_translucency_of(
              model, reflectance, std::lerp(kLeastContrast, kGreatestContrast, col / (kSize - 1.0)),
              2 * pi / shape.period_px));
  });
}

TwoFrequencyTable::Found TwoFrequencyTable::find(double mean, double amplitude) const {
  const double reflectance = mean / duty_;
  const double contrast = amplitude / stripe_ / reflectance;
  const double row =
      (reflectance - kLeastReflectance) / (kGreatestReflectance - kLeastReflectance) * (kSize - 1);
  const double col =
      (contrast - kLeastContrast) / (kGreatestContrast - kLeastContrast) * (kSize - 1);
  if (!(row >= 0 && row < kSize - 1 && col >= 0 && col < kSize - 1))
    return {.diffuse_reflectance = reflectance};
  const auto r = static_cast<std::size_t>(row), c = static_cast<std::size_t>(col);
  const double down = row - static_cast<double>(r), right = col - static_cast<double>(c);
  const float* corner = log_translucency_px_.data() + r * kSize + c;
  const double above =
      std::lerp(static_cast<double>(corner[0]), static_cast<double>(corner[1]), right);
  const double below =
      std::lerp(static_cast<double>(corner[kSize]), static_cast<double>(corner[kSize + 1]), right);
  return {.diffuse_reflectance = reflectance,
          .log_translucency_px = std::lerp(above, below, down),
          .is_inside = true};
}

std::unique_ptr<Method> two_frequency_table(const estimation::ScatteringModel& model,
                                            const PixelSet& for_pixels) {
  return std::make_unique<TwoFrequencyMethod>(model, for_pixels);
}

}  // namespace bench
