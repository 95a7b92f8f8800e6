#include "estimation/profile/pixel_search.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "estimation/session/maps.h"

namespace estimation {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

constexpr int kMostSteps = 30;
// The weights follow the model until a step is shorter than a hundredth of a standard deviation
// (squared here).
constexpr double kReweighingStep = 1e-4;
// Squared length of a step, in standard deviations, that is the last one: what remains after it is
// smaller by the model's curvature over the noise.
constexpr double kLastStep = 1e-6;
// In standard deviations: where second order asks for more, higher ones matter as much.
constexpr double kGreatestCorrection = 0.5;
// Between the table's nodes chi-square has seams, at which a step this short (squared) may find no
// descent: there the search has ended.
constexpr double kStepAtSeam = 1e-4;
constexpr double kGreatestLogitStep = 2, kGreatestLogStep = 1.5;
constexpr double kShortening = 0.4;
constexpr int kShortenings = 3;
constexpr double kFirstDamping = 1e-2, kMoreDamping = 30, kGreatestDamping = 1e4;
// R_d from 1e-7 to 1 - 1e-10: beyond, data ask for a material that no model has.
constexpr double kLeastLogit = -16, kGreatestLogit = 23;
// l_d from a hundredth of a projector px to 150 periods: beyond, all profiles look alike.
constexpr double kLeastLog = -4.5, kGreatestLogPeriods = 5;
// Outside of the table the model is expensive. ln l becomes less certain outwards in all
// directions: a pixel whose ln l is this uncertain at the table's edge will not be known beyond,
// and one that is so uncertain outside, or after some steps, will not come back.
constexpr double kEdgeLogSd = 0.45, kHopelessLogSd = 3;
constexpr int kPatience = 4;

double reflectance_at(double logit) { return 1 / (1 + std::exp(-logit)); }
double reflectance_slope(double logit) {
  return 1 / ((1 + std::exp(-logit)) * (1 + std::exp(logit)));
}

double product(const std::vector<double>& a, const std::vector<double>& b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
}

std::uint32_t reason_at_limit(const ShapePoint& shape) {
  const double logit = shape.logit_reflectance;
  const double from_limit = std::min(logit - kLeastLogit, kGreatestLogit - logit);
  return from_limit < 2 * kGreatestLogitStep ? kOutsideModel : kNotIdentifiable;
}

}  // namespace

PixelModel::Binding PixelSearch::bind(const FitProblem& problem, const PixelBatch& batch,
                                      std::size_t pixel) {
  problem_ = &problem;
  may_leave_table_ = false;
  harmonics_ = PixelModel::Harmonics::kOfTable;
  return model_.bind(problem, batch, pixel);
}

std::size_t PixelSearch::choose_space() {
  model_.choose_space(space_);
  return space_.size();
}

bool PixelSearch::evaluate(const SearchPoint& point, ModelSamples& samples) {
  return point.shape.logit_reflectance > kLeastLogit &&
         point.shape.logit_reflectance < kGreatestLogit &&
         point.shape.log_translucency_px > kLeastLog &&
         point.shape.log_translucency_px <
             std::log(problem_->shape.period_px) + kGreatestLogPeriods &&
         model_.evaluate(point.shape, point.phase_px, tolerance_, harmonics_, samples);
}

double PixelSearch::expected(const SearchPoint& point, const ModelSamples& samples,
                             std::size_t sample) const {
  const double mean = is_free() ? point.mean : reflectance_at(point.shape.logit_reflectance);
  return model_.level() * mean + samples.harmonics[sample];
}

void PixelSearch::weigh(const SearchPoint& point, const ModelSamples& samples) {
  in_samples_.resize(model_.sample_count());
  for (std::size_t i = 0; i < in_samples_.size(); ++i)
    in_samples_[i] = model_.variance(expected(point, samples, i));
  space_.set_variances(in_samples_);
}

void PixelSearch::whiten_residual(const SearchPoint& point, const ModelSamples& samples) {
  in_samples_.resize(model_.sample_count());
  for (std::size_t i = 0; i < in_samples_.size(); ++i)
    in_samples_[i] = model_.reflectance()[i] - expected(point, samples, i);
  space_.whiten(in_samples_, residual_);
}

double PixelSearch::chi_square_at(const SearchPoint& point, const ModelSamples& samples) {
  whiten_residual(point, samples);
  return product(residual_, residual_);
}

void PixelSearch::assemble(const SearchPoint& point, const ModelSamples& samples) {
  const double mean_slope =
      is_free() ? 0 : model_.level() * reflectance_slope(point.shape.logit_reflectance);
  in_samples_ = samples.by_logit;
  for (double& slope : in_samples_) slope += mean_slope;
  space_.whiten(in_samples_, slopes_[0]);
  space_.whiten(samples.by_log, slopes_[1]);
  in_samples_.assign(in_samples_.size(), is_free() ? model_.level() : 0);
  space_.whiten(in_samples_, slopes_[2]);
  space_.whiten(samples.by_phase, slopes_[3]);
  chi_square_ = chi_square_at(point, samples);
  for (std::size_t i = 0; i < kUnknowns; ++i) {
    gradient_[i] = product(slopes_[i], residual_);
    for (std::size_t j = 0; j <= i; ++j)
      normal_[i][j] = normal_[j][i] = product(slopes_[i], slopes_[j]);
  }
  if (!is_free()) normal_[2][2] = 1;
}

std::optional<PixelSearch::Step> PixelSearch::step(double damping) const {
  SmallMatrix<kUnknowns> damped = normal_;
  for (std::size_t i = 0; i < kUnknowns; ++i) damped[i][i] *= 1 + damping;
  const auto root = scaled_cholesky(damped);
  if (!root) return std::nullopt;
  return root->solve(gradient_);
}

// In standard deviations of the fit; also what an undamped step takes off chi-square.
double PixelSearch::squared_length(const Step& step) const {
  double length = 0;
  for (std::size_t i = 0; i < kUnknowns; ++i)
    for (std::size_t j = 0; j < kUnknowns; ++j) length += step[i] * normal_[i][j] * step[j];
  return length;
}

// A long step is shortened as a whole.
SearchPoint PixelSearch::moved(const SearchPoint& point, const Step& step) const {
  const double longest =
      std::max({1.0, std::abs(step[0]) / kGreatestLogitStep, std::abs(step[1]) / kGreatestLogStep,
                std::abs(step[3]) * 8 / problem_->shape.period_px});
  return {.shape = {point.shape.logit_reflectance + step[0] / longest,
                    point.shape.log_translucency_px + step[1] / longest},
          .mean = point.mean + step[2] / longest,
          .phase_px = point.phase_px + step[3] / longest};
}

// Fisher information in (t, ln l, B, phase), B = mean - R_d.
SymmetricMatrix PixelSearch::information(const SearchPoint& point) const {
  SmallMatrix<kUnknowns> full = normal_;
  if (is_free()) {
    const double slope = reflectance_slope(point.shape.logit_reflectance);
    for (std::size_t i = 0; i < kUnknowns; ++i) full[i][0] += slope * full[i][2];
    for (std::size_t i = 0; i < kUnknowns; ++i) full[0][i] += slope * full[2][i];
  }
  SymmetricMatrix lower{};
  for (std::size_t i = 0; i < kUnknowns; ++i)
    for (std::size_t j = 0; j <= i; ++j) lower[covariance_index(i, j)] = full[i][j];
  return lower;
}

double PixelSearch::log_variance() const {
  const auto root = scaled_cholesky(normal_);
  return root ? root->solve({0, 1, 0, 0})[1] : kInfinity;
}

bool PixelSearch::is_in_table(const ShapePoint& shape) const {
  return problem_->table != nullptr && problem_->table->holds(shape);
}

// The nearest point that the table holds.
ShapePoint PixelSearch::within_table(const ShapePoint& shape) const {
  const auto& [least, greatest] = problem_->table->range();
  return {std::clamp(shape.logit_reflectance, least.logit_reflectance, greatest.logit_reflectance),
          std::clamp(shape.log_translucency_px, least.log_translucency_px,
                     greatest.log_translucency_px)};
}

// A step shortened until it descends. Out of the table it stops at the edge, unless it may leave.
bool PixelSearch::advance(SearchPoint& point, Step change, int attempts) {
  const bool is_held = !may_leave_table_ && is_in_table(point.shape);
  for (int attempt = 0; attempt < attempts; ++attempt) {
    SearchPoint next = moved(point, change);
    if (is_held) next.shape = within_table(next.shape);
    if (evaluate(next, trial_samples_) && chi_square_at(next, trial_samples_) < chi_square_) {
      point = next;
      std::swap(samples_, trial_samples_);
      return true;
    }
    for (double& part : change) part *= kShortening;
  }
  return false;
}

bool PixelSearch::settle(const SearchPoint& point) {
  if (!evaluate(point, samples_)) return false;
  weigh(point, samples_);
  assemble(point, samples_);
  return true;
}

// First with what the table has; the model itself is for those whose l_d can be known.
std::uint32_t PixelSearch::run(SearchPoint& point) {
  if (!settle(point)) return kOutsideModel;
  const auto is_worth_the_model = [&] { return log_variance() < kEdgeLogSd * kEdgeLogSd; };
  double damping = 0;
  for (int count = 0; count < kMostSteps && damping < kGreatestDamping; ++count) {
    const bool is_inside = is_in_table(point.shape);
    if ((!is_inside || count >= kPatience) && log_variance() > kHopelessLogSd * kHopelessLogSd)
      break;
    const auto change = step(damping);
    const double length = change ? squared_length(*change) : kInfinity;
    if (damping == 0 && length < kLastStep) {
      if (harmonics_ == PixelModel::Harmonics::kOfTable && model_.is_cut_off()) {
        if (!is_worth_the_model()) break;
        harmonics_ = PixelModel::Harmonics::kAll;
        if (!settle(point)) break;
        continue;
      }
      point = moved(point, *change);
      chi_square_ = std::max(chi_square_ - length, 0.0);
      return 0;
    }
    const bool is_leaving =
        is_inside && !may_leave_table_ && change && !is_in_table(moved(point, *change).shape);
    if (change && advance(point, *change, damping == 0 ? kShortenings : 1)) {
      damping = damping > kFirstDamping ? damping / kMoreDamping : 0;
      if (length > kReweighingStep) weigh(point, samples_);
      assemble(point, samples_);
    } else if (is_leaving) {
      if (!is_worth_the_model()) break;
      may_leave_table_ = true;
    } else if (damping == 0 && length < kStepAtSeam) {
      return 0;
    } else {
      damping = std::max(kFirstDamping, damping * kMoreDamping);
    }
  }
  return reason_at_limit(point.shape);
}

// Least squares on a curved model are off on average, by -C J^T W q (M. J. Box, Bias in nonlinear
// estimation, J. R. Statist. Soc. B 33 (1971)) with q the samples' expected shift: a step with q in
// the residual's place takes that off. Weights that follow the model add nothing of this order:
// what they add to the noise's share of the gradient they take from the curvature's. R_d and l_d
// bend over t and ln l, so that these are moved on to where R_d and l_d have no bias.
SearchPoint PixelSearch::unbiased(const SearchPoint& point) {
  const auto inverse = inverse_of(normal_);
  if (!inverse) return point;
  std::array<double, 10> covariance{};
  for (std::size_t i = 0; i < kUnknowns; ++i)
    for (std::size_t j = 0; j <= i; ++j) covariance[covariance_index(i, j)] = (*inverse)[i][j];
  if (!model_.expected_shift(point.shape, point.phase_px, tolerance_, harmonics_, covariance,
                             in_samples_))
    return point;
  const double logit = point.shape.logit_reflectance, half_variance = 0.5 * (*inverse)[0][0];
  const double bend = 1 - 2 * reflectance_at(logit);  // R_d'' / R_d'
  if (!is_free())
    for (double& shift : in_samples_)
      shift += model_.level() * reflectance_slope(logit) * bend * half_variance;
  space_.whiten(in_samples_, residual_);
  Step change{};
  for (std::size_t i = 0; i < kUnknowns; ++i)
    for (std::size_t j = 0; j < kUnknowns; ++j)
      change[i] += (*inverse)[i][j] * product(slopes_[j], residual_);
  if (!is_free()) change[2] = 0;
  change[0] -= bend * half_variance;
  change[1] -= 0.5 * (*inverse)[1][1];
  const double share = std::min(1.0, kGreatestCorrection / std::sqrt(squared_length(change)));
  return {.shape = {logit + share * change[0], point.shape.log_translucency_px + share * change[1]},
          .mean = point.mean + share * change[2],
          .phase_px = point.phase_px + share * change[3]};
}

}  // namespace estimation
