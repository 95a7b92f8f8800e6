#include "estimation/profile/shape_harmonics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace estimation {
namespace {

// The model's harmonics end where they no longer matter: looked for after so many, twice as many,
// and so on. As many as the last point had come in one block, others in blocks as long as those
// before together: R_d is inverted once a block, which costs as much as a hundred harmonics.
constexpr std::size_t kFirstBlock = 32;
// Of the model's central differences; errs by 1e-8 of the derivative.
constexpr double kDifferenceStep = 1e-4;
// Of its second differences; errs by 1e-4 of them, which only correct a bias.
constexpr double kCurvatureStep = 0.02;
// Where a table's last harmonics are this many tolerances high, those that it lacks matter.
constexpr double kTruncation = 15;

double reflectance_at(double logit) { return 1 / (1 + std::exp(-logit)); }

}  // namespace

bool ShapeHarmonics::evaluate(const FitProblem& problem, int most, ShapePoint shape,
                              double tolerance, Extent extent) {
  is_cut_off_ = false;
  is_of_table_ = from_table(problem, most, shape, tolerance, extent);
  return is_of_table_ || from_model(problem, most, shape, tolerance);
}

bool ShapeHarmonics::evaluate_curvature(const FitProblem& problem, ShapePoint shape) {
  if (!is_of_table_) return curvature_of_model(problem, shape);
  curvature_between_nodes(*problem.table, shape);
  return true;
}

bool ShapeHarmonics::from_table(const FitProblem& problem, int most, ShapePoint shape,
                                double tolerance, Extent extent) {
  const HarmonicTable* table = problem.table;
  if (table == nullptr || !table->holds(shape)) return false;
  const ShapePoint& least = table->range().least;
  const double row =
      std::round((shape.logit_reflectance - least.logit_reflectance) / table->logit_step());
  const double col =
      std::round((shape.log_translucency_px - least.log_translucency_px) / table->log_step());
  const double dt = shape.logit_reflectance - least.logit_reflectance - row * table->logit_step();
  const double dl = shape.log_translucency_px - least.log_translucency_px - col * table->log_step();
  const std::span<const float> node = table->node(static_cast<int>(row), static_cast<int>(col));
  const auto term = [&](std::size_t i, std::size_t n) {
    return static_cast<double>(node[i * table->harmonic_stride() + n]);
  };
  const auto size = [&](std::size_t n) {
    return std::max({std::abs(term(0, n)), std::abs(term(1, n)), std::abs(term(2, n))});
  };
  const int held = std::min(table->harmonic_count(), most);
  auto count = static_cast<std::size_t>(held);
  is_cut_off_ = held > 1 && most > held &&
                std::max(size(count - 1), size(count - 2)) > kTruncation * tolerance;
  if (is_cut_off_ && extent == Extent::kAll) return false;
  while (count > 1 && size(count - 1) < tolerance) --count;
  value_.resize(count);
  by_logit_.resize(count);
  by_log_.resize(count);
  const std::size_t stride = table->harmonic_stride();
  const float* __restrict terms = node.data();
  double* __restrict value = value_.data();
  double* __restrict by_logit = by_logit_.data();
  double* __restrict by_log = by_log_.data();
  for (std::size_t n = 0; n < count; ++n) {
    const auto at = [&](std::size_t i) { return static_cast<double>(terms[i * stride + n]); };
    const double a = at(0), t = at(1), l = at(2), tt = dt * at(3), tl = at(4), ll = dl * at(5);
    value[n] = a + dt * (t + tt + dl * tl) + dl * (l + ll);
    by_logit[n] = t + 2 * tt + dl * tl;
    by_log[n] = l + 2 * ll + dt * tl;
  }
  return true;
}

bool ShapeHarmonics::from_model(const FitProblem& problem, int most, ShapePoint shape,
                                double tolerance) {
  value_.clear();
  by_logit_.clear();
  by_log_.clear();
  const auto greatest = static_cast<std::size_t>(std::max(most, 0));
  std::size_t end = std::min(kFirstBlock, greatest);  // where to look
  for (std::size_t wanted = std::clamp(count_of_model_, end, greatest); value_.size() < greatest;
       wanted = std::min(2 * value_.size(), greatest)) {
    const std::size_t before = value_.size();
    if (!append_from_model(problem, shape, wanted - before)) return false;
    for (; end <= value_.size(); end = std::min(2 * end, greatest)) {
      // The last third of plain_ is R~ a step above.
      const double height = plain_[2 * (wanted - before) + end - before - 1];
      if (end < greatest &&
          !(2 * height / (std::numbers::pi * static_cast<double>(end)) < tolerance))
        continue;
      for (std::vector<double>* values : {&value_, &by_logit_, &by_log_}) values->resize(end);
      count_of_model_ = end;
      return true;
    }
  }
  return true;
}

// sinc(n d) d, kept while the stripes are the same.
void ShapeHarmonics::grow_envelope(StripeShape stripes, std::size_t count) {
  if (stripes != envelope_of_) envelope_.clear();
  envelope_of_ = stripes;
  while (envelope_.size() < count) {
    const double angle = std::numbers::pi * static_cast<double>(envelope_.size() + 1);
    envelope_.push_back(std::sin(angle * stripes.width_px / stripes.period_px) / angle);
  }
}

// k l_d of harmonics before + 1 .. before + count at each of these offsets of ln l_d.
// [offset][harmonic]
void ShapeHarmonics::set_waves(const FitProblem& problem, ShapePoint shape, std::size_t before,
                               std::size_t count, std::span<const double> log_offsets) {
  waves_.resize(log_offsets.size() * count);
  double* out = waves_.data();
  for (const double offset : log_offsets) {
    const double first = 2 * std::numbers::pi / problem.shape.period_px *
                         std::exp(shape.log_translucency_px + offset);
    for (std::size_t i = 1; i <= count; ++i) *out++ = first * static_cast<double>(before + i);
  }
}

bool ShapeHarmonics::append_from_model(const FitProblem& problem, ShapePoint shape,
                                       std::size_t count) {
  constexpr double h = kDifferenceStep;
  const std::size_t before = value_.size();
  constexpr std::array<double, 3> kOffsets = {0, -h, h};
  set_waves(problem, shape, before, count, kOffsets);
  plain_.resize(waves_.size());
  lower_.resize(count);
  upper_.resize(count);
  const auto waves = std::span<const double>(waves_).first(count);
  problem.model->transform(reflectance_at(shape.logit_reflectance), waves_, plain_);
  problem.model->transform(reflectance_at(shape.logit_reflectance - h), waves, lower_);
  problem.model->transform(reflectance_at(shape.logit_reflectance + h), waves, upper_);
  grow_envelope(problem.shape, before + count);
  double sum = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const double envelope = envelope_[before + i];
    value_.push_back(envelope * plain_[i]);
    by_log_.push_back(envelope * (plain_[2 * count + i] - plain_[count + i]) / (2 * h));
    by_logit_.push_back(envelope * (upper_[i] - lower_[i]) / (2 * h));
    sum += value_.back() + by_log_.back() + by_logit_.back();
  }
  return std::isfinite(sum);
}

// A node's second derivatives hold in its middle: between nodes, bilinear.
void ShapeHarmonics::curvature_between_nodes(const HarmonicTable& table, ShapePoint shape) {
  const ShapePoint& least = table.range().least;
  const auto place = [](double offset, double step, int count, int& first) {
    first = std::clamp(static_cast<int>(std::floor(offset / step)), 0, std::max(count - 2, 0));
    return std::clamp(offset / step - first, 0.0, 1.0);
  };
  int row = 0, col = 0;
  const double in_row = place(shape.logit_reflectance - least.logit_reflectance, table.logit_step(),
                              table.rows(), row);
  const double in_col = place(shape.log_translucency_px - least.log_translucency_px,
                              table.log_step(), table.cols(), col);
  for (std::vector<double>* values : {&by_logit_2_, &by_both_, &by_log_2_})
    values->assign(value_.size(), 0);
  for (int corner = 0; corner < 4; ++corner) {
    const int down = corner / 2, right = corner % 2;
    const double share = (down == 1 ? in_row : 1 - in_row) * (right == 1 ? in_col : 1 - in_col);
    if (share == 0) continue;
    const std::span<const float> node = table.node(row + down, col + right);
    const std::size_t stride = table.harmonic_stride();
    for (std::size_t n = 0; n < value_.size(); ++n) {
      by_logit_2_[n] += 2 * share * static_cast<double>(node[3 * stride + n]);
      by_both_[n] += share * static_cast<double>(node[4 * stride + n]);
      by_log_2_[n] += 2 * share * static_cast<double>(node[5 * stride + n]);
    }
  }
}

bool ShapeHarmonics::curvature_of_model(const FitProblem& problem, ShapePoint shape) {
  constexpr double h = kCurvatureStep;
  const std::size_t count = value_.size();
  constexpr std::array<double, 3> kOffsets = {0, -h, h};
  set_waves(problem, shape, 0, count, kOffsets);
  for (std::vector<double>* values : {&plain_, &lower_, &upper_}) values->resize(waves_.size());
  problem.model->transform(reflectance_at(shape.logit_reflectance), waves_, plain_);
  problem.model->transform(reflectance_at(shape.logit_reflectance - h), waves_, lower_);
  problem.model->transform(reflectance_at(shape.logit_reflectance + h), waves_, upper_);
  for (std::vector<double>* values : {&by_logit_2_, &by_both_, &by_log_2_}) values->resize(count);
  double sum = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const double scale = envelope_[i] / (h * h);
    const std::size_t less = count + i, more = 2 * count + i;
    by_logit_2_[i] = scale * (upper_[i] - 2 * plain_[i] + lower_[i]);
    by_log_2_[i] = scale * (plain_[more] - 2 * plain_[i] + plain_[less]);
    by_both_[i] = scale / 4 * (upper_[more] - upper_[less] - lower_[more] + lower_[less]);
    sum += by_logit_2_[i] + by_log_2_[i] + by_both_[i];
  }
  return std::isfinite(sum);
}

}  // namespace estimation
