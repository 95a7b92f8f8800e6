#include "estimation/profile/harmonic_table.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>

#include "estimation/base/check.h"

namespace estimation {
namespace {

// Largest error of the second-order expansion, as a share of the mean's harmonic d R_d: a
// thousandth of the noise of a pixel's harmonics, which is some 1e-3 of the mean.
constexpr double kWorstError = 3e-7;
// Differences are taken over these steps of t and lambda: over 0.01 the fourth-order formulas err
// by 1e-10 and rounding by 1e-12; third derivatives need a wider one.
constexpr double kDifferenceStep = 0.01;
constexpr double kProbeStep = 0.05;
// A model made of pieces has large third derivatives at its joints, which say nothing.
constexpr double kLeastStep = 0.008, kGreatestStep = 0.25;
constexpr int kMaskIntervals = 64;
// Below it a float loses digits and processors lose time.
constexpr double kNothing = 1e-30;
constexpr double kMargin = 2 * kProbeStep;

// a_n for a list of lambda at one t.
class Row {
 public:
  Row(const ScatteringModel& model, StripeShape shape, int harmonic_count)
      : model_(model), wave_per_px_(2 * std::numbers::pi / shape.period_px) {
    const double duty = static_cast<double>(shape.width_px) / shape.period_px;
    for (int n = 1; n <= harmonic_count; ++n)
      envelope_.push_back(std::sin(std::numbers::pi * n * duty) / (std::numbers::pi * n));
  }

  // [lambda][harmonic]; valid until the next call.
  std::span<const double> at(double logit, std::span<const double> lambdas) {
    const std::size_t count = envelope_.size();
    k_times_l_d_.resize(lambdas.size() * count);
    values_.resize(k_times_l_d_.size());
    for (std::size_t i = 0; i < lambdas.size(); ++i) {
      const double first = wave_per_px_ * std::exp(lambdas[i]);
      for (std::size_t n = 0; n < count; ++n)
        k_times_l_d_[i * count + n] = first * static_cast<double>(n + 1);
    }
    model_.transform(1 / (1 + std::exp(-logit)), k_times_l_d_, values_);
    for (std::size_t i = 0; i < values_.size(); ++i) values_[i] *= envelope_[i % count];
    return values_;
  }

 private:
  const ScatteringModel& model_;
  double wave_per_px_;
  std::vector<double> envelope_, k_times_l_d_, values_;
};

std::vector<double> spaced(double least, double greatest, int count) {
  std::vector<double> values(static_cast<std::size_t>(count), least);
  for (int i = 1; i < count; ++i)
    values[static_cast<std::size_t>(i)] = least + (greatest - least) * i / (count - 1);
  return values;
}

bool all_finite(std::span<const double> values) {
  return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
}

// Which points of a grid have finite harmonics all around them.
class FiniteMask {
 public:
  FiniteMask(Row& row, const ShapeRange& range, std::size_t harmonic_count)
      : logits_(spaced(range.least.logit_reflectance, range.greatest.logit_reflectance,
                       kMaskIntervals + 1)),
        lambdas_(spaced(range.least.log_translucency_px, range.greatest.log_translucency_px,
                        kMaskIntervals + 1)) {
    std::vector<double> around;
    for (const double lambda : lambdas_)
      for (const double offset : {-kMargin, kMargin}) around.push_back(lambda + offset);
    finite_.assign(logits_.size() * lambdas_.size(), 1);
    for (std::size_t i = 0; i < logits_.size(); ++i)
      for (const double offset : {-kMargin, kMargin}) {
        const std::span<const double> values = row.at(logits_[i] + offset, around);
        for (std::size_t j = 0; j < lambdas_.size(); ++j)
          if (!all_finite(values.subspan(2 * j * harmonic_count, 2 * harmonic_count)))
            finite_[i * lambdas_.size() + j] = 0;
      }
  }

  // Takes away the side with the largest share of points that are not finite until none is left.
  std::optional<ShapeRange> finite_range() const {
    std::size_t top = 0, bottom = logits_.size(), left = 0, right = lambdas_.size();
    while (top + 1 < bottom && left + 1 < right) {
      const std::array<double, 4> missing = {
          missing_share(top, top + 1, left, right), missing_share(bottom - 1, bottom, left, right),
          missing_share(top, bottom, left, left + 1), missing_share(top, bottom, right - 1, right)};
      if (missing_share(top, bottom, left, right) == 0)
        return ShapeRange{{logits_[top], lambdas_[left]},
                          {logits_[bottom - 1], lambdas_[right - 1]}};
      const auto worst = std::max_element(missing.begin(), missing.end()) - missing.begin();
      if (worst == 0) ++top;
      if (worst == 1) --bottom;
      if (worst == 2) ++left;
      if (worst == 3) --right;
    }
    return std::nullopt;
  }

 private:
  double missing_share(std::size_t top, std::size_t bottom, std::size_t left,
                       std::size_t right) const {
    double missing = 0;
    for (std::size_t i = top; i < bottom; ++i)
      for (std::size_t j = left; j < right; ++j) missing += 1 - finite_[i * lambdas_.size() + j];
    return missing / static_cast<double>((bottom - top) * (right - left));
  }

  std::vector<double> logits_, lambdas_;
  std::vector<int> finite_;  // [logit][lambda]
};

// Third derivatives at one point, as shares of the mean's harmonic.
struct ThirdDerivatives {
  double ttt = 0, ttl = 0, tll = 0, lll = 0;

  // What the terms below leave of them in the corner of a cell with these half steps.
  double remainder(double half_t, double half_l) const {
    return half_t * half_t * half_t * std::abs(ttt) / 24 +
           half_t * half_t * half_l * std::abs(ttl) / 4 +
           half_t * half_l * half_l * std::abs(tll) / 4 +
           half_l * half_l * half_l * std::abs(lll) / 24;
  }
};

// A function's differences of third order around a point, f(t steps, lambda steps).
template <typename Function>
ThirdDerivatives third_derivatives(const Function& f, double step) {
  const double scale = 1 / (2 * step * step * step);
  return {.ttt = scale * (f(2, 0) - 2 * f(1, 0) + 2 * f(-1, 0) - f(-2, 0)),
          .ttl = scale * (f(1, 1) - f(1, -1) - 2 * (f(0, 1) - f(0, -1)) + f(-1, 1) - f(-1, -1)),
          .tll = scale * (f(1, 1) - f(-1, 1) - 2 * (f(1, 0) - f(-1, 0)) + f(1, -1) - f(-1, -1)),
          .lll = scale * (f(0, 2) - 2 * f(0, 1) + 2 * f(0, -1) - f(0, -2))};
}

// a_n around some points of one t: f(t steps, lambda steps) of point and harmonic.
class Neighbourhood {
 public:
  Neighbourhood(Row& row, double logit, std::span<const double> lambdas, double step,
                std::size_t harmonic_count)
      : harmonic_count_(harmonic_count) {
    std::vector<double> around;  // [lambda][offset]
    for (const double lambda : lambdas)
      for (int offset = -2; offset <= 2; ++offset) around.push_back(lambda + offset * step);
    for (int offset = -2; offset <= 2; ++offset) {
      const auto at = row.at(logit + offset * step, around);
      values_[static_cast<std::size_t>(offset + 2)].assign(at.begin(), at.end());
    }
  }
  double at(std::size_t point, std::size_t harmonic, int t_steps, int log_steps) const {
    return values_[static_cast<std::size_t>(t_steps + 2)]
                  [(5 * point + static_cast<std::size_t>(log_steps + 2)) * harmonic_count_ +
                   harmonic];
  }

 private:
  std::size_t harmonic_count_;
  std::array<std::vector<double>, 5> values_;  // [t step][lambda][lambda step][harmonic]
};

struct Steps {
  double logit = 0, log = 0;
};

// The coarsest steps whose cells keep to kWorstError: for each shape of a cell the remainder grows
// with the cube of its size.
Steps choose_steps(Row& row, const ShapeRange& range, double duty, std::size_t harmonic_count) {
  const auto probes = [](double least, double greatest, double apart) {
    return spaced(least, greatest, std::max(3, 1 + static_cast<int>((greatest - least) / apart)));
  };
  const std::vector<double> lambdas =
      probes(range.least.log_translucency_px, range.greatest.log_translucency_px, 0.15);
  std::vector<double> shapes;  // step of t over the geometric mean of both
  for (double shape = 0.3; shape <= 3.4; shape *= 1.15) shapes.push_back(shape);
  std::vector<double> worst(shapes.size(), 0);
  for (const double logit :
       probes(range.least.logit_reflectance, range.greatest.logit_reflectance, 0.25)) {
    const Neighbourhood around(row, logit, lambdas, kProbeStep, harmonic_count);
    const double scale = (1 + std::exp(-logit)) / duty;
    for (std::size_t point = 0; point < lambdas.size(); ++point)
      for (std::size_t n = 0; n < harmonic_count; ++n) {
        const ThirdDerivatives derivatives = third_derivatives(
            [&](int t, int l) { return scale * around.at(point, n, t, l); }, kProbeStep);
        for (std::size_t i = 0; i < shapes.size(); ++i)
          worst[i] = std::max(worst[i], derivatives.remainder(shapes[i], 1 / shapes[i]));
      }
  }
  const auto best = std::min_element(worst.begin(), worst.end());
  const double shape = shapes[static_cast<std::size_t>(best - worst.begin())];
  const double half = std::cbrt(kWorstError / *best);
  return {.logit = std::clamp(2 * half * shape, kLeastStep, kGreatestStep),
          .log = std::clamp(2 * half / shape, kLeastStep, kGreatestStep)};
}

int node_count(double least, double greatest, double step) {
  return 1 + std::max(1, static_cast<int>(std::ceil((greatest - least) / step)));
}

// The terms of one row of nodes, [col][term][harmonic_stride]. What the third derivatives add is
// shared out over the cell: over |x| <= a, x^3 is nearest to 3/4 a^2 x and x^2 to a^2 / 2, which
// leaves a quarter and a half of it.
void fill_row(Row& row, double logit, std::span<const double> lambdas, const Steps& steps,
              std::size_t harmonic_count, std::size_t harmonic_stride, std::span<float> terms) {
  constexpr double h = kDifferenceStep;
  const double tt = steps.logit * steps.logit / 4, ll = steps.log * steps.log / 4;
  const Neighbourhood around(row, logit, lambdas, h, harmonic_count);
  for (std::size_t col = 0; col < lambdas.size(); ++col)
    for (std::size_t n = 0; n < harmonic_count; ++n) {
      const auto f = [&](int t, int l) { return around.at(col, n, t, l); };
      const auto first = [&](double m2, double m1, double p1, double p2) {
        return (m2 - 8 * m1 + 8 * p1 - p2) / (12 * h);
      };
      const auto half_second = [&](double m2, double m1, double at, double p1, double p2) {
        return (-m2 + 16 * m1 - 30 * at + 16 * p1 - p2) / (24 * h * h);
      };
      const ThirdDerivatives third = third_derivatives(f, h);
      const std::array<double, HarmonicTable::kTerms> term = {
          f(0, 0),
          first(f(-2, 0), f(-1, 0), f(1, 0), f(2, 0)) + third.ttt * tt / 8 + third.tll * ll / 4,
          first(f(0, -2), f(0, -1), f(0, 1), f(0, 2)) + third.lll * ll / 8 + third.ttl * tt / 4,
          half_second(f(-2, 0), f(-1, 0), f(0, 0), f(1, 0), f(2, 0)),
          (f(1, 1) - f(1, -1) - f(-1, 1) + f(-1, -1)) / (4 * h * h),
          half_second(f(0, -2), f(0, -1), f(0, 0), f(0, 1), f(0, 2))};
      for (std::size_t i = 0; i < term.size(); ++i)
        terms[(col * HarmonicTable::kTerms + i) * harmonic_stride + n] =
            std::abs(term[i]) > kNothing ? static_cast<float>(term[i]) : 0.0F;
    }
}

}  // namespace

HarmonicTable::HarmonicTable(const ScatteringModel& model, StripeShape shape,
                             const ShapeRange& range, int harmonic_count)
    : shape_(shape), harmonic_count_(harmonic_count) {
  check(harmonic_count > 0, "a table of harmonics holds at least one");
  check(range.least.logit_reflectance < range.greatest.logit_reflectance &&
            range.least.log_translucency_px < range.greatest.log_translucency_px,
        "a table's range is not empty");
  const auto count = static_cast<std::size_t>(harmonic_count);
  harmonic_stride_ = (count + 7) / 8 * 8;
  Row probe(model, shape, harmonic_count);
  const std::optional<ShapeRange> finite = FiniteMask(probe, range, count).finite_range();
  if (!finite) return;
  range_ = *finite;
  const double duty = static_cast<double>(shape.width_px) / shape.period_px;
  const Steps steps = choose_steps(probe, range_, duty, count);
  const auto& [least, greatest] = range_;
  rows_ = node_count(least.logit_reflectance, greatest.logit_reflectance, steps.logit);
  cols_ = node_count(least.log_translucency_px, greatest.log_translucency_px, steps.log);
  logit_step_ = (greatest.logit_reflectance - least.logit_reflectance) / (rows_ - 1);
  log_step_ = (greatest.log_translucency_px - least.log_translucency_px) / (cols_ - 1);
  const std::vector<double> lambdas =
      spaced(least.log_translucency_px, greatest.log_translucency_px, cols_);
  const std::size_t row_size = lambdas.size() * kTerms * harmonic_stride_;
  terms_.assign(static_cast<std::size_t>(rows_) * row_size, 0.0F);
  tbb::parallel_for(0, rows_, [&](int row) {
    Row values(model, shape_, harmonic_count_);
    fill_row(values, range_.least.logit_reflectance + row * logit_step_, lambdas,
             {.logit = logit_step_, .log = log_step_}, count, harmonic_stride_,
             std::span(terms_).subspan(static_cast<std::size_t>(row) * row_size, row_size));
  });
}

std::span<const float> HarmonicTable::node(int row, int col) const {
  const std::size_t size = kTerms * harmonic_stride_;
  const std::size_t index = static_cast<std::size_t>(row) * static_cast<std::size_t>(cols_) +
                            static_cast<std::size_t>(col);
  return std::span(terms_).subspan(index * size, size);
}

bool HarmonicTable::holds(ShapePoint point) const {
  return rows_ > 0 && point.logit_reflectance >= range_.least.logit_reflectance &&
         point.logit_reflectance <= range_.greatest.logit_reflectance &&
         point.log_translucency_px >= range_.least.log_translucency_px &&
         point.log_translucency_px <= range_.greatest.log_translucency_px;
}

}  // namespace estimation
