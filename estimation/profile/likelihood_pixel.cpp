#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <limits>
#include <numbers>
#include <numeric>
#include <optional>
#include <utility>

#include "estimation/profile/fisher.h"
#include "estimation/profile/likelihood.h"
#include "estimation/profile/pixel_model.h"
#include "estimation/profile/small_matrix.h"
#include "estimation/session/maps.h"

namespace estimation {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// A first harmonic whose square is below so many times its variance is noise (by chance once in
// 400 pixels).
constexpr double kLeastContrast = 12;
// Samples whose mean is below so many of their standard deviations are dark, not flat.
constexpr double kDarkSnr = 5;
// Harmonics this share of a sample's noise are left out.
constexpr double kToleranceOfNoise = 3e-4;

// Where a start looks for R_d, as a share of the mean: B from -R_d/5 to 12 R_d.
constexpr double kLeastShare = 0.08, kGreatestShare = 1.25;

// A quarter of a projector pixel: where all profiles look alike a search finds no way out.
constexpr double kLeastLogStart = -1.4;
constexpr double kNoHarmonic = 1e-3;  // of full light

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
// Where a search starts again: a third of the period lit by the profile's tail.
constexpr double kPeriodsOfSecondStart = 1.0 / 12, kShareOfSecondStart = 0.6;

double reflectance_at(double logit) { return 1 / (1 + std::exp(-logit)); }
double reflectance_slope(double logit) {
  return 1 / ((1 + std::exp(-logit)) * (1 + std::exp(logit)));
}
double logit_of(double reflectance) { return std::log(reflectance / (1 - reflectance)); }

double product(const std::vector<double>& a, const std::vector<double>& b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
}

// A point of the search. The mean R_d + B takes the place of B: it is linear, and independent of
// the rest.
struct Point {
  ShapePoint shape;
  double mean = 0;
  double phase_px = 0;
};

// The samples' mean, first and another harmonic by least squares, without weights:
// r = mean + sum Re[harmonic exp(i n angle)].
struct Demodulated {
  double mean = 0;
  std::complex<double> first{}, second{};
  double first_variance = 0;  // of its parts, for samples of unit variance
};

template <std::size_t N>
std::optional<Demodulated> demodulate(PixelModel& model, int second_harmonic) {
  const std::size_t count = model.sample_count();
  if (count < N) return std::nullopt;
  SmallMatrix<N> normal{};
  std::array<double, N> right{};
  // The highest one first: it makes room for those below.
  model.cosines(second_harmonic);
  const std::array<std::span<const double>, 2> first = {model.cosines(1), model.sines(1)};
  const std::array<std::span<const double>, 2> second = {model.cosines(second_harmonic),
                                                         model.sines(second_harmonic)};
  for (std::size_t sample = 0; sample < count; ++sample) {
    std::array<double, N> row{};
    row[0] = 1;
    row[1] = first[0][sample];
    row[2] = first[1][sample];
    if constexpr (N == 5) row[3] = second[0][sample], row[4] = second[1][sample];
    for (std::size_t i = 0; i < N; ++i) {
      right[i] += row[i] * model.reflectance()[sample];
      for (std::size_t j = 0; j <= i; ++j) normal[i][j] += row[i] * row[j];
    }
  }
  const auto root = scaled_cholesky(normal);
  if (!root) return std::nullopt;
  const std::array<double, N> x = root->solve(right);
  std::array<double, N> re{}, im{};
  re[1] = im[2] = 1;
  const auto back = [&](int n) { return std::polar(1.0, -n * model.origin_rad()); };
  Demodulated data{.mean = x[0],
                   .first = std::complex(x[1], x[2]) * back(1),
                   .first_variance = 0.5 * (root->solve(re)[1] + root->solve(im)[2])};
  if constexpr (N == 5) data.second = std::complex(x[3], x[4]) * back(second_harmonic);
  return data;
}

// Buffers, kept from pixel to pixel.
struct Workspace {
  PixelModel model;
  ModelSamples samples, trial_samples;
  SampleSpace space;
  std::vector<double> in_samples;  // one number a sample, on its way to the space
  std::vector<double> residual;    // of a trial, whitened
  std::array<std::vector<double>, kUnknowns> slopes;  // whitened, at the current point
};

class Fit {
 public:
  // `work.model` is bound to the pixel.
  Fit(const FitProblem& problem, Workspace& work)
      : problem_(problem),
        model_(work.model),
        samples_(work.samples),
        trial_samples_(work.trial_samples),
        space_(work.space),
        in_samples_(work.in_samples),
        residual_(work.residual),
        slopes_(work.slopes) {
    if (problem.table != nullptr && problem.table->rows() > 0) range_ = problem.table->range();
    // Stripes half as wide as their period have no second harmonic.
    if (std::abs(envelope(2)) < kNoHarmonic) second_ = 3;
  }

  PixelFit run();

 private:
  bool is_free() const { return problem_.indirect == IndirectLight::kFree; }
  std::size_t unknown_count() const { return is_free() ? 4 : 3; }

  double envelope(int n) const {
    return std::sin(std::numbers::pi * n * problem_.shape.width_px / problem_.shape.period_px) /
           (std::numbers::pi * n);
  }
  std::optional<Demodulated> demodulated() const;
  std::uint32_t reason_for_too_few() const;
  std::uint32_t check_contrast(const Demodulated& data);
  Point start(const Demodulated& data) const;
  std::array<double, 2> first_harmonics(ShapePoint shape) const;
  double log_with_first_harmonic(double logit, double target) const;

  bool evaluate(const Point& point, ModelSamples& samples);
  double expected(const Point& point, const ModelSamples& samples, std::size_t sample) const;
  void weigh(const Point& point, const ModelSamples& samples);
  void whiten_residual(const Point& point, const ModelSamples& samples);
  double chi_square(const Point& point, const ModelSamples& samples);
  void assemble(const Point& point, const ModelSamples& samples);
  std::optional<std::array<double, kUnknowns>> step(double damping) const;
  double squared_length(const std::array<double, kUnknowns>& step) const;
  Point moved(const Point& point, const std::array<double, kUnknowns>& step) const;
  double log_variance() const;
  bool is_in_table(const ShapePoint& shape) const;
  ShapePoint within_table(const ShapePoint& shape) const;
  bool advance(Point& point, std::array<double, kUnknowns> change, int attempts);
  bool settle(const Point& point);
  std::uint32_t search(Point& point);
  std::uint32_t search_from(const Demodulated& data, Point& point);
  SymmetricMatrix information(const Point& point) const;
  std::uint32_t reason_at_limit(const Point& point) const;
  Point unbiased(const Point& point);
  PixelFit result(const Point& point);

  const FitProblem& problem_;
  PixelModel& model_;
  ModelSamples &samples_, &trial_samples_;
  SampleSpace& space_;
  std::vector<double>&in_samples_, &residual_;
  std::array<std::vector<double>, kUnknowns>& slopes_;
  ShapeRange range_;  // of starts
  int second_ = 2;    // the harmonic that a start compares with the first
  double tolerance_ = 0;
  // Normal equations in (t, ln l, mean, phase) at the current point.
  SmallMatrix<kUnknowns> normal_{};
  std::array<double, kUnknowns> gradient_{};
  double chi_square_ = 0;
  // What the search is allowed once it is known to be worth its cost.
  bool may_leave_table_ = false;
  PixelModel::Harmonics harmonics_ = PixelModel::Harmonics::kOfTable;
};

std::uint32_t Fit::reason_for_too_few() const {
  return model_.lost_count() > 0 ? kSaturated : kNotIdentifiable;
}

std::optional<Demodulated> Fit::demodulated() const {
  if (const auto data = demodulate<5>(model_, second_)) return data;
  return demodulate<3>(model_, second_);
}

// Also sets how much of a harmonic matters.
std::uint32_t Fit::check_contrast(const Demodulated& data) {
  const double variance = model_.variance(data.mean);
  double least = variance;
  for (const double reflectance : model_.reflectance())
    least = std::min(least, model_.variance(reflectance));
  tolerance_ = kToleranceOfNoise * std::sqrt(least);
  if (std::norm(data.first) >= kLeastContrast * data.first_variance * variance) return 0;
  return data.mean < kDarkSnr * std::sqrt(variance) ? kTooDark : kNotIdentifiable;
}

// a_1 and a_second near this point.
std::array<double, 2> Fit::first_harmonics(ShapePoint shape) const {
  const HarmonicTable* table = problem_.table;
  if (table != nullptr && table->harmonic_count() >= second_ && table->holds(shape)) {
    const ShapePoint& least = table->range().least;
    const auto node = table->node(
        static_cast<int>(
            std::round((shape.logit_reflectance - least.logit_reflectance) / table->logit_step())),
        static_cast<int>(std::round((shape.log_translucency_px - least.log_translucency_px) /
                                    table->log_step())));
    return {static_cast<double>(node[0]),
            static_cast<double>(node[static_cast<std::size_t>(second_ - 1)])};
  }
  const double wave = model_.wave_per_px() * std::exp(shape.log_translucency_px);
  const std::array<double, 2> waves = {wave, second_ * wave};
  std::array<double, 2> harmonics{};
  problem_.model->transform(reflectance_at(shape.logit_reflectance), waves, harmonics);
  return {harmonics[0] * envelope(1), harmonics[1] * envelope(second_)};
}

// ln l at which the first harmonic, which falls with l, has this height.
double Fit::log_with_first_harmonic(double logit, double target) const {
  double low = std::max(range_.least.log_translucency_px, kLeastLogStart);
  double high = std::max(range_.greatest.log_translucency_px, low);
  for (int halving = 0; halving < 7; ++halving) {
    const double middle = 0.5 * (low + high);
    (first_harmonics({logit, middle})[0] > target ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

// The phase from the first harmonic. R_d is a share of the mean, l_d what then gives the first
// harmonic its height; where there may be indirect light, the share that gives the second its own.
Point Fit::start(const Demodulated& data) const {
  const std::complex<double> first = model_.twice_factor(1);
  const std::complex<double> second = model_.twice_factor(second_);
  const std::complex<double> turn = data.first * std::conj(first);
  const std::complex<double> back = std::polar(1.0, -second_ * std::arg(turn));
  const double height = std::abs(turn) / std::norm(first);
  Point point;
  point.mean = data.mean / model_.level();
  point.phase_px = std::arg(turn) / model_.wave_per_px();
  const auto at_share = [&](double share) {
    const double logit =
        std::clamp(logit_of(std::clamp(share * point.mean, 1e-6, 0.98)),
                   range_.least.logit_reflectance, range_.greatest.logit_reflectance);
    return ShapePoint{logit, log_with_first_harmonic(logit, height)};
  };
  point.shape = at_share(1);
  if (!is_free() || std::norm(second) == 0 || data.second == 0.0) return point;
  const double second_height = (data.second * std::conj(second) * back).real() / std::norm(second);
  // Relative to a stripe's own, which may have the other sign.
  const double sign = std::copysign(1, envelope(second_));
  double low = std::log(kLeastShare), high = std::log(kGreatestShare);
  for (int halving = 0; halving < 5; ++halving) {
    const double middle = 0.5 * (low + high);
    point.shape = at_share(std::exp(middle));
    // Less R_d needs a smaller l_d for the same first harmonic, which raises the second, and too
    // little cannot have it at all.
    const std::array<double, 2> harmonics = first_harmonics(point.shape);
    const bool is_too_little =
        harmonics[0] < 0.99 * height || sign * harmonics[1] > sign * second_height;
    (is_too_little ? low : high) = middle;
  }
  point.shape = at_share(std::exp(0.5 * (low + high)));
  return point;
}

bool Fit::evaluate(const Point& point, ModelSamples& samples) {
  return point.shape.logit_reflectance > kLeastLogit &&
         point.shape.logit_reflectance < kGreatestLogit &&
         point.shape.log_translucency_px > kLeastLog &&
         point.shape.log_translucency_px <
             std::log(problem_.shape.period_px) + kGreatestLogPeriods &&
         model_.evaluate(point.shape, point.phase_px, tolerance_, harmonics_, samples);
}

double Fit::expected(const Point& point, const ModelSamples& samples, std::size_t sample) const {
  const double mean = is_free() ? point.mean : reflectance_at(point.shape.logit_reflectance);
  return model_.level() * mean + samples.harmonics[sample];
}

void Fit::weigh(const Point& point, const ModelSamples& samples) {
  in_samples_.resize(model_.sample_count());
  for (std::size_t i = 0; i < in_samples_.size(); ++i)
    in_samples_[i] = model_.variance(expected(point, samples, i));
  space_.set_variances(in_samples_);
}

void Fit::whiten_residual(const Point& point, const ModelSamples& samples) {
  in_samples_.resize(model_.sample_count());
  for (std::size_t i = 0; i < in_samples_.size(); ++i)
    in_samples_[i] = model_.reflectance()[i] - expected(point, samples, i);
  space_.whiten(in_samples_, residual_);
}

double Fit::chi_square(const Point& point, const ModelSamples& samples) {
  whiten_residual(point, samples);
  return product(residual_, residual_);
}

void Fit::assemble(const Point& point, const ModelSamples& samples) {
  const double mean_slope =
      is_free() ? 0 : model_.level() * reflectance_slope(point.shape.logit_reflectance);
  in_samples_ = samples.by_logit;
  for (double& slope : in_samples_) slope += mean_slope;
  space_.whiten(in_samples_, slopes_[0]);
  space_.whiten(samples.by_log, slopes_[1]);
  in_samples_.assign(in_samples_.size(), is_free() ? model_.level() : 0);
  space_.whiten(in_samples_, slopes_[2]);
  space_.whiten(samples.by_phase, slopes_[3]);
  chi_square_ = chi_square(point, samples);
  for (std::size_t i = 0; i < kUnknowns; ++i) {
    gradient_[i] = product(slopes_[i], residual_);
    for (std::size_t j = 0; j <= i; ++j)
      normal_[i][j] = normal_[j][i] = product(slopes_[i], slopes_[j]);
  }
  if (!is_free()) normal_[2][2] = 1;
}

std::optional<std::array<double, kUnknowns>> Fit::step(double damping) const {
  SmallMatrix<kUnknowns> damped = normal_;
  for (std::size_t i = 0; i < kUnknowns; ++i) damped[i][i] *= 1 + damping;
  const auto root = scaled_cholesky(damped);
  if (!root) return std::nullopt;
  return root->solve(gradient_);
}

// In standard deviations of the fit; also what an undamped step takes off chi-square.
double Fit::squared_length(const std::array<double, kUnknowns>& step) const {
  double length = 0;
  for (std::size_t i = 0; i < kUnknowns; ++i)
    for (std::size_t j = 0; j < kUnknowns; ++j) length += step[i] * normal_[i][j] * step[j];
  return length;
}

// A long step is shortened as a whole.
Point Fit::moved(const Point& point, const std::array<double, kUnknowns>& step) const {
  const double longest =
      std::max({1.0, std::abs(step[0]) / kGreatestLogitStep, std::abs(step[1]) / kGreatestLogStep,
                std::abs(step[3]) * 8 / problem_.shape.period_px});
  return {.shape = {point.shape.logit_reflectance + step[0] / longest,
                    point.shape.log_translucency_px + step[1] / longest},
          .mean = point.mean + step[2] / longest,
          .phase_px = point.phase_px + step[3] / longest};
}

// Fisher information in (t, ln l, B, phase), B = mean - R_d.
SymmetricMatrix Fit::information(const Point& point) const {
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

std::uint32_t Fit::reason_at_limit(const Point& point) const {
  const double logit = point.shape.logit_reflectance;
  const double from_limit = std::min(logit - kLeastLogit, kGreatestLogit - logit);
  return from_limit < 2 * kGreatestLogitStep ? kOutsideModel : kNotIdentifiable;
}

double Fit::log_variance() const {
  const auto root = scaled_cholesky(normal_);
  return root ? root->solve({0, 1, 0, 0})[1] : kInfinity;
}

bool Fit::is_in_table(const ShapePoint& shape) const {
  return problem_.table != nullptr && problem_.table->holds(shape);
}

// The nearest point that the table holds.
ShapePoint Fit::within_table(const ShapePoint& shape) const {
  const auto& [least, greatest] = problem_.table->range();
  return {std::clamp(shape.logit_reflectance, least.logit_reflectance, greatest.logit_reflectance),
          std::clamp(shape.log_translucency_px, least.log_translucency_px,
                     greatest.log_translucency_px)};
}

// A step shortened until it descends. Out of the table it stops at the edge, unless it may leave.
bool Fit::advance(Point& point, std::array<double, kUnknowns> change, int attempts) {
  const bool is_held = !may_leave_table_ && is_in_table(point.shape);
  for (int attempt = 0; attempt < attempts; ++attempt) {
    Point next = moved(point, change);
    if (is_held) next.shape = within_table(next.shape);
    if (evaluate(next, trial_samples_) && chi_square(next, trial_samples_) < chi_square_) {
      point = next;
      std::swap(samples_, trial_samples_);
      return true;
    }
    for (double& part : change) part *= kShortening;
  }
  return false;
}

bool Fit::settle(const Point& point) {
  if (!evaluate(point, samples_)) return false;
  weigh(point, samples_);
  assemble(point, samples_);
  return true;
}

// Gauss-Newton; a step that does not descend is shortened, as R_d and l_d lie in a curved valley,
// then damped. 0 at the optimum. First with what the table has; the model itself is for those whose
// l_d can be known.
std::uint32_t Fit::search(Point& point) {
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
  return reason_at_limit(point);
}

// From the harmonics, or else from the middle of what can be told apart.
std::uint32_t Fit::search_from(const Demodulated& data, Point& point) {
  point = start(data);
  const std::uint32_t reason = search(point);
  if (reason == 0) return 0;
  point = start(data);
  point.shape = {logit_of(std::clamp(kShareOfSecondStart * point.mean, 1e-3, 0.9)),
                 std::log(kPeriodsOfSecondStart * problem_.shape.period_px)};
  return search(point) == 0 ? 0 : reason;
}

// Least squares on a curved model are off on average, by -C J^T W q (M. J. Box, Bias in nonlinear
// estimation, J. R. Statist. Soc. B 33 (1971)) with q the samples' expected shift: a step with q in
// the residual's place takes that off. Weights that follow the model add nothing of this order:
// what they add to the noise's share of the gradient they take from the curvature's. R_d and l_d
// bend over t and ln l, so that these are moved on to where R_d and l_d have no bias.
Point Fit::unbiased(const Point& point) {
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
  std::array<double, kUnknowns> change{};
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

PixelFit Fit::result(const Point& point) {
  const SymmetricMatrix known = information(point);
  const auto covariance = inverse_information(known, problem_.indirect);
  if (!covariance || !is_identifiable(known, *covariance, problem_.indirect))
    return {.validity = kNotIdentifiable};
  const Point best = unbiased(point);
  PixelFit fit{
      .logit_reflectance = best.shape.logit_reflectance,
      .log_translucency_px = best.shape.log_translucency_px,
      .phase_px = best.phase_px,
      .covariance = *covariance,
      .chi_square = chi_square_,
      .degrees_of_freedom = static_cast<int>(space_.size()) - static_cast<int>(unknown_count())};
  if (is_free()) fit.indirect = best.mean - reflectance_at(best.shape.logit_reflectance);
  return fit;
}

PixelFit Fit::run() {
  const auto refused = [](std::uint32_t reason) { return PixelFit{.validity = reason}; };
  if (model_.sample_count() < unknown_count()) return refused(reason_for_too_few());
  if (!(model_.level() > 0) || std::norm(model_.twice_factor(1)) == 0)
    return refused(kNotIdentifiable);
  const auto data = demodulated();
  if (!data) return refused(reason_for_too_few());
  if (const std::uint32_t reason = check_contrast(*data)) return refused(reason);
  model_.choose_space(space_);
  if (space_.size() < unknown_count()) return refused(kNotIdentifiable);
  Point point;
  if (const std::uint32_t reason = search_from(*data, point)) return refused(reason);
  return result(point);
}

}  // namespace

PixelFit fit_pixel(const FitProblem& problem, const PixelBatch& batch, std::size_t pixel) {
  // As long-lived as their thread: of a thousand pixels only the first allocates.
  thread_local Workspace work;
  switch (work.model.bind(problem, batch, pixel)) {
    case PixelModel::Binding::kNoLight:
      return {.validity = kTooDark};
    case PixelModel::Binding::kAbsurd:
      return {.validity = kOutsideModel};
    case PixelModel::Binding::kReady:
      break;
  }
  return Fit(problem, work).run();
}

}  // namespace estimation
