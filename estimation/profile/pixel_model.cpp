#include "estimation/profile/pixel_model.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace estimation {
namespace {

// Beyond any reflectance factor, even of a mirror that faces the camera.
constexpr double kAbsurdReflectance = 1e6;
// Beyond any projector; a float tells places there only a sixteenth of a pixel apart.
constexpr double kAbsurdPositionPx = 1e6;
// Stripes with edges sharper than an eighth of a pixel are no stripes of a projector.
constexpr int kHarmonicsPerPx = 8;
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
  shifts_px_.clear();
  angles_rad_.clear();
  const bool was_folded = std::exchange(is_folded_, batch.offset_px.empty());
  if (is_folded_ != was_folded || problem.shape.period_px != fold_period_px_) folds_.clear();
  fold_period_px_ = problem.shape.period_px;
  full_signal_ = static_cast<double>(batch.full_signal[pixel]);
  const double period_px = problem.shape.period_px;
  duty_ = problem.shape.width_px / period_px;
  wave_per_px_ = 2 * std::numbers::pi / period_px;
  const std::size_t factor_of_pixel = batch.has_shared_factors() ? 0 : pixel;
  const double factor =
      batch.factor_re.empty() ? 1 : static_cast<double>(batch.factor_re[factor_of_pixel]);
  level_ = factor * (duty_ + problem.projector_black_frac);
  const double position_px = static_cast<double>(batch.position_px[pixel]);
  if (!std::isfinite(full_signal_) || !(std::abs(position_px) < kAbsurdPositionPx) ||
      !std::isfinite(level_))
    return Binding::kAbsurd;
  for (int n = 1; n < batch.factor_count; ++n)
    if (!std::isfinite(std::norm(twice_factor(n)))) return Binding::kAbsurd;
  if (!(full_signal_ > 0)) return Binding::kNoLight;
  origin_rad_ =
      wave_per_px_ * std::remainder(position_px - 0.5 * (problem.shape.width_px - 1), period_px);
  const std::size_t shift_count = problem.shifts_px.size();
  for (std::size_t i = 0; i < shift_count; ++i) {
    const float sample =
        batch.samples.empty() ? 0.0F : row_value(batch.samples, i, batch.stride, pixel);
    if (std::isnan(sample)) continue;
    const double reflectance = static_cast<double>(sample) / full_signal_;
    if (!(std::abs(reflectance) < kAbsurdReflectance)) return Binding::kAbsurd;
    reflectance_.push_back(reflectance);
    shifts_px_.push_back(problem.shifts_px[i]);
    if (is_folded_) continue;
    const double offset_px = static_cast<double>(
        batch.offset_px.size() == shift_count ? batch.offset_px[i]
                                              : row_value(batch.offset_px, i, batch.stride, pixel));
    if (!std::isfinite(offset_px)) return Binding::kAbsurd;
    angles_rad_.push_back(wave_per_px_ *
                          std::remainder(problem.shifts_px[i] + offset_px, period_px));
  }
  set_noise();
  set_waves_of_shifts();
  return Binding::kReady;
}

// variance_at's entries, in reflectance factors.
void PixelModel::set_noise() {
  noise_.clear();
  const double per_full = 1 / full_signal_;
  for (const MergedNoise& entry : problem_->noise) {
    const double variance = entry.read_variance + entry.shot_dn_per_us * entry.up_to_dn_per_us;
    const bool is_last = noise_.size() + 1 == problem_->noise.size();
    noise_.push_back(
        {.read_variance = entry.read_variance * per_full * per_full,
         .shot = entry.shot_dn_per_us * per_full,
         .end = entry.up_to_dn_per_us * per_full,
         .per_width = is_last ? 0 : full_signal_ / (kMixtureWidth * std::sqrt(variance))});
  }
}

double PixelModel::variance(double reflectance) const {
  if (noise_.empty()) return kLeastSd * kLeastSd;
  const double light = std::max(reflectance, 0.0);
  double variance = noise_.back().read_variance + noise_.back().shot * light;
  for (std::size_t i = noise_.size() - 1; i-- > 0;) {
    const Noise& entry = noise_[i];
    const double own = entry.read_variance + entry.shot * light, beyond = reflectance - entry.end;
    // Without noise there is no width.
    const double share = std::isfinite(entry.per_width)
                             ? std::clamp(beyond * entry.per_width + 0.5, 0.0, 1.0)
                             : static_cast<double>(beyond > 0);
    variance = own + share * (variance - own);
  }
  return std::max(variance, kLeastSd * kLeastSd);
}

// Waves of whole shifts are kept while pixels have the same ones.
void PixelModel::set_waves_of_shifts() {
  const auto period = static_cast<std::size_t>(problem_->shape.period_px);
  if (is_folded_ && shifts_of_waves_px_ == shifts_px_ && period_cosine_.size() == period) return;
  wave_count_ = 0;
  cosine_.clear();
  sine_.clear();
  shifts_of_waves_px_.clear();
  if (!is_folded_) return;
  shifts_of_waves_px_ = shifts_px_;
  if (period_cosine_.size() == period) return;
  period_cosine_.resize(period);
  period_sine_.resize(period);
  for (std::size_t px = 0; px < period; ++px) {
    period_cosine_[px] = std::cos(wave_per_px_ * static_cast<double>(px));
    period_sine_[px] = std::sin(wave_per_px_ * static_cast<double>(px));
  }
}

// Harmonics n and P - n of whole shifts have the same waves, one the other's complex conjugate.
PixelModel::Fold PixelModel::fold_of(int n) const {
  if (!is_folded_) return {.bin = static_cast<std::size_t>(n), .sign = 1};
  const int period = problem_->shape.period_px, rest = n % period;
  const bool is_mirrored = 2 * rest > period;
  return {.bin = static_cast<std::size_t>(is_mirrored ? period - rest : rest),
          .sign = is_mirrored ? -1.0 : 1.0};
}

void PixelModel::grow_waves(std::size_t bin_count) {
  const std::size_t samples = sample_count();
  const std::int64_t period = problem_->shape.period_px;
  for (; wave_count_ < bin_count; ++wave_count_)
    for (std::size_t i = 0; i < samples; ++i) {
      if (is_folded_) {
        const std::int64_t px =
            static_cast<std::int64_t>(wave_count_) * shifts_px_[i] % period + period;
        cosine_.push_back(period_cosine_[static_cast<std::size_t>(px % period)]);
        sine_.push_back(period_sine_[static_cast<std::size_t>(px % period)]);
      } else if (wave_count_ < 2) {
        cosine_.push_back(wave_count_ == 0 ? 1 : std::cos(angles_rad_[i]));
        sine_.push_back(wave_count_ == 0 ? 0 : std::sin(angles_rad_[i]));
      } else {
        const std::size_t first = samples + i, before = (wave_count_ - 1) * samples + i;
        cosine_.push_back(cosine_[before] * cosine_[first] - sine_[before] * sine_[first]);
        sine_.push_back(sine_[before] * cosine_[first] + cosine_[before] * sine_[first]);
      }
    }
}

std::span<const double> PixelModel::cosines(int n) {
  const std::size_t bin = fold_of(n).bin;
  grow_waves(bin + 1);
  return std::span(cosine_).subspan(bin * sample_count(), sample_count());
}

std::span<const double> PixelModel::sines(int n) {
  const std::size_t bin = fold_of(n).bin;
  grow_waves(bin + 1);
  return std::span(sine_).subspan(bin * sample_count(), sample_count());
}

std::complex<double> PixelModel::twice_factor(int n) const {
  if (batch_->factor_re.empty()) return 2;
  if (n >= batch_->factor_count) return 0;
  const auto row = static_cast<std::size_t>(n);
  if (batch_->has_shared_factors())
    return {2 * static_cast<double>(batch_->factor_re[row]),
            2 * static_cast<double>(batch_->factor_im[row])};
  return {2 * static_cast<double>(row_value(batch_->factor_re, row, batch_->stride, pixel_)),
          2 * static_cast<double>(row_value(batch_->factor_im, row, batch_->stride, pixel_))};
}

int PixelModel::most_harmonics() const {
  int most = kHarmonicsPerPx * problem_->shape.period_px;
  if (!batch_->factor_re.empty()) most = std::min(most, batch_->factor_count - 1);
  return most;
}

bool PixelModel::evaluate(ShapePoint shape, double phase_px, double tolerance, Harmonics harmonics,
                          ModelSamples& out) {
  if (!harmonics_.evaluate(*problem_, most_harmonics(), shape, tolerance, harmonics)) return false;
  fold_harmonics(phase_px);
  const std::size_t samples = sample_count();
  for (std::vector<double>* row : {&out.harmonics, &out.by_logit, &out.by_log, &out.by_phase})
    row->assign(samples, 0);
  double* __restrict value = out.harmonics.data();
  double* __restrict by_logit = out.by_logit.data();
  double* __restrict by_log = out.by_log.data();
  double* __restrict by_phase = out.by_phase.data();
  if (bins_.size() % 2 != 0) bins_.push_back(Bin{});
  grow_waves(bins_.size());
  // Two bins at a time: half as many sums to load and to store.
  for (std::size_t bin = 0; bin < bins_.size(); bin += 2) {
    const Bin g = bins_[bin], h = bins_[bin + 1];
    const double* __restrict cosine = cosine_.data() + bin * samples;
    const double* __restrict sine = sine_.data() + bin * samples;
    const double* __restrict next_cosine = cosine + samples;
    const double* __restrict next_sine = sine + samples;
    const auto sum = [&](std::size_t i, Part re, Part im) {
      return (g[re] * cosine[i] + g[im] * sine[i]) +
             (h[re] * next_cosine[i] + h[im] * next_sine[i]);
    };
    for (std::size_t i = 0; i < samples; ++i) {
      value[i] += sum(i, kValueRe, kValueIm);
      by_logit[i] += sum(i, kLogitRe, kLogitIm);
      by_log[i] += sum(i, kLogRe, kLogIm);
      by_phase[i] += sum(i, kPhaseRe, kPhaseIm);
    }
  }
  return true;
}

// Harmonics at this phase, by bins.
void PixelModel::fold_harmonics(double phase_px) {
  const std::size_t count = harmonics_.count();
  while (folds_.size() <= count) folds_.push_back(fold_of(static_cast<int>(folds_.size())));
  const auto half_period = static_cast<std::size_t>(problem_->shape.period_px / 2);
  const std::size_t bin_count = (is_folded_ ? std::min(count, half_period) : count) + 1;
  grow_waves(bin_count);
  bins_.assign(bin_count, Bin{});
  const double angle = origin_rad_ + wave_per_px_ * phase_px;
  const double turn_re = std::cos(angle), turn_im = std::sin(angle);
  double unit_re = turn_re, unit_im = turn_im;
  for (std::size_t i = 0; i < count; ++i) {
    const int n = static_cast<int>(i) + 1;
    const std::complex<double> factor = twice_factor(n);
    const Fold fold = folds_[i + 1];
    const double re = factor.real() * unit_re - factor.imag() * unit_im;
    const double im = fold.sign * (factor.real() * unit_im + factor.imag() * unit_re);
    const double value = harmonics_.value()[i], by_logit = harmonics_.by_logit()[i],
                 by_log = harmonics_.by_log()[i], wave = fold.sign * n * wave_per_px_ * value;
    Bin& bin = bins_[fold.bin];
    bin[kValueRe] += value * re;
    bin[kValueIm] += value * im;
    bin[kLogitRe] += by_logit * re;
    bin[kLogitIm] += by_logit * im;
    bin[kLogRe] += by_log * re;
    bin[kLogIm] += by_log * im;
    bin[kPhaseRe] -= wave * im;  // i n G, or its conjugate
    bin[kPhaseIm] += wave * re;
    const double next_re = unit_re * turn_re - unit_im * turn_im;
    unit_im = unit_re * turn_im + unit_im * turn_re;
    unit_re = next_re;
  }
}

bool PixelModel::expected_shift(ShapePoint shape, double phase_px, double tolerance,
                                Harmonics harmonics, const std::array<double, 10>& covariance,
                                std::vector<double>& out) {
  if (!harmonics_.evaluate(*problem_, most_harmonics(), shape, tolerance, harmonics) ||
      !harmonics_.evaluate_curvature(*problem_, shape))
    return false;
  const auto c = [&](std::size_t i, std::size_t j) { return covariance[covariance_index(i, j)]; };
  const std::size_t samples = sample_count();
  out.assign(samples, 0);
  fold_harmonics(phase_px);
  for (Bin& bin : bins_) bin[kValueRe] = bin[kValueIm] = 0;
  const std::complex<double> turn = std::polar(1.0, origin_rad_ + wave_per_px_ * phase_px);
  std::complex<double> unit = turn;
  for (std::size_t i = 0; i < harmonics_.count(); ++i) {
    const int n = static_cast<int>(i) + 1;
    const double wave = n * wave_per_px_;
    const std::complex<double> shift = {
        0.5 * (c(0, 0) * harmonics_.by_logit_twice()[i] + c(1, 1) * harmonics_.by_log_twice()[i] -
               wave * wave * c(3, 3) * harmonics_.value()[i]) +
            c(0, 1) * harmonics_.by_both()[i],
        wave * (c(0, 3) * harmonics_.by_logit()[i] + c(1, 3) * harmonics_.by_log()[i])};
    const std::complex<double> g = shift * twice_factor(n) * unit;
    const Fold fold = fold_of(n);
    bins_[fold.bin][kValueRe] += g.real();
    bins_[fold.bin][kValueIm] += fold.sign * g.imag();
    unit *= turn;
  }
  for (std::size_t bin = 0; bin < bins_.size(); ++bin)
    for (std::size_t k = 0; k < samples; ++k)
      out[k] += bins_[bin][kValueRe] * cosine_[bin * samples + k] +
                bins_[bin][kValueIm] * sine_[bin * samples + k];
  return true;
}

void PixelModel::choose_space(SampleSpace& space) {
  const int count = problem_->harmonic_count;
  if (count <= 0 || 2 * static_cast<std::size_t>(count) + 1 >= sample_count())
    return space.keep_all(sample_count());
  space.keep_mean(sample_count());
  for (int n = 1; n <= count; ++n) {
    space.keep_also(cosines(n));
    space.keep_also(sines(n));
  }
}

}  // namespace estimation
