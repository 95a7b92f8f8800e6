// Where a pixel's samples and its model are compared: in the samples themselves, or in the mean and
// the first harmonics that least squares without weights find in them.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace estimation {

// The space of a linear map Q^T of the samples, Q orthonormal, whitened by the samples' variances.
// Data and model go through the same map, so that what the samples hold besides biases nothing,
// whatever the shifts. Keeps its buffers from pixel to pixel. Not thread-safe.
class SampleSpace {
 public:
  // All samples as they are.
  void keep_all(std::size_t sample_count);

  // Their mean only, then also the share of these waves. [sample]
  void keep_mean(std::size_t sample_count);
  void keep_also(std::span<const double> wave);

  // Numbers compared.
  std::size_t size() const { return size_; }

  // Of the samples, all positive.
  void set_variances(std::span<const double> variances);

  // [sample] to [size()] of unit covariance.
  void whiten(std::span<const double> samples, std::vector<double>& out) const;

 private:
  bool is_all_ = true;
  std::size_t size_ = 0;
  std::vector<double> per_sd_;  // [sample], of all samples
  std::vector<double> basis_;   // [size][sample] rows of Q^T
  std::vector<double> wave_;
  std::vector<double> variances_;
  std::vector<double> lower_;  // [size][size] root of Q^T diag(variance) Q
};

}  // namespace estimation
