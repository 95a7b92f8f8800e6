#include "estimation/models/source_pair.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "estimation/models/source_pair.cpp"
#include <hwy/foreach_target.h>

// After foreach_target.h, which includes this file once a target.
#include <hwy/contrib/math/math-inl.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace estimation {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

template <class D>
hn::Vec<D> pair_at(D d, hn::Vec<D> x, double factor, double s, double farther) {
  const auto one = hn::Set(d, 1.0);
  const auto minus_q = hn::Mul(hn::Set(d, -s), hn::Sqrt(hn::MulAdd(x, x, one)));
  const auto sum = hn::Add(hn::Exp(d, minus_q), hn::Exp(d, hn::Mul(hn::Set(d, farther), minus_q)));
  return hn::Mul(hn::Set(d, 0.5 * factor), sum);
}

void source_pairs(double factor, double s, double farther, std::span<const double> x,
                  std::span<double> out) {
  const hn::ScalableTag<double> d;
  const hn::CappedTag<double, 1> one;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t i = 0;
  for (; i + lanes <= out.size(); i += lanes)
    hn::StoreU(pair_at(d, hn::LoadU(d, &x[i]), factor, s, farther), d, &out[i]);
  for (; i < out.size(); ++i)
    hn::StoreU(pair_at(one, hn::LoadU(one, &x[i]), factor, s, farther), one, &out[i]);
}

}  // namespace HWY_NAMESPACE
}  // namespace estimation
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace estimation {

HWY_EXPORT(source_pairs);

void source_pairs(double factor, double s, double farther, std::span<const double> x,
                  std::span<double> out) {
  HWY_DYNAMIC_DISPATCH(source_pairs)(factor, s, farther, x, out);
}

}  // namespace estimation
#endif
