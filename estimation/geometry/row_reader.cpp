#include "estimation/geometry/row_reader.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace estimation {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();
// An amplitude below this many standard deviations has no phase worth the name.
constexpr float kMinAmplitudeSd = 3;

bool is_pair(const BitSource& source) { return !source.plain.empty() && !source.inverse.empty(); }

bool lacks_partner(const AxisPlan& plan) {
  return !std::all_of(plan.bits.begin(), plan.bits.end(), is_pair);
}

// Whether bits tell everywhere if the axis is lit.
bool needs_families(const AxisPlan& plan) { return plan.is_decodable && plan.bits.empty(); }

}  // namespace

RowReader::RowReader(const PatternPlan& plan, const CorrespondenceOptions& options)
    : plan_(plan), options_(options) {
  for (const MergedNoise& range : options.noise)
    noise_.push_back({static_cast<float>(range.up_to_dn_per_us),
                      static_cast<float>(range.read_variance),
                      static_cast<float>(range.shot_dn_per_us)});
  for (const AxisPlan* axis : {&plan.column, &plan.row}) {
    for (const BitSource& source : axis->bits)
      for (const auto& signal : {source.plain, source.inverse})
        if (!signal.empty()) signals_.push_back(signal);
    for (const FamilySource& source : axis->families)
      signals_.insert(signals_.end(), source.signals.begin(), source.signals.end());
  }
  for (const auto& signal : {plan.white, plan.black})
    if (!signal.empty()) signals_.push_back(signal);
  if (!signals_.empty()) width_ = static_cast<std::size_t>(signals_.front().width_px);
}

void RowReader::read(int row) {
  note_lost(row);
  const bool is_unpaired = lacks_partner(plan_.column) || lacks_partner(plan_.row);
  lit_begin_ = 0;
  lit_end_ = static_cast<int>(width_);
  // Bits without a partner may need the stripes' mean.
  if (is_unpaired) {
    read_families(plan_.column, row, column_);
    read_families(plan_.row, row, row_);
    read_midpoint(row);
  }
  find_contrast(plan_.column, row, column_);
  find_contrast(plan_.row, row, row_);
  const bool is_told_by_bits = !needs_families(plan_.column) && !needs_families(plan_.row);
  if (!is_unpaired && is_told_by_bits) find_lit();
  read_bits(plan_.column, row, column_);
  read_bits(plan_.row, row, row_);
  if (is_unpaired) return;
  read_families(plan_.column, row, column_);
  read_families(plan_.row, row, row_);
}

float RowReader::variance_of(float signal) const {
  const float lit = std::max(signal, 0.0F);
  float variance = noise_.back().read_variance + noise_.back().shot_dn_per_us * lit;
  for (std::size_t i = noise_.size() - 1; i-- > 0;) {
    const float below = noise_[i].read_variance + noise_[i].shot_dn_per_us * lit;
    variance = lit <= noise_[i].up_to_dn_per_us ? below : variance;
  }
  return variance;
}

// As variance_of, of samples [begin, end): loops that the compiler vectorises.
void RowReader::read_variance(const float* __restrict samples, std::size_t begin, std::size_t end,
                              float* __restrict variance) const {
  const NoiseRange last = noise_.back();
  for (std::size_t col = begin; col < end; ++col)
    variance[col] = last.read_variance + last.shot_dn_per_us * std::max(samples[col], 0.0F);
  for (std::size_t i = noise_.size() - 1; i-- > 0;) {
    const NoiseRange range = noise_[i];
    for (std::size_t col = begin; col < end; ++col) {
      const float lit = std::max(samples[col], 0.0F);
      const float below = range.read_variance + range.shot_dn_per_us * lit;
      variance[col] = lit <= range.up_to_dn_per_us ? below : variance[col];
    }
  }
}

void RowReader::note_lost(int row) {
  lost_.assign(width_, 0);
  float* __restrict lost = lost_.data();
  for (const auto& signal : signals_) {
    const float* __restrict samples = signal.row(row).data();
    for (std::size_t col = 0; col < width_; ++col) lost[col] += samples[col] - samples[col];
  }
  is_any_lost_ = std::any_of(lost_.begin(), lost_.end(), [](float sum) { return sum != 0; });
}

// --- Gray code ----------------------------------------------------------------------------------

// The clearest pair's contrast and its noise, all along the row.
void RowReader::find_contrast(const AxisPlan& plan, int row, AxisRow& out) {
  out.contrast.assign(width_, 0);
  least_.assign(width_, 0);  // the clearest pair's two samples
  most_.assign(width_, 0);
  float* __restrict best = out.contrast.data();
  float* __restrict best_plain = least_.data(), * __restrict best_inverse = most_.data();
  for (const BitSource& source : plan.bits) {
    if (!is_pair(source)) continue;
    const float* __restrict plain = source.plain.row(row).data();
    const float* __restrict inverse = source.inverse.row(row).data();
    for (std::size_t col = 0; col < width_; ++col) {
      const float contrast = std::abs(plain[col] - inverse[col]);
      const bool is_better = contrast > best[col];  // NaN is not
      best_plain[col] = is_better ? plain[col] : best_plain[col];
      best_inverse[col] = is_better ? inverse[col] : best_inverse[col];
      best[col] = is_better ? contrast : best[col];
    }
  }
  out.contrast_variance.resize(width_);
  scratch_.resize(width_);
  read_variance(best_plain, 0, width_, out.contrast_variance.data());
  read_variance(best_inverse, 0, width_, scratch_.data());
  for (std::size_t col = 0; col < width_; ++col) out.contrast_variance[col] += scratch_[col];
}

void RowReader::read_bits(const AxisPlan& plan, int row, AxisRow& out) {
  out.bit_value.resize(plan.bits.size());
  out.bit_variance.resize(plan.bits.size());
  for (std::size_t j = 0; j < plan.bits.size(); ++j) {
    Row &value = out.bit_value[j], &variance = out.bit_variance[j];
    value.resize(width_);
    variance.resize(width_);
    if (is_pair(plan.bits[j])) {
      read_pair(plan.bits[j], row, value, variance);
    } else {
      read_single(plan.bits[j], row, value, variance);
      for (std::size_t col = 0; col < width_; ++col) {
        const float contrast = std::abs(value[col]);
        if (!(contrast > out.contrast[col]) || !(contrast < kInfinity)) continue;
        out.contrast[col] = contrast;
        out.contrast_variance[col] = variance[col];
      }
    }
  }
}

void RowReader::read_single(const BitSource& source, int row, Row& value, Row& variance) {
  const bool has_plain = !source.plain.empty();
  const auto samples = has_plain ? source.plain.row(row) : source.inverse.row(row);
  const float sign = has_plain ? 1.0F : -1.0F;
  for (std::size_t col = 0; col < width_; ++col) {
    value[col] = 2 * sign * (samples[col] - midpoint_[col]);
    variance[col] = 4 * variance_of(samples[col]);
    if (std::isnan(samples[col]) && !std::isnan(midpoint_[col])) value[col] = sign * kInfinity;
  }
}

void RowReader::read_pair(const BitSource& source, int row, Row& value, Row& variance) {
  const auto begin = static_cast<std::size_t>(lit_begin_), end = static_cast<std::size_t>(lit_end_);
  const float* __restrict plain = source.plain.row(row).data();
  const float* __restrict inverse = source.inverse.row(row).data();
  float* __restrict difference = value.data(), * __restrict sum = variance.data();
  scratch_.resize(width_);
  const float* __restrict inverse_variance = scratch_.data();
  read_variance(plain, begin, end, sum);
  read_variance(inverse, begin, end, scratch_.data());
  for (std::size_t col = begin; col < end; ++col) {
    difference[col] = plain[col] - inverse[col];
    sum[col] += inverse_variance[col];
  }
  if (!is_any_lost_) return;
  for (std::size_t col = begin; col < end; ++col) {
    if (!std::isnan(value[col])) continue;
    // One of the two saturated: that one is lit.
    variance[col] = 0;
    if (!std::isnan(inverse[col])) value[col] = kInfinity;
    if (!std::isnan(plain[col])) value[col] = -kInfinity;
  }
}

// Columns outside hold no pixel whose bits have a contrast.
void RowReader::find_lit() {
  const auto least = static_cast<float>(options_.min_modulation_sd * options_.min_modulation_sd);
  const auto is_lit = [&](const AxisRow& rows, std::size_t col) {
    return rows.contrast[col] * rows.contrast[col] > least * rows.contrast_variance[col];
  };
  int begin = static_cast<int>(width_), end = 0;
  for (std::size_t col = 0; col < width_; ++col) {
    // A pixel that lost samples may have no finite contrast.
    if (!is_lit(column_, col) && !is_lit(row_, col) && lost_[col] == 0) continue;
    begin = std::min(begin, static_cast<int>(col));
    end = static_cast<int>(col) + 1;
  }
  lit_begin_ = std::min(begin, end);
  lit_end_ = end;
}

// Half way between lit and dark, for bits without their inverse: from the pairs there are, else
// white and black, else the stripes' mean, else the bits themselves.
void RowReader::read_midpoint(int row) {
  midpoint_.assign(width_, 0.0F);
  float pair_count = 0;
  for (const AxisPlan* axis : {&plan_.column, &plan_.row}) {
    for (const BitSource& source : axis->bits) {
      if (!is_pair(source)) continue;
      ++pair_count;
      const auto plain = source.plain.row(row), inverse = source.inverse.row(row);
      for (std::size_t col = 0; col < width_; ++col) midpoint_[col] += plain[col] + inverse[col];
    }
  }
  if (pair_count > 0) {
    for (float& value : midpoint_) value /= 2 * pair_count;
    return;
  }
  if (!plan_.white.empty()) {
    const auto white = plan_.white.row(row);
    for (std::size_t col = 0; col < width_; ++col) {
      const float black = plan_.black.empty() ? 0 : plan_.black.at(row, static_cast<int>(col));
      midpoint_[col] = (white[col] + black) / 2;
    }
    return;
  }
  for (const auto& [axis, rows] :
       {std::pair(&plan_.column, &column_), std::pair(&plan_.row, &row_)}) {
    if (axis->families.empty()) continue;
    const PhaseFamily& family = axis->families.front().family;
    const double lit_frac = family.width_px == 0 ? 0.5 : family.width_px / family.period_px;
    for (std::size_t col = 0; col < width_; ++col) {
      midpoint_[col] = rows->families.front().mean[col] / static_cast<float>(2 * lit_frac);
    }
    return;
  }
  read_middle_of_bits(row);
}

// Half way between the least and the most that the bits without their inverse show: nearly every
// place is dark under some and lit under others.
void RowReader::read_middle_of_bits(int row) {
  least_.assign(width_, kInfinity);
  most_.assign(width_, -kInfinity);
  for (const AxisPlan* axis : {&plan_.column, &plan_.row}) {
    for (const BitSource& source : axis->bits) {
      const auto samples = (source.plain.empty() ? source.inverse : source.plain).row(row);
      for (std::size_t col = 0; col < width_; ++col) {
        least_[col] = std::min(least_[col], samples[col]);  // in this order NaN is passed over
        most_[col] = std::max(most_[col], samples[col]);
      }
    }
  }
  for (std::size_t col = 0; col < width_; ++col) {
    const bool is_seen = least_[col] <= most_[col];
    midpoint_[col] = is_seen ? (least_[col] + most_[col]) / 2 : kNaN;
  }
}

// --- phases -------------------------------------------------------------------------------------

void RowReader::store_phase(const FamilySource& source, const Phasor& phasor, std::size_t col,
                            FamilyRow& out) {
  const float amplitude = std::sqrt(phasor.cosine * phasor.cosine + phasor.sine * phasor.sine);
  const float scale = 1.0F / static_cast<float>(source.amplitude_frac);
  const float c = phasor.cosine / amplitude, s = phasor.sine / amplitude;
  const float along = c * c * phasor.cos_cos + 2 * c * s * phasor.cos_sin + s * s * phasor.sin_sin;
  const float across = s * s * phasor.cos_cos - 2 * c * s * phasor.cos_sin + c * c * phasor.sin_sin;
  out.mean[col] = phasor.mean;
  out.modulation[col] = amplitude * scale;
  out.modulation_sd[col] = std::sqrt(std::max(along, 0.0F)) * scale;
  const double px_per_rad = source.family.period_px / (2 * std::numbers::pi);
  const float across_sd = std::sqrt(std::max(across, 0.0F));
  const bool has_phase = amplitude > kMinAmplitudeSd * across_sd;
  const double noise_px = px_per_rad * double{across_sd} / double{amplitude};
  const double variance_px2 = noise_px * noise_px + phasor.aliasing_px * phasor.aliasing_px;
  out.sd_px[col] = has_phase ? static_cast<float>(std::sqrt(variance_px2)) : kInfinity;
  out.position_px[col] =
      has_phase
          ? static_cast<float>(source.family.centre_px() +
                               px_per_rad * std::atan2(double{phasor.sine}, double{phasor.cosine}))
          : kNaN;
}

// A pixel that lost some samples, from the others.
RowReader::Phasor RowReader::demodulate_partial(const FamilySource& source, int row, int col) {
  std::vector<char> use;
  for (const auto& signal : source.signals) use.push_back(std::isnan(signal.at(row, col)) ? 0 : 1);
  auto& weights = partial_[{&source, use}];
  const bool is_new = !weights && std::count(use.begin(), use.end(), 1) >= 3;
  if (is_new) weights = make_demodulation(source.family, use, options_.least_blur_px);
  Phasor phasor;
  phasor.mean = kNaN;
  if (!weights) return phasor;
  phasor.mean = 0;
  phasor.aliasing_px = weights->aliasing_px;
  for (std::size_t i = 0; i < use.size(); ++i) {
    if (!use[i]) continue;
    const float sample = source.signals[i].at(row, col);
    const float variance = variance_of(sample);
    const float wc = weights->cosine[i], ws = weights->sine[i];
    phasor.mean += weights->mean[i] * sample;
    phasor.cosine += wc * sample;
    phasor.sine += ws * sample;
    phasor.cos_cos += wc * wc * variance;
    phasor.cos_sin += wc * ws * variance;
    phasor.sin_sin += ws * ws * variance;
  }
  return phasor;
}

void RowReader::read_families(const AxisPlan& plan, int row, AxisRow& out) {
  out.families.resize(plan.families.size());
  for (std::size_t f = 0; f < plan.families.size(); ++f)
    read_family(plan.families[f], row, out.families[f]);
}

void RowReader::read_family(const FamilySource& source, int row, FamilyRow& out) {
  for (Row* values : {&out.position_px, &out.sd_px, &out.modulation, &out.modulation_sd})
    values->resize(width_);
  for (Row* sums : {&out.mean, &cosine_, &sine_, &cos_cos_, &cos_sin_, &sin_sin_})
    sums->assign(width_, 0);
  const auto begin = static_cast<std::size_t>(lit_begin_), end = static_cast<std::size_t>(lit_end_);
  float* __restrict mean = out.mean.data(), * __restrict cosine = cosine_.data();
  float* __restrict sine = sine_.data(), * __restrict cos_cos = cos_cos_.data();
  float* __restrict cos_sin = cos_sin_.data(), * __restrict sin_sin = sin_sin_.data();
  scratch_.resize(width_);
  const float* __restrict variance = scratch_.data();
  for (std::size_t i = 0; i < source.signals.size(); ++i) {
    const float* __restrict samples = source.signals[i].row(row).data();
    const float wm = source.weights.mean[i];
    const float wc = source.weights.cosine[i], ws = source.weights.sine[i];
    const float cc = wc * wc, cs = wc * ws, ss = ws * ws;
    read_variance(samples, begin, end, scratch_.data());
    for (std::size_t col = begin; col < end; ++col) {
      mean[col] += wm * samples[col];
      cosine[col] += wc * samples[col];
      sine[col] += ws * samples[col];
      cos_cos[col] += cc * variance[col];
      cos_sin[col] += cs * variance[col];
      sin_sin[col] += ss * variance[col];
    }
  }
  for (std::size_t col = begin; col < end; ++col) {
    const bool is_whole = cosine[col] == cosine[col];
    store_phase(source,
                is_whole ? Phasor{mean[col], cosine[col], sine[col], cos_cos[col], cos_sin[col],
                                  sin_sin[col], source.weights.aliasing_px}
                         : demodulate_partial(source, row, static_cast<int>(col)),
                col, out);
  }
}

}  // namespace estimation
