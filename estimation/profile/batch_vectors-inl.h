// What all of the vector fit is made of: lanes of pixels, complex numbers, a pixel's noise.
// Included once per instruction set by batch_kernel.cpp.
#if defined(SSRIG_BATCH_VECTORS_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SSRIG_BATCH_VECTORS_INL_H
#undef SSRIG_BATCH_VECTORS_INL_H
#else
#define SSRIG_BATCH_VECTORS_INL_H
#endif

#include <hwy/contrib/math/math-inl.h>
#include <hwy/highway.h>

#include <cstddef>
#include <numbers>

#include "estimation/profile/batch_kernel.h"

HWY_BEFORE_NAMESPACE();
namespace estimation::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::ScalableTag<float>;
using DI = hn::RebindToSigned<D>;
using DU = hn::RebindToUnsigned<D>;
using V = hn::Vec<D>;
using M = hn::Mask<D>;
constexpr std::size_t kLanes = hn::MaxLanes(D());

// As in pixel_model.cpp.
constexpr float kLeastSd = 1e-6F;

struct Complex {
  V re, im;
};

HWY_INLINE Complex times(Complex a, Complex b) {
  return {hn::MulSub(a.re, b.re, hn::Mul(a.im, b.im)), hn::MulAdd(a.re, b.im, hn::Mul(a.im, b.re))};
}

HWY_INLINE Complex times_conjugate(Complex a, Complex b) {
  return {hn::MulAdd(a.re, b.re, hn::Mul(a.im, b.im)), hn::MulSub(a.im, b.re, hn::Mul(a.re, b.im))};
}

// exp(2 pi i turns).
HWY_INLINE Complex unit_at(V turns) {
  const D d;
  const V angle = hn::Mul(hn::Sub(turns, hn::Round(turns)),
                          hn::Set(d, static_cast<float>(2 * std::numbers::pi)));
  return {hn::Cos(d, angle), hn::Sin(d, angle)};
}

// Its inverse, -1/2 to 1/2.
HWY_INLINE V turn_of(Complex unit) {
  const D d;
  const V width = hn::Abs(unit.re), height = hn::Abs(unit.im);
  const V small = hn::Min(width, height),
          large = hn::Max(hn::Max(width, height), hn::Set(d, 1e-20F));
  const V octant = hn::Mul(hn::Atan(d, hn::Div(small, large)),
                           hn::Set(d, static_cast<float>(0.5 / std::numbers::pi)));
  const V quadrant =
      hn::IfThenElse(hn::Gt(height, width), hn::Sub(hn::Set(d, 0.25F), octant), octant);
  const V half =
      hn::IfThenElse(hn::Lt(unit.re, hn::Zero(d)), hn::Sub(hn::Set(d, 0.5F), quadrant), quadrant);
  return hn::CopySignToAbs(half, unit.im);
}

// To 1e-6 or better: of a weight that is plenty.
HWY_INLINE V reciprocal(V value) {
  const V guess = hn::ApproximateReciprocal(value);
  return hn::Mul(guess, hn::NegMulAdd(value, guess, hn::Set(D(), 2.0F)));
}

// f_n of the optics and the model's directions; 0 beyond those that the batch has.
HWY_INLINE Complex factor_of(const PixelBatch& batch, std::size_t n, std::size_t first) {
  const D d;
  if (batch.factor_re.empty()) return {hn::Set(d, 1.0F), hn::Zero(d)};
  if (n >= static_cast<std::size_t>(batch.factor_count)) return {hn::Zero(d), hn::Zero(d)};
  if (batch.has_shared_factors())
    return {hn::Set(d, batch.factor_re[n]), hn::Set(d, batch.factor_im[n])};
  return {hn::LoadU(d, batch.factor_re.data() + n * batch.stride + first),
          hn::LoadU(d, batch.factor_im.data() + n * batch.stride + first)};
}

// The variance of a sample's reflectance factor where the model expects this much of it, as
// variance_at has it.
struct NoiseOfPixel {
  V read[BatchPlan::kMostNoise], shot[BatchPlan::kMostNoise];
  V per_width[BatchPlan::kMostNoise],
      middle[BatchPlan::kMostNoise];  // share = r per_width - middle
  std::size_t count;

  HWY_INLINE void load(const BatchPlan& plan, V full, V per_full) {
    const D d;
    count = plan.noise_count;
    for (std::size_t i = 0; i < count; ++i) {
      read[i] = hn::MulAdd(hn::Set(d, plan.noise[i].read_variance), hn::Mul(per_full, per_full),
                           hn::Set(d, kLeastSd * kLeastSd));
      shot[i] = hn::Mul(hn::Set(d, plan.noise[i].shot_dn_per_us), per_full);
      per_width[i] = hn::Mul(hn::Set(d, plan.noise[i].per_width), full);
      middle[i] = hn::Set(d, plan.noise[i].middle);
    }
  }

  HWY_INLINE V variance(V reflectance) const {
    const D d;
    const V light = hn::Max(reflectance, hn::Zero(d)), one = hn::Set(d, 1.0F);
    V variance = hn::MulAdd(shot[count - 1], light, read[count - 1]);
    for (std::size_t i = count - 1; i-- > 0;) {
      const V share = hn::MulSub(reflectance, per_width[i], middle[i]);
      const V own = hn::MulAdd(shot[i], light, read[i]);
      variance = hn::MulAdd(hn::Min(hn::Max(share, hn::Zero(d)), one), hn::Sub(variance, own), own);
    }
    return variance;
  }
};

// The same of two exposures, in few enough numbers for the registers.
struct NoiseOfTwo {
  V read, shot, next_read, next_shot, per_width, middle;

  HWY_INLINE explicit NoiseOfTwo(const NoiseOfPixel& noise)
      : read(noise.read[0]),
        shot(noise.shot[0]),
        next_read(noise.read[1]),
        next_shot(noise.shot[1]),
        per_width(noise.per_width[0]),
        middle(noise.middle[0]) {}

  HWY_INLINE V variance(V reflectance) const {
    const D d;
    const V zero = hn::Zero(d), light = hn::Max(reflectance, zero);
    const V share = hn::MulSub(reflectance, per_width, middle);
    const V own = hn::MulAdd(shot, light, read), next = hn::MulAdd(next_shot, light, next_read);
    return hn::MulAdd(hn::Min(hn::Max(share, zero), hn::Set(d, 1.0F)), hn::Sub(next, own), own);
  }
};

}  // namespace estimation::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
