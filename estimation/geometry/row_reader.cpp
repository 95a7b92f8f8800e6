#include "estimation/geometry/row_reader.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace estimation {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

bool is_pair(const BitSource& source) { return source.plain && source.inverse; }

bool lacks_partner(const AxisPlan& plan) {
  return !std::all_of(plan.bits.begin(), plan.bits.end(), is_pair);
}

bool needs_families(const AxisPlan& plan) { return plan.is_decodable && plan.bits.empty(); }

double px_per_rad(const FamilySource& source) {
  return source.family.period_px / (2 * std::numbers::pi);
}

}  // namespace

RowReader::RowReader(const PatternPlan& plan, const SignalSet& signals,
                     const CorrespondenceOptions& options)
    : plan_(plan),
      options_(options),
      signals_(signals),
      saturation_dn_(signals.saturation_dn),
      width_(static_cast<std::size_t>(signals.width_px)),
      is_unpaired_(lacks_partner(plan.column) || lacks_partner(plan.row)),
      is_told_by_bits_(!needs_families(plan.column) && !needs_families(plan.row)) {
  for (const MergedNoise& range : options.noise)
    ranges_.push_back({static_cast<float>(range.up_to_dn_per_us),
                       static_cast<float>(range.read_variance),
                       static_cast<float>(range.shot_dn_per_us)});
  for (const auto& [axis, rows] :
       {std::pair(&plan.column, &column_), std::pair(&plan.row, &row_)}) {
    rows->bit_value.assign(axis->bits.size(), Row(width_));
    rows->bit_variance.assign(axis->bits.size(), Row(width_));
    rows->families.assign(axis->families.size(),
                          {Row(width_), Row(width_), Row(width_), Row(width_), Row(width_)});
  }
}

void RowReader::read(int row) {
  signals_.open(row);
  lost_.assign(width_, 0);
  lit_begin_ = 0;
  lit_end_ = static_cast<int>(width_);
  read_bits(plan_.column, column_);
  read_bits(plan_.row, row_);
  if (!is_unpaired_ && is_told_by_bits_) find_lit();
  read_families(plan_.column, column_);
  read_families(plan_.row, row_);
  if (!is_unpaired_) return;
  // Bits without a partner may need the stripes' mean.
  read_midpoint();
  read_singles(plan_.column, column_);
  read_singles(plan_.row, row_);
}

bool RowReader::has_lost_readings(int col) const {
  const auto i = static_cast<std::size_t>(col);
  if (lost_[i] == 0) return false;
  for (const auto& [axis, rows] :
       {std::pair(&plan_.column, &column_), std::pair(&plan_.row, &row_)}) {
    if (!axis->is_decodable) continue;
    for (const Row& value : rows->bit_value)
      if (std::isnan(value[i])) return true;
    for (const FamilyRow& family : rows->families)
      if (!std::isfinite(family.sd_px[i])) return true;
  }
  return false;
}

float RowReader::variance_of(float signal) const {
  const float lit = std::max(signal, 0.0F);
  float variance = ranges_.back().read_variance + ranges_.back().shot_dn_per_us * lit;
  for (std::size_t i = ranges_.size() - 1; i-- > 0;) {
    const float below = ranges_[i].read_variance + ranges_[i].shot_dn_per_us * lit;
    variance = lit <= ranges_[i].up_to_dn_per_us ? below : variance;
  }
  return variance;
}

// --- Gray code ----------------------------------------------------------------------------------

// The pairs, and the clearest one's contrast, all along the row.
void RowReader::read_bits(const AxisPlan& plan, AxisRow& out) {
  out.contrast.assign(width_, 0);
  out.contrast_variance.assign(width_, 0);
  for (std::size_t j = 0; j < plan.bits.size(); ++j) {
    const BitSource& source = plan.bits[j];
    if (!is_pair(source)) continue;
    read_pair(signals_.at(*source.plain), signals_.at(*source.inverse), noise(), width_,
              {out.bit_value[j].data(), out.bit_variance[j].data(), out.contrast.data(),
               out.contrast_variance.data(), lost_.data()});
  }
}

void RowReader::read_singles(const AxisPlan& plan, AxisRow& out) {
  samples_.resize(width_);
  for (std::size_t j = 0; j < plan.bits.size(); ++j) {
    const BitSource& source = plan.bits[j];
    if (is_pair(source)) continue;
    signals_.copy(source.plain ? *source.plain : *source.inverse, samples_);
    const float sign = source.plain ? 1.0F : -1.0F;
    Row &value = out.bit_value[j], &variance = out.bit_variance[j];
    for (std::size_t col = 0; col < width_; ++col) {
      value[col] = 2 * sign * (samples_[col] - midpoint_[col]);
      variance[col] = 4 * variance_of(samples_[col]);
      lost_[col] += samples_[col] - samples_[col];
      if (std::isnan(samples_[col]) && !std::isnan(midpoint_[col])) value[col] = sign * kInfinity;
      const float contrast = std::abs(value[col]);
      if (!(contrast > out.contrast[col]) || !(contrast < kInfinity)) continue;
      out.contrast[col] = contrast;
      out.contrast_variance[col] = variance[col];
    }
  }
}

// Columns outside hold no pixel whose bits have a contrast.
void RowReader::find_lit() {
  const auto least = static_cast<float>(options_.min_modulation_sd * options_.min_modulation_sd);
  const auto is_lit = [&](std::size_t col) {
    const auto is_clear = [&](const AxisRow& rows) {
      return rows.contrast[col] * rows.contrast[col] > least * rows.contrast_variance[col];
    };
    // A pixel that lost samples may have no finite contrast.
    return is_clear(column_) || is_clear(row_) || lost_[col] != 0;
  };
  std::size_t begin = 0, end = width_;
  while (begin < width_ && !is_lit(begin)) ++begin;
  while (end > begin && !is_lit(end - 1)) --end;
  lit_begin_ = static_cast<int>(begin);
  lit_end_ = static_cast<int>(end);
}

// Half way between lit and dark, for bits without their inverse: from the pairs there are, else
// white and black, else the stripes' mean, else the bits themselves. Each pixel takes the first
// that it has not lost: single frames of a bracket may be missing, and the others saturated.
void RowReader::read_midpoint() {
  read_middle_of_pairs();
  if (plan_.white) {
    signals_.copy(*plan_.white, samples_);
    sums_ = samples_;
    if (plan_.black) {
      signals_.copy(*plan_.black, samples_);
      for (std::size_t col = 0; col < width_; ++col) sums_[col] += samples_[col];
    }
    for (std::size_t col = 0; col < width_; ++col)
      if (std::isnan(midpoint_[col])) midpoint_[col] = sums_[col] / 2;
  }
  for (const auto& [axis, rows] :
       {std::pair(&plan_.column, &column_), std::pair(&plan_.row, &row_)}) {
    if (axis->families.empty()) continue;
    const PhaseFamily& family = axis->families.front().family;
    const double lit_frac = family.width_px == 0 ? 0.5 : family.width_px / family.period_px;
    const auto per_mean = static_cast<float>(1 / (2 * lit_frac));
    for (auto col = static_cast<std::size_t>(lit_begin_); col < static_cast<std::size_t>(lit_end_);
         ++col)
      if (std::isnan(midpoint_[col])) midpoint_[col] = rows->families.front().mean[col] * per_mean;
  }
  read_middle_of_bits();
}

// The mean of the pairs that a pixel has both sides of; NaN where there is none.
void RowReader::read_middle_of_pairs() {
  midpoint_.assign(width_, 0);
  pair_count_.assign(width_, 0);
  samples_.resize(width_);
  sums_.resize(width_);
  for (const AxisPlan* axis : {&plan_.column, &plan_.row})
    for (const BitSource& source : axis->bits) {
      if (!is_pair(source)) continue;
      signals_.copy(*source.plain, samples_);
      signals_.copy(*source.inverse, sums_);
      for (std::size_t col = 0; col < width_; ++col) {
        const float sum = samples_[col] + sums_[col];
        if (std::isnan(sum)) continue;
        midpoint_[col] += sum / 2;
        pair_count_[col] += 1;
      }
    }
  for (std::size_t col = 0; col < width_; ++col) midpoint_[col] /= pair_count_[col];
}

// Half way between the least and the most that the bits without their inverse show: nearly every
// place is dark under some and lit under others.
void RowReader::read_middle_of_bits() {
  if (std::none_of(midpoint_.begin(), midpoint_.end(), [](float v) { return std::isnan(v); }))
    return;
  least_.assign(width_, kInfinity);
  most_.assign(width_, -kInfinity);
  for (const AxisPlan* axis : {&plan_.column, &plan_.row}) {
    for (const BitSource& source : axis->bits) {
      if (is_pair(source)) continue;
      signals_.copy(source.plain ? *source.plain : *source.inverse, samples_);
      for (std::size_t col = 0; col < width_; ++col) {
        least_[col] = std::min(least_[col], samples_[col]);  // in this order NaN is passed over
        most_[col] = std::max(most_[col], samples_[col]);
      }
    }
  }
  for (std::size_t col = 0; col < width_; ++col) {
    const bool is_seen = least_[col] <= most_[col];
    if (std::isnan(midpoint_[col]) && is_seen) midpoint_[col] = (least_[col] + most_[col]) / 2;
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
  const float across_sd = std::sqrt(std::max(across, 0.0F));
  const bool has_phase = amplitude > kMinAmplitudeSd * across_sd;
  const double noise_px = px_per_rad(source) * double{across_sd} / double{amplitude};
  const double angle_rad = std::atan2(double{phasor.sine}, double{phasor.cosine});
  out.sd_px[col] =
      has_phase ? static_cast<float>(std::hypot(noise_px, phasor.aliasing_px)) : kInfinity;
  out.position_px[col] =
      has_phase ? static_cast<float>(source.family.centre_px() + px_per_rad(source) * angle_rad)
                : kNaN;
}

// A pixel that lost some samples, from the others.
RowReader::Phasor RowReader::demodulate_partial(const FamilySource& source, std::size_t col) {
  std::vector<char> use;
  std::vector<float> samples;
  for (const std::size_t signal : source.signals) {
    samples.push_back(signals_.sample(signal, col));
    use.push_back(std::isnan(samples.back()) ? 0 : 1);
  }
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
    const float variance = variance_of(samples[i]);
    const float wc = weights->cosine[i], ws = weights->sine[i];
    phasor.mean += weights->mean[i] * samples[i];
    phasor.cosine += wc * samples[i];
    phasor.sine += ws * samples[i];
    phasor.cos_cos += wc * wc * variance;
    phasor.cos_sin += wc * ws * variance;
    phasor.sin_sin += ws * ws * variance;
  }
  return phasor;
}

void RowReader::read_families(const AxisPlan& plan, AxisRow& out) {
  for (std::size_t f = 0; f < plan.families.size(); ++f)
    read_family(plan.families[f], out.families[f]);
}

void RowReader::read_family(const FamilySource& source, FamilyRow& out) {
  shifts_.clear();
  for (const std::size_t signal : source.signals) shifts_.push_back(signals_.at(signal));
  const auto begin = static_cast<std::size_t>(lit_begin_), end = static_cast<std::size_t>(lit_end_);
  read_phases(
      shifts_, noise(),
      {source.weights.mean, source.weights.cosine, source.weights.sine,
       static_cast<float>(source.weights.aliasing_px),
       static_cast<float>(source.family.centre_px()), static_cast<float>(px_per_rad(source)),
       static_cast<float>(1 / source.amplitude_frac)},
      begin, end,
      {out.position_px.data(), out.sd_px.data(), out.modulation.data(), out.modulation_sd.data(),
       out.mean.data(), lost_.data()});
  for (std::size_t col = begin; col < end; ++col)
    if (std::isnan(out.mean[col])) store_phase(source, demodulate_partial(source, col), col, out);
}

}  // namespace estimation
