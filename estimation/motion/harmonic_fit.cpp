#include "estimation/motion/harmonic_fit.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace estimation {
namespace {

using Complex = std::complex<double>;

}  // namespace

HarmonicFit::HarmonicFit(const std::vector<double>& phases_rad, std::optional<std::size_t> without)
    : frame_count_(static_cast<int>(phases_rad.size())),
      term_count_(2 * kShiftHarmonics + 1),
      design_(frame_count_, term_count_) {
  for (int n = 0; n < frame_count_; ++n) {
    design_(n, 0) = 1;
    for (int k = 1; 2 * k < term_count_; ++k) {
      design_(n, 2 * k - 1) = std::cos(k * phases_rad[static_cast<std::size_t>(n)]);
      design_(n, 2 * k) = std::sin(k * phases_rad[static_cast<std::size_t>(n)]);
    }
  }
  cv::Mat1d used = design_.clone();
  if (without) used.row(static_cast<int>(*without)) = 0.0;
  is_solved_ = cv::invert(used, inverse_, cv::DECOMP_SVD) > kLeastCondition;
}

double HarmonicFit::leverage(int frame) const {
  double sum = 0;
  for (int t = 0; t < term_count_; ++t) sum += design_(frame, t) * inverse_(t, frame);
  return sum;
}

std::vector<std::vector<float>> HarmonicFit::coefficients(
    const std::vector<std::vector<float>>& light_dn) const {
  std::vector<std::vector<float>> found(static_cast<std::size_t>(term_count_),
                                        std::vector<float>(light_dn.front().size()));
  for (int t = 0; t < term_count_; ++t) {
    std::vector<float>& row = found[static_cast<std::size_t>(t)];
    for (int n = 0; n < frame_count_; ++n) {
      const auto weight = static_cast<float>(inverse_(t, n));
      const std::vector<float>& light = light_dn[static_cast<std::size_t>(n)];
      for (std::size_t i = 0; i < row.size(); ++i) row[i] += weight * light[i];
    }
  }
  return found;
}

double coherence(const std::vector<std::vector<float>>& coefficients) {
  Complex product = 0;
  double harmonic_square = 0, mean_square = 0;
  for (std::size_t i = 0; i < coefficients[0].size(); ++i) {
    const auto mean = static_cast<double>(coefficients[0][i]);
    const Complex harmonic(static_cast<double>(coefficients[1][i]),
                           static_cast<double>(coefficients[2][i]));
    product += mean * harmonic;
    harmonic_square += std::norm(harmonic);
    mean_square += mean * mean;
  }
  return std::norm(product) / (harmonic_square * mean_square);
}

double signal_of(const HarmonicFit& fit, const std::vector<std::vector<float>>& coefficients,
                 const std::vector<std::vector<float>>& light_dn) {
  constexpr std::size_t kStride = 8;  // places enough
  double signal = 0, left = 0;
  for (std::size_t i = 0; i < coefficients[0].size(); i += kStride) {
    signal += std::norm(
        Complex(static_cast<double>(coefficients[1][i]), static_cast<double>(coefficients[2][i])));
    for (std::size_t n = 0; n < light_dn.size(); ++n) {
      double surplus = static_cast<double>(light_dn[n][i]);
      for (int t = 0; t < fit.term_count(); ++t)
        surplus -= fit.term(static_cast<int>(n), t) *
                   static_cast<double>(coefficients[static_cast<std::size_t>(t)][i]);
      left += surplus * surplus;
    }
  }
  const auto count = static_cast<double>(light_dn.size());
  const double variance = left / (count - fit.term_count());
  return signal * count / (4 * std::max(variance, 1e-9));
}

Complex phasor_of(const HarmonicFit& fit, const std::vector<std::vector<float>>& coefficients,
                  const std::vector<float>& light_dn, int frame) {
  std::array<float, 7> terms{};
  for (int t = 0; t < fit.term_count(); ++t)
    terms[static_cast<std::size_t>(t)] = static_cast<float>(fit.term(frame, t));
  const float cosine = terms[1], sine = terms[2];
  const float *mean = coefficients[0].data(), *in_cosine = coefficients[1].data(),
              *in_sine = coefficients[2].data();
  cv::Matx33d matrix;
  cv::Vec3d vector;
  constexpr std::size_t kRun = 512;  // floats add up in runs that keep their precision
  std::array<float, kRun> surplus{};
  for (std::size_t begin = 0; begin < light_dn.size(); begin += kRun) {
    const std::size_t count = std::min(kRun, light_dn.size() - begin);
    for (std::size_t i = 0; i < count; ++i) surplus[i] = light_dn[begin + i];
    for (int t = 0; t < fit.term_count(); ++t) {
      const float term = terms[static_cast<std::size_t>(t)];
      const float* coefficient = coefficients[static_cast<std::size_t>(t)].data() + begin;
      for (std::size_t i = 0; i < count; ++i) surplus[i] -= term * coefficient[i];
    }
    std::array<float, 9> sums{};
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t at = begin + i;
      const float in_phase = cosine * in_cosine[at] + sine * in_sine[at];
      const float ahead = cosine * in_sine[at] - sine * in_cosine[at];
      sums[0] += in_phase * in_phase;
      sums[1] += in_phase * ahead;
      sums[2] += in_phase * mean[at];
      sums[3] += ahead * ahead;
      sums[4] += ahead * mean[at];
      sums[5] += mean[at] * mean[at];
      sums[6] += in_phase * surplus[i];
      sums[7] += ahead * surplus[i];
      sums[8] += mean[at] * surplus[i];
    }
    const auto sum = [&sums](std::size_t i) { return static_cast<double>(sums[i]); };
    matrix += cv::Matx33d(sum(0), sum(1), sum(2), sum(1), sum(3), sum(4), sum(2), sum(4), sum(5));
    vector += cv::Vec3d(sum(6), sum(7), sum(8));
  }
  cv::Vec3d found;
  if (!cv::solve(matrix, vector, found, cv::DECOMP_CHOLESKY)) return {0, 0};
  const double own = std::max(1 - fit.leverage(frame), 0.05);
  return Complex(1, 0) + Complex(found[0], found[1]) / own;
}

}  // namespace estimation
