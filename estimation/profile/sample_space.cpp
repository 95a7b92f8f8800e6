#include "estimation/profile/sample_space.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace estimation {
namespace {

// A wave of which less than this share is new is a sum of those before it.
constexpr double kLeastNewShare = 1e-6;
// Of variances: a wider range would cost the covariance its sign.
constexpr double kLeastVarianceShare = 1e-10;

double product(std::span<const double> a, std::span<const double> b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
}

}  // namespace

void SampleSpace::keep_all(std::size_t sample_count) {
  is_all_ = true;
  size_ = sample_count;
}

void SampleSpace::keep_mean(std::size_t sample_count) {
  is_all_ = false;
  size_ = 1;
  basis_.assign(sample_count, 1 / std::sqrt(static_cast<double>(sample_count)));
}

// Gram and Schmidt, twice: once leaves rounding times what was taken off.
void SampleSpace::keep_also(std::span<const double> wave) {
  const std::size_t samples = wave.size();
  wave_.assign(wave.begin(), wave.end());
  for (int pass = 0; pass < 2; ++pass)
    for (std::size_t row = 0; row < size_; ++row) {
      const auto known = std::span<const double>(basis_).subspan(row * samples, samples);
      const double share = product(wave_, known);
      for (std::size_t i = 0; i < samples; ++i) wave_[i] -= share * known[i];
    }
  const double left = std::sqrt(product(wave_, wave_));
  if (!(left > kLeastNewShare * std::sqrt(static_cast<double>(samples)))) return;
  for (const double value : wave_) basis_.push_back(value / left);
  ++size_;
}

void SampleSpace::set_variances(std::span<const double> variances) {
  const std::size_t samples = variances.size();
  if (is_all_) {
    per_sd_.resize(samples);
    for (std::size_t i = 0; i < samples; ++i) per_sd_[i] = 1 / std::sqrt(variances[i]);
    return;
  }
  const double least = kLeastVarianceShare * *std::max_element(variances.begin(), variances.end());
  variances_.assign(variances.begin(), variances.end());
  for (double& variance : variances_) variance = std::max(variance, least);
  lower_.assign(size_ * size_, 0);
  for (std::size_t i = 0; i < size_; ++i)
    for (std::size_t j = 0; j <= i; ++j) {
      double sum = 0;
      for (std::size_t k = 0; k < samples; ++k)
        sum += basis_[i * samples + k] * variances_[k] * basis_[j * samples + k];
      for (std::size_t k = 0; k < j; ++k) sum -= lower_[i * size_ + k] * lower_[j * size_ + k];
      lower_[i * size_ + j] = i == j ? std::sqrt(sum) : sum / lower_[j * size_ + j];
    }
}

void SampleSpace::whiten(std::span<const double> samples, std::vector<double>& out) const {
  out.resize(size_);
  if (is_all_) {
    for (std::size_t i = 0; i < size_; ++i) out[i] = per_sd_[i] * samples[i];
    return;
  }
  for (std::size_t i = 0; i < size_; ++i) {
    double sum = product(
        samples, std::span<const double>(basis_).subspan(i * samples.size(), samples.size()));
    for (std::size_t k = 0; k < i; ++k) sum -= lower_[i * size_ + k] * out[k];
    out[i] = sum / lower_[i * size_ + i];
  }
}

}  // namespace estimation
