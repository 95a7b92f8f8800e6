#include "estimation/profile/pixel_model.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace estimation {
namespace {

// Beyond any reflectance factor, even of a mirror that faces the camera.
constexpr double kAbsurdReflectance = 1e6;
// The exact model's harmonics come in blocks, up to so many a period's pixel: stripes with edges
// sharper than an eighth of a pixel are no stripes of a projector.
constexpr int kBlock = 16;
constexpr int kHarmonicsPerPx = 8;
// Of the exact model's central differences; errs by 1e-8 of the derivative.
constexpr double kDifferenceStep = 1e-4;
// Of the differences of those; errs by 1e-4 of the second derivative, which only corrects a bias.
constexpr double kCurvatureStep = 0.02;
// Where a table's last harmonics are this many tolerances high, those that it lacks matter.
constexpr double kTruncation = 15;
// Of full light: without any noise stated, rounding is what is left.
constexpr double kLeastSd = 1e-6;

float row_value(std::span<const float> rows, std::size_t row, std::size_t stride,
                std::size_t pixel) {
  return rows[row * stride + pixel];
}

}  // namespace

PixelModel::Binding PixelModel::bind(const FitProblem& problem, const PixelBatch& batch,
                                     std::size_t pixel) {
  problem_ = &problem;
  batch_ = &batch;
  pixel_ = pixel;
  reflectance_.clear();
  turn_re_.clear();
  turn_im_.clear();
  turn_count_ = 0;
  full_signal_ = static_cast<double>(batch.full_signal[pixel]);
  const double period_px = problem.shape.period_px;
  duty_ = problem.shape.width_px / period_px;
  wave_per_px_ = 2 * std::numbers::pi / period_px;
  const double factor = batch.factor_re.empty() ? 1 : static_cast<double>(batch.factor_re[pixel]);
  level_ = factor * (duty_ + problem.projector_black_frac);
  const double position_px = static_cast<double>(batch.position_px[pixel]);
  if (!std::isfinite(full_signal_) || !std::isfinite(position_px) || !std::isfinite(level_))
    return Binding::kAbsurd;
  for (int n = 1; n < batch.factor_count; ++n)
    if (!std::isfinite(std::norm(twice_factor(n)))) return Binding::kAbsurd;
  if (!(full_signal_ > 0)) return Binding::kNoLight;
  const std::size_t shift_count = problem.shifts_px.size();
  for (std::size_t i = 0; i < shift_count; ++i) {
    const float sample =
        batch.samples.empty() ? 0.0F : row_value(batch.samples, i, batch.stride, pixel);
    if (std::isnan(sample)) continue;
    double offset_px = 0;
    if (batch.offset_px.size() == shift_count)
      offset_px = static_cast<double>(batch.offset_px[i]);
    else if (!batch.offset_px.empty())
      offset_px = static_cast<double>(row_value(batch.offset_px, i, batch.stride, pixel));
    const double reflectance = static_cast<double>(sample) / full_signal_;
    if (!(std::abs(reflectance) < kAbsurdReflectance) || !std::isfinite(offset_px))
      return Binding::kAbsurd;
    const double angle =
        wave_per_px_ * std::remainder(position_px - problem.shifts_px[i] - offset_px -
                                          0.5 * (problem.shape.width_px - 1),
                                      period_px);
    reflectance_.push_back(reflectance);
    turn_re_.push_back(std::cos(angle));
    turn_im_.push_back(std::sin(angle));
  }
  turn_count_ = 1;
  return Binding::kReady;
}

std::span<const double> PixelModel::turn_re(int n) {
  grow_turns(n);
  return std::span(turn_re_).subspan(static_cast<std::size_t>(n - 1) * sample_count(),
                                     sample_count());
}

std::span<const double> PixelModel::turn_im(int n) {
  grow_turns(n);
  return std::span(turn_im_).subspan(static_cast<std::size_t>(n - 1) * sample_count(),
                                     sample_count());
}

void PixelModel::grow_turns(int harmonic_count) {
  if (harmonic_count <= turn_count_) return;
  const std::size_t samples = sample_count();
  turn_re_.resize(static_cast<std::size_t>(harmonic_count) * samples);
  turn_im_.resize(turn_re_.size());
  for (std::size_t at = static_cast<std::size_t>(turn_count_) * samples; at < turn_re_.size();
       ++at) {
    const std::size_t first = at % samples, before = at - samples;
    turn_re_[at] = turn_re_[before] * turn_re_[first] - turn_im_[before] * turn_im_[first];
    turn_im_[at] = turn_re_[before] * turn_im_[first] + turn_im_[before] * turn_re_[first];
  }
  turn_count_ = harmonic_count;
}

std::complex<double> PixelModel::twice_factor(int n) const {
  if (batch_->factor_re.empty()) return 2;
  if (n >= batch_->factor_count) return 0;
  const auto row = static_cast<std::size_t>(n);
  return {2 * static_cast<double>(row_value(batch_->factor_re, row, batch_->stride, pixel_)),
          2 * static_cast<double>(row_value(batch_->factor_im, row, batch_->stride, pixel_))};
}

double PixelModel::variance(double reflectance) const {
  return std::max(
      variance_at(problem_->noise, reflectance * full_signal_) / (full_signal_ * full_signal_),
      kLeastSd * kLeastSd);
}

int PixelModel::most_harmonics() const {
  int most = kHarmonicsPerPx * problem_->shape.period_px;
  if (!batch_->factor_re.empty()) most = std::min(most, batch_->factor_count - 1);
  return most;
}

bool PixelModel::evaluate(ShapePoint shape, double phase_px, double tolerance, Harmonics harmonics,
                          ModelSamples& out) {
  is_cut_off_ = false;
  if (!from_table(shape, tolerance, harmonics) && !from_model(shape, tolerance)) return false;
  for (std::vector<double>* row : {&out.harmonics, &out.by_logit, &out.by_log, &out.by_phase})
    row->assign(sample_count(), 0);
  const int count = static_cast<int>(value_.size());
  grow_turns(count);
  for (int n = 1; n <= count; ++n) add_harmonic(n, phase_px, out);
  return true;
}

bool PixelModel::from_table(ShapePoint shape, double tolerance, Harmonics harmonics) {
  const HarmonicTable* table = problem_->table;
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
  const int most = std::min(table->harmonic_count(), most_harmonics());
  auto count = static_cast<std::size_t>(most);
  is_cut_off_ = most > 1 && most_harmonics() > most &&
                std::max(size(count - 1), size(count - 2)) > kTruncation * tolerance;
  if (is_cut_off_ && harmonics == Harmonics::kAll) return false;
  while (count > 1 && size(count - 1) < tolerance) --count;
  value_.resize(count);
  by_logit_.resize(count);
  by_log_.resize(count);
  for (std::size_t n = 0; n < count; ++n) {
    const double tt = dt * term(3, n), tl = term(4, n), ll = dl * term(5, n);
    value_[n] = term(0, n) + dt * (term(1, n) + tt + dl * tl) + dl * (term(2, n) + ll);
    by_logit_[n] = term(1, n) + 2 * tt + dl * tl;
    by_log_[n] = term(2, n) + 2 * ll + dt * tl;
  }
  return true;
}

bool PixelModel::from_model(ShapePoint shape, double tolerance) {
  value_.clear();
  by_logit_.clear();
  by_log_.clear();
  for (int most = most_harmonics(); static_cast<int>(value_.size()) < most;) {
    const int before = static_cast<int>(value_.size());
    if (!append_from_model(shape, std::min(kBlock, most - before))) return false;
    // plain_ holds R~ at the block's harmonics, the last one third from its end.
    const double last = plain_[plain_.size() - 3];
    if (2 * last / (std::numbers::pi * static_cast<double>(value_.size())) < tolerance) break;
  }
  return true;
}

bool PixelModel::append_from_model(ShapePoint shape, int count) {
  constexpr double h = kDifferenceStep;
  const auto reflectance = [&](double offset) {
    return 1 / (1 + std::exp(-shape.logit_reflectance - offset));
  };
  const auto size = static_cast<std::size_t>(count);
  const double first = wave_per_px_ * std::exp(shape.log_translucency_px);
  const std::size_t before = value_.size();
  waves_.resize(3 * size);  // [n][lambda, lambda - h, lambda + h]
  for (std::size_t i = 0; i < size; ++i) {
    const double wave = first * static_cast<double>(before + i + 1);
    waves_[3 * i] = wave;
    waves_[3 * i + 1] = wave * std::exp(-h);
    waves_[3 * i + 2] = wave * std::exp(h);
  }
  plain_.resize(waves_.size());
  problem_->model->transform(reflectance(0), waves_, plain_);
  for (std::size_t i = 0; i < size; ++i) waves_[i] = waves_[3 * i];
  waves_.resize(size);
  lower_.resize(size);
  upper_.resize(size);
  problem_->model->transform(reflectance(-h), waves_, lower_);
  problem_->model->transform(reflectance(h), waves_, upper_);
  for (std::size_t i = 0; i < size; ++i) {
    const double n = static_cast<double>(before + i + 1);
    const double envelope = std::sin(std::numbers::pi * n * duty_) / (std::numbers::pi * n);
    value_.push_back(envelope * plain_[3 * i]);
    by_log_.push_back(envelope * (plain_[3 * i + 2] - plain_[3 * i + 1]) / (2 * h));
    by_logit_.push_back(envelope * (upper_[i] - lower_[i]) / (2 * h));
    if (!std::isfinite(value_.back() + by_log_.back() + by_logit_.back())) return false;
  }
  return true;
}

// A node's second derivatives hold in its middle: between nodes, bilinear.
void PixelModel::curvature_between_nodes(ShapePoint shape) {
  const HarmonicTable& table = *problem_->table;
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

// Leaves value and first derivatives of the point itself.
bool PixelModel::curvature_from_model(ShapePoint shape, double tolerance) {
  constexpr double h = kCurvatureStep;
  by_logit_2_.clear();
  by_both_.clear();
  by_log_2_.clear();
  const auto add = [](std::vector<double>& to, const std::vector<double>& by, double factor) {
    to.resize(std::max(to.size(), by.size()));
    for (std::size_t n = 0; n < by.size(); ++n) to[n] += factor * by[n];
  };
  for (const double step : {-h, h}) {
    const double factor = 1 / (2 * step);
    if (!from_model({shape.logit_reflectance + step, shape.log_translucency_px}, tolerance))
      return false;
    add(by_logit_2_, by_logit_, factor);
    add(by_both_, by_log_, factor);
    if (!from_model({shape.logit_reflectance, shape.log_translucency_px + step}, tolerance))
      return false;
    add(by_log_2_, by_log_, factor);
  }
  if (!from_model(shape, tolerance)) return false;
  for (std::vector<double>* row : {&by_logit_2_, &by_both_, &by_log_2_}) row->resize(value_.size());
  return true;
}

bool PixelModel::expected_shift(ShapePoint shape, double phase_px, double tolerance,
                                Harmonics harmonics, const std::array<double, 10>& covariance,
                                std::vector<double>& out) {
  if (from_table(shape, tolerance, harmonics))
    curvature_between_nodes(shape);
  else if (!curvature_from_model(shape, tolerance))
    return false;
  const auto c = [&](std::size_t i, std::size_t j) { return covariance[covariance_index(i, j)]; };
  const std::size_t samples = sample_count();
  out.assign(samples, 0);
  grow_turns(static_cast<int>(value_.size()));
  for (std::size_t i = 0; i < value_.size(); ++i) {
    const int n = static_cast<int>(i) + 1;
    const double wave = n * wave_per_px_;
    const std::complex<double> shift = {0.5 * (c(0, 0) * by_logit_2_[i] + c(1, 1) * by_log_2_[i] -
                                               wave * wave * c(3, 3) * value_[i]) +
                                            c(0, 1) * by_both_[i],
                                        wave * (c(0, 3) * by_logit_[i] + c(1, 3) * by_log_[i])};
    const std::complex<double> factor = shift * twice_factor(n) * std::polar(1.0, wave * phase_px);
    for (std::size_t k = 0; k < samples; ++k)
      out[k] +=
          factor.real() * turn_re_[i * samples + k] - factor.imag() * turn_im_[i * samples + k];
  }
  return true;
}

void PixelModel::choose_space(SampleSpace& space) {
  const int count = problem_->harmonic_count;
  if (count <= 0 || 2 * static_cast<std::size_t>(count) + 1 >= sample_count())
    return space.keep_all(sample_count());
  space.keep_mean(sample_count());
  for (int n = 1; n <= count; ++n) {
    space.keep_also(turn_re(n));
    space.keep_also(turn_im(n));
  }
}

void PixelModel::add_harmonic(int n, double phase_px, ModelSamples& out) {
  const auto index = static_cast<std::size_t>(n - 1);
  const double wave = n * wave_per_px_;
  const std::complex<double> factor = twice_factor(n) * std::polar(1.0, wave * phase_px);
  const double re = factor.real(), im = factor.imag();
  const double value = value_[index], by_logit = by_logit_[index], by_log = by_log_[index];
  const double by_phase = -wave * value;
  const std::size_t samples = sample_count();
  const double* __restrict cosine = turn_re_.data() + index * samples;
  const double* __restrict sine = turn_im_.data() + index * samples;
  double* __restrict sum = out.harmonics.data();
  double* __restrict sum_logit = out.by_logit.data();
  double* __restrict sum_log = out.by_log.data();
  double* __restrict sum_phase = out.by_phase.data();
  for (std::size_t i = 0; i < samples; ++i) {
    const double in_phase = re * cosine[i] - im * sine[i];
    const double quadrature = re * sine[i] + im * cosine[i];
    sum[i] += value * in_phase;
    sum_logit[i] += by_logit * in_phase;
    sum_log[i] += by_log * in_phase;
    sum_phase[i] += by_phase * quadrature;
  }
}

}  // namespace estimation
