#include "estimation/profile/likelihood.h"

namespace estimation {

void BatchFit::resize(std::size_t stride_wanted) {
  stride = stride_wanted;
  for (std::vector<float>* row :
       {&logit_reflectance, &log_translucency_px, &indirect, &phase_px, &reduced_chi_square})
    row->resize(stride);
  covariance.resize(stride * kUnknowns * (kUnknowns + 1) / 2);
  validity.resize(stride);
}

void fit_batch(const FitProblem& problem, const PixelBatch& batch, BatchFit& fit) {
  if (fit.stride < batch.count) fit.resize(batch.stride);
  for (std::size_t i = 0; i < batch.count; ++i) {
    const PixelFit pixel = fit_pixel(problem, batch, i);
    fit.logit_reflectance[i] = static_cast<float>(pixel.logit_reflectance);
    fit.log_translucency_px[i] = static_cast<float>(pixel.log_translucency_px);
    fit.indirect[i] = static_cast<float>(pixel.indirect);
    fit.phase_px[i] = static_cast<float>(pixel.phase_px);
    for (std::size_t k = 0; k < pixel.covariance.size(); ++k)
      fit.covariance[k * fit.stride + i] = static_cast<float>(pixel.covariance[k]);
    fit.reduced_chi_square[i] =
        pixel.degrees_of_freedom > 0
            ? static_cast<float>(pixel.chi_square / pixel.degrees_of_freedom)
            : 1.0F;
    fit.validity[i] = pixel.validity;
  }
}

}  // namespace estimation
