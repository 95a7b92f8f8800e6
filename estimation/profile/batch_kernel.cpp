// Gauss-Newton on the samples with the weights of the model, as fit_pixel does it, a vector of
// pixels at a time. Each step takes the model's harmonics from the table (a pixel's lie side by
// side there, and are transposed), makes them samples (an eighth of the even waves and a quarter of
// the odd ones do where the sweep is even) and adds those up to the normal equations. Long sweeps
// take a first step on the first harmonics of the data; one more on all samples is enough for
// nearly all pixels, with what changes along it (weights, derivatives) taken off, and what
// curvature does to the estimate.
#include "estimation/profile/batch_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "estimation/profile/batch_kernel.cpp"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

#include "estimation/profile/batch_model-inl.h"
#include "estimation/profile/batch_outcome-inl.h"
#include "estimation/profile/batch_search-inl.h"
#include "estimation/profile/batch_start-inl.h"
#include "estimation/profile/batch_vectors-inl.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {

void fit_all_vectors(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                     BatchFit& fit) {
  const D d;
  const V zero = hn::Zero(d);
  Pixels pixels;
  Bins<1> data;
  Harmonics harmonics;
  for (std::size_t first = 0; first < batch.count; first += kLanes) {
    load_pixels(plan, basis, batch, first, pixels);
    const Start begun = start(plan, basis, batch, first, pixels, data);
    const M exists = hn::FirstN(d, batch.count - first);
    const M active =
        hn::And(hn::And(pixels.is_usual, exists), hn::Not(hn::Or(begun.is_dark, begun.is_flat)));
    const Bins<1>* const steps_from = has_first_step(plan, basis) ? &data : nullptr;
    Outcome out;
    out.state = begun.state;
    out.indirect = out.chi_square = zero;
    for (V& c : out.covariance) c = zero;
    out.is_valid = out.is_hidden = hn::Lt(zero, zero);
    if (basis.is_quartered && !pixels.has_lost)
      search<true, false>(plan, basis, batch, first, pixels, steps_from, begun.state, active,
                          harmonics, out);
    else if (basis.is_quartered)
      search<true, true>(plan, basis, batch, first, pixels, steps_from, begun.state, active,
                         harmonics, out);
    else
      search<false, true>(plan, basis, batch, first, pixels, steps_from, begun.state, active,
                          harmonics, out);
    const M is_left = hn::AndNot(hn::Or(out.is_valid, out.is_hidden), active);
    if (!hn::AllFalse(d, is_left) && basis.is_quartered)
      search_again<true>(plan, basis, batch, first, pixels, begun.state, is_left, harmonics, out);
    else if (!hn::AllFalse(d, is_left))
      search_again<false>(plan, basis, batch, first, pixels, begun.state, is_left, harmonics, out);
    store(plan, pixels, begun, out, first, fit);
  }
}

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace estimation {

HWY_EXPORT(fit_all_vectors);

void fit_vectors(const BatchPlan& plan, const SweepBasis& basis, const PixelBatch& batch,
                 BatchFit& fit) {
  HWY_DYNAMIC_DISPATCH(fit_all_vectors)(plan, basis, batch, fit);
}

}  // namespace estimation
#endif
