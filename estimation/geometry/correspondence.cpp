#include "estimation/geometry/correspondence.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <optional>
#include <utility>

#include "estimation/base/check.h"
#include "estimation/geometry/pattern_plan.h"
#include "estimation/geometry/support.h"

namespace estimation {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();
// An amplitude below this many standard deviations has no phase worth the name.
constexpr float kMinAmplitudeSd = 3;
// Two phases of one pixel agree within this many standard deviations plus the slack, or are not
// combined; light that enters obliquely comes out shifted by up to a px.
constexpr double kAgreementSd = 4;
constexpr double kAgreementSlackPx = 1;
// No phase counts as better than this, whatever the noise options say.
constexpr double kLeastSdPx = 1e-3;

using Row = std::vector<float>;

// MergedNoise in single precision, for the inner loops.
struct NoiseRange {
  float up_to_dn_per_us = 0, read_variance = 0, shot_dn_per_us = 0;
};

std::vector<NoiseRange> single_precision(std::span<const MergedNoise> noise) {
  std::vector<NoiseRange> ranges;
  for (const MergedNoise& range : noise) {
    ranges.push_back({static_cast<float>(range.up_to_dn_per_us),
                      static_cast<float>(range.read_variance),
                      static_cast<float>(range.shot_dn_per_us)});
  }
  return ranges;
}

float variance_of(std::span<const NoiseRange> noise, float signal) {
  const float lit = std::max(signal, 0.0F);
  float variance = noise.back().read_variance + noise.back().shot_dn_per_us * lit;
  for (std::size_t i = noise.size() - 1; i-- > 0;) {
    const float below = noise[i].read_variance + noise[i].shot_dn_per_us * lit;
    variance = lit <= noise[i].up_to_dn_per_us ? below : variance;
  }
  return variance;
}

// One phase family along one image row.
struct FamilyRow {
  Row position_px, sd_px;         // modulo the period; NaN, infinity: no phase
  Row modulation, modulation_sd;  // white minus black as the amplitude tells, DN/us
  Row mean;
};

// One axis along one image row.
struct AxisRow {
  std::vector<Row> bit_value, bit_variance;  // [bit] lit minus dark, DN/us; infinite: one saturated
  std::vector<FamilyRow> families;
};

// Scratch of one worker.
struct Workspace {
  std::span<const NoiseRange> noise;
  AxisRow column, row;
  Row midpoint;
  Row cosine, sine, cos_cos, cos_sin, sin_sin;
  std::vector<float> scores;
  std::vector<BitReading> bits;
  std::vector<PhaseReading> phases;
  std::vector<std::size_t> usable;
  // Weights for pixels that lost samples, by family and used shifts.
  std::map<std::pair<const FamilySource*, std::vector<char>>, std::optional<Demodulation>> partial;
};

// --- phases -------------------------------------------------------------------------------------

struct Phasor {
  float mean = 0, cosine = 0, sine = 0;
  float cos_cos = 0, cos_sin = 0, sin_sin = 0;  // covariance of cosine and sine
  double aliasing_px = 0;
};

void store_phase(const FamilySource& source, const Phasor& phasor, std::size_t col,
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
  const bool has_phase = amplitude > kMinAmplitudeSd * std::sqrt(std::max(across, 0.0F));
  const double noise_px =
      px_per_rad * std::sqrt(static_cast<double>(std::max(across, 0.0F))) / double{amplitude};
  out.sd_px[col] =
      has_phase ? static_cast<float>(std::hypot(noise_px, phasor.aliasing_px)) : kInfinity;
  out.position_px[col] =
      has_phase
          ? static_cast<float>(source.family.centre_px() +
                               px_per_rad * std::atan2(double{phasor.sine}, double{phasor.cosine}))
          : kNaN;
}

// A pixel that lost some samples, from the others.
Phasor demodulate_partial(const FamilySource& source, int row, int col,
                          const CorrespondenceOptions& options, Workspace& work) {
  std::vector<char> use;
  for (const auto& signal : source.signals) use.push_back(std::isnan(signal.at(row, col)) ? 0 : 1);
  auto& weights = work.partial[{&source, use}];
  const bool is_new = !weights && std::count(use.begin(), use.end(), 1) >= 3;
  if (is_new) weights = make_demodulation(source.family, use, options.least_blur_px);
  Phasor phasor;
  phasor.mean = kNaN;
  if (!weights) return phasor;
  phasor.mean = 0;
  phasor.aliasing_px = weights->aliasing_px;
  for (std::size_t i = 0; i < use.size(); ++i) {
    if (!use[i]) continue;
    const float sample = source.signals[i].at(row, col);
    const float variance = variance_of(work.noise, sample);
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

void read_family(const FamilySource& source, int row, const CorrespondenceOptions& options,
                 Workspace& work, FamilyRow& out) {
  const auto width = static_cast<std::size_t>(source.signals[0].width_px);
  for (Row* values : {&out.position_px, &out.sd_px, &out.modulation, &out.modulation_sd}) {
    values->resize(width);
  }
  for (Row* sums :
       {&out.mean, &work.cosine, &work.sine, &work.cos_cos, &work.cos_sin, &work.sin_sin}) {
    sums->assign(width, 0);
  }
  for (std::size_t i = 0; i < source.signals.size(); ++i) {
    const auto samples = source.signals[i].row(row);
    const float wm = source.weights.mean[i];
    const float wc = source.weights.cosine[i], ws = source.weights.sine[i];
    for (std::size_t col = 0; col < width; ++col) {
      const float sample = samples[col];
      const float variance = variance_of(work.noise, sample);
      out.mean[col] += wm * sample;
      work.cosine[col] += wc * sample;
      work.sine[col] += ws * sample;
      work.cos_cos[col] += wc * wc * variance;
      work.cos_sin[col] += wc * ws * variance;
      work.sin_sin[col] += ws * ws * variance;
    }
  }
  for (std::size_t col = 0; col < width; ++col) {
    if (std::isnan(work.cosine[col])) {
      store_phase(source, demodulate_partial(source, row, static_cast<int>(col), options, work),
                  col, out);
    } else {
      store_phase(source,
                  {out.mean[col], work.cosine[col], work.sine[col], work.cos_cos[col],
                   work.cos_sin[col], work.sin_sin[col], source.weights.aliasing_px},
                  col, out);
    }
  }
}

// --- Gray code ----------------------------------------------------------------------------------

bool lacks_partner(const AxisPlan& plan) {
  return std::any_of(plan.bits.begin(), plan.bits.end(), [](const BitSource& source) {
    return source.plain.empty() != source.inverse.empty();
  });
}

// Half way between the least and the most that the bits without their inverse show: nearly every
// place is dark under some and lit under others.
void read_middle_of_bits(const PatternPlan& plan, int row, Row& midpoint) {
  const std::size_t width = midpoint.size();
  Row least(width, kInfinity), most(width, -kInfinity);
  for (const AxisPlan* axis : {&plan.column, &plan.row}) {
    for (const BitSource& source : axis->bits) {
      const auto samples = (source.plain.empty() ? source.inverse : source.plain).row(row);
      for (std::size_t col = 0; col < width; ++col) {
        least[col] = std::min(least[col], samples[col]);  // in this order NaN is passed over
        most[col] = std::max(most[col], samples[col]);
      }
    }
  }
  for (std::size_t col = 0; col < width; ++col) {
    const bool is_seen = least[col] <= most[col];
    midpoint[col] = is_seen ? (least[col] + most[col]) / 2 : kNaN;
  }
}

// Half way between lit and dark, for bits without their inverse: from the pairs there are, else
// white and black, else the stripes' mean, else the bits themselves.
void read_midpoint(const PatternPlan& plan, int row, const Workspace& work, Row& midpoint) {
  const std::size_t width = midpoint.size();
  std::fill(midpoint.begin(), midpoint.end(), 0.0F);
  float pair_count = 0;
  for (const AxisPlan* axis : {&plan.column, &plan.row}) {
    for (const BitSource& source : axis->bits) {
      if (source.plain.empty() || source.inverse.empty()) continue;
      ++pair_count;
      const auto plain = source.plain.row(row), inverse = source.inverse.row(row);
      for (std::size_t col = 0; col < width; ++col) midpoint[col] += plain[col] + inverse[col];
    }
  }
  if (pair_count > 0) {
    for (float& value : midpoint) value /= 2 * pair_count;
    return;
  }
  if (!plan.white.empty()) {
    const auto white = plan.white.row(row);
    for (std::size_t col = 0; col < width; ++col) {
      const float black = plan.black.empty() ? 0 : plan.black.at(row, static_cast<int>(col));
      midpoint[col] = (white[col] + black) / 2;
    }
    return;
  }
  for (const auto& [axis, rows] :
       {std::pair(&plan.column, &work.column), std::pair(&plan.row, &work.row)}) {
    if (axis->families.empty()) continue;
    const PhaseFamily& family = axis->families.front().family;
    const double lit_frac = family.width_px == 0 ? 0.5 : family.width_px / family.period_px;
    for (std::size_t col = 0; col < width; ++col) {
      midpoint[col] = rows->families.front().mean[col] / static_cast<float>(2 * lit_frac);
    }
    return;
  }
  read_middle_of_bits(plan, row, midpoint);
}

void read_bit(const BitSource& source, int row, std::span<const NoiseRange> noise,
              const Row& midpoint, Row& value, Row& variance) {
  const bool has_plain = !source.plain.empty(), has_inverse = !source.inverse.empty();
  const auto width =
      static_cast<std::size_t>(has_plain ? source.plain.width_px : source.inverse.width_px);
  value.resize(width);
  variance.resize(width);
  if (has_plain && has_inverse) {
    const auto plain = source.plain.row(row), inverse = source.inverse.row(row);
    for (std::size_t col = 0; col < width; ++col) {
      value[col] = plain[col] - inverse[col];
      variance[col] = variance_of(noise, plain[col]) + variance_of(noise, inverse[col]);
      if (!std::isnan(value[col])) continue;
      // One of the two saturated: that one is lit.
      variance[col] = 0;
      if (!std::isnan(inverse[col])) value[col] = kInfinity;
      if (!std::isnan(plain[col])) value[col] = -kInfinity;
    }
    return;
  }
  const auto samples = has_plain ? source.plain.row(row) : source.inverse.row(row);
  const float sign = has_plain ? 1.0F : -1.0F;
  for (std::size_t col = 0; col < width; ++col) {
    value[col] = 2 * sign * (samples[col] - midpoint[col]);
    variance[col] = 4 * variance_of(noise, samples[col]);
    if (std::isnan(samples[col]) && !std::isnan(midpoint[col])) value[col] = sign * kInfinity;
  }
}

// --- one pixel ----------------------------------------------------------------------------------

struct Modulation {
  float value = 0, sd = 0;
};

// White minus black: the clearest bit's contrast, or what the stripes' amplitude says.
Modulation find_modulation(const AxisRow& rows, std::size_t col) {
  Modulation best;
  for (std::size_t j = 0; j < rows.bit_value.size(); ++j) {
    const float contrast = std::abs(rows.bit_value[j][col]);
    if (contrast > best.value && std::isfinite(contrast)) {
      best = {contrast, std::sqrt(rows.bit_variance[j][col])};
    }
  }
  if (best.value > 0) return best;
  for (const FamilyRow& family : rows.families) {
    const float modulation = family.modulation[col];
    if (modulation > best.value) best = {modulation, family.modulation_sd[col]};
  }
  return best;
}

struct Decoded {
  float position_px = kNaN, sd_px = kNaN;
  std::uint32_t error = 0;
};

// Whole columns, or runs of them where the lowest bits are missing or lost in noise.
Decoded decode_gray_alone(const AxisPlan& plan, std::span<const BitReading> bits) {
  int low = static_cast<int>(std::bit_width(static_cast<unsigned>(plan.size_px - 1)));
  unsigned code = 0;
  unsigned previous = 0;
  for (std::size_t j = 0; j < bits.size(); ++j) {
    if (plan.bits[j].bit >= low) continue;  // beyond the projector: always dark
    if (plan.bits[j].bit != low - 1 || !std::isfinite(bits[j].variance)) break;
    const bool is_clear = bits[j].value * bits[j].value > 9 * bits[j].variance;
    if (!is_clear && j + 1 == bits.size()) break;
    previous ^= bits[j].value > 0 ? 1U : 0U;
    code = 2 * code + previous;
    --low;
  }
  const double run_px = std::ldexp(1.0, low);
  const double position_px = (code + 0.5) * run_px - 0.5;
  // Half the bits or more must be there, or the position is no coarse column but a guess.
  if (run_px * run_px > plan.size_px || position_px > plan.size_px) {
    return {kNaN, kNaN, kNoCorrespondence};
  }
  return {static_cast<float>(position_px), static_cast<float>(run_px / std::sqrt(12.0)), 0};
}

// The phases unwrapped next to `position_px` and averaged by inverse variance. A contradiction by
// more than a quarter of a period means that one of them has the wrong period.
Decoded combine_phases(double position_px, std::span<const PhaseReading> phases) {
  double weights = 0, sum = 0;
  const double primary_sd_px = double{phases.front().sd_px};
  for (const PhaseReading& phase : phases) {
    const double period_px = double{phase.period_px};
    const double residual_px = std::remainder(double{phase.position_px} - position_px, period_px);
    const double sd_px = std::hypot(double{phase.sd_px}, kLeastSdPx);
    const double agreement_px = kAgreementSd * std::hypot(sd_px, primary_sd_px) + kAgreementSlackPx;
    if (std::abs(residual_px) > agreement_px) {
      if (std::abs(residual_px) > period_px / 4) return {kNaN, kNaN, kNoCorrespondence};
      continue;
    }
    const double weight = 1 / (sd_px * sd_px);
    weights += weight;
    sum += weight * residual_px;
  }
  return {static_cast<float>(position_px + sum / weights),
          static_cast<float>(1 / std::sqrt(weights)), 0};
}

// The readings of one pixel, the surest phase first; into work.bits, work.phases, work.usable.
void take_readings(const AxisPlan& plan, const AxisRow& rows, std::size_t col,
                   const Modulation& modulation, Workspace& work) {
  work.bits.clear();
  for (std::size_t j = 0; j < plan.bits.size(); ++j) {
    const float value = rows.bit_value[j][col] / modulation.value;
    const float variance = rows.bit_variance[j][col] / (modulation.value * modulation.value);
    const bool is_read = !std::isnan(value);
    if (is_read) {
      work.bits.push_back({std::clamp(value, -1.0F, 1.0F), variance});
    } else {
      work.bits.push_back({0.0F, kInfinity});
    }
  }
  work.usable.clear();
  for (std::size_t f = 0; f < plan.families.size(); ++f) {
    if (std::isfinite(rows.families[f].sd_px[col])) work.usable.push_back(f);
  }
  // By insertion: there are two or three, and std::stable_sort would allocate.
  const std::vector<FamilyRow>& families = rows.families;
  for (std::size_t i = 1; i < work.usable.size(); ++i) {
    for (std::size_t j = i; j > 0; --j) {
      std::size_t &before = work.usable[j - 1], &after = work.usable[j];
      if (families[before].sd_px[col] <= families[after].sd_px[col]) break;
      std::swap(before, after);
    }
  }
  work.phases.clear();
  for (const std::size_t f : work.usable) {
    work.phases.push_back({static_cast<float>(plan.families[f].family.period_px),
                           rows.families[f].position_px[col], rows.families[f].sd_px[col]});
  }
}

Decoded decode_axis(const AxisPlan& plan, const AxisRow& rows, std::size_t col,
                    const CorrespondenceOptions& options, Workspace& work, float& modulation_out) {
  const Modulation modulation = find_modulation(rows, col);
  modulation_out = modulation.value;
  if (!(modulation.value > static_cast<float>(options.min_modulation_sd) * modulation.sd)) {
    return {kNaN, kNaN, kBackground};
  }
  take_readings(plan, rows, col, modulation, work);
  if (work.phases.empty()) {
    if (plan.bits.empty()) return {kNaN, kNaN, kTooDark};
    return decode_gray_alone(plan, work.bits);
  }
  const std::span<const PhaseReading> phases(work.phases);
  if (double{phases.front().sd_px} > options.max_sd_px) return {kNaN, kNaN, kTooDark};
  const PeriodChoice choice = plan.families[work.usable.front()].chooser.choose(
      phases.front(), work.bits, phases.subspan(1), work.scores);
  if (choice.margin < options.min_period_margin) return {kNaN, kNaN, kNoCorrespondence};
  return combine_phases(choice.position_px, phases);
}

// --- the image ----------------------------------------------------------------------------------

class Decoder {
 public:
  Decoder(const PatternPlan& plan, const ProjectorInfo& projector,
          const CorrespondenceOptions& options, std::span<const PatternSignal> signals,
          Correspondence& out)
      : plan_(plan),
        projector_(projector),
        options_(options),
        noise_(single_precision(options.noise)),
        signals_(signals),
        out_(out) {
    const ImageView<const float>& signal = signals[0].signal;
    out.validity = Image<std::uint32_t>(signal.height_px, signal.width_px);
    modulation_ = Image<float>(signal.height_px, signal.width_px);
    for (const auto& [axis, position, sd] :
         {std::tuple(&plan.column, &out.column_px, &out.column_sd_px),
          std::tuple(&plan.row, &out.row_px, &out.row_sd_px)}) {
      if (!axis->is_decodable) continue;
      *position = Image<float>(signal.height_px, signal.width_px, 1, kNaN);
      *sd = Image<float>(signal.height_px, signal.width_px, 1, kNaN);
    }
  }

  void decode_rows(int begin, int end) {
    Workspace& work = workspaces_.local();
    work.noise = noise_;
    for (int row = begin; row < end; ++row) {
      read_axis_phases(plan_.column, row, work, work.column);
      read_axis_phases(plan_.row, row, work, work.row);
      work.midpoint.resize(static_cast<std::size_t>(out_.validity.width_px()));
      if (lacks_partner(plan_.column) || lacks_partner(plan_.row)) {
        read_midpoint(plan_, row, work, work.midpoint);
      }
      read_axis_bits(plan_.column, row, work.midpoint, work.column);
      read_axis_bits(plan_.row, row, work.midpoint, work.row);
      for (int col = 0; col < out_.validity.width_px(); ++col) decode_pixel(row, col, work);
    }
  }

  // Stray light: lit so weakly beside the rest that it is not the subject.
  void reject_stray_light() {
    std::vector<float> values;
    for (const float value : modulation_.samples()) {
      if (value > 0) values.push_back(value);
    }
    if (values.empty()) return;
    const auto rank = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 99 / 100);
    std::nth_element(values.begin(), rank, values.end());
    const float least = static_cast<float>(options_.min_modulation_frac) * *rank;
    for (std::size_t i = 0; i < modulation_.samples().size(); ++i) {
      if (modulation_.samples()[i] < least) out_.validity.samples()[i] |= kBackground;
    }
  }

 private:
  void read_axis_phases(const AxisPlan& plan, int row, Workspace& work, AxisRow& rows) const {
    rows.families.resize(plan.families.size());
    for (std::size_t f = 0; f < plan.families.size(); ++f) {
      read_family(plan.families[f], row, options_, work, rows.families[f]);
    }
  }

  void read_axis_bits(const AxisPlan& plan, int row, const Row& midpoint, AxisRow& rows) const {
    rows.bit_value.resize(plan.bits.size());
    rows.bit_variance.resize(plan.bits.size());
    for (std::size_t j = 0; j < plan.bits.size(); ++j) {
      read_bit(plan.bits[j], row, noise_, midpoint, rows.bit_value[j], rows.bit_variance[j]);
    }
  }

  bool lost_samples(int row, int col) const {
    return std::any_of(signals_.begin(), signals_.end(), [&](const PatternSignal& signal) {
      return std::isnan(signal.signal.at(row, col));
    });
  }

  void decode_pixel(int row, int col, Workspace& work) {
    const auto i = static_cast<std::size_t>(col);
    Decoded column, line;
    float modulation = 0;
    if (plan_.column.is_decodable) {
      column = decode_axis(plan_.column, work.column, i, options_, work, modulation);
      modulation_.at(row, col) = modulation;
      out_.column_px.at(row, col) = column.position_px;
      out_.column_sd_px.at(row, col) = column.sd_px;
    }
    if (plan_.row.is_decodable) {
      line = decode_axis(plan_.row, work.row, i, options_, work, modulation);
      modulation_.at(row, col) = std::max(modulation, modulation_.at(row, col));
      out_.row_px.at(row, col) = line.position_px;
      out_.row_sd_px.at(row, col) = line.sd_px;
    }
    std::uint32_t error = column.error | line.error;
    if (in_sync_square(column.position_px, line.position_px)) error |= kNoCorrespondence;
    if (error != 0 && lost_samples(row, col)) error = kSaturated;
    out_.validity.at(row, col) = error;
  }

  bool in_sync_square(float column_px, float row_px) const {
    if (!projector_.sync_square || std::isnan(column_px) || std::isnan(row_px)) return false;
    return projector_.sync_square->contains(static_cast<int>(std::lround(row_px)),
                                            static_cast<int>(std::lround(column_px)));
  }

  const PatternPlan& plan_;
  const ProjectorInfo& projector_;
  const CorrespondenceOptions& options_;
  std::vector<NoiseRange> noise_;
  std::span<const PatternSignal> signals_;
  Correspondence& out_;
  Image<float> modulation_;
  oneapi::tbb::enumerable_thread_specific<Workspace> workspaces_;
};

void reject_unsupported(double min_support_frac, Correspondence& out) {
  for (const Image<float>* position : {&out.column_px, &out.row_px}) {
    if (position->empty()) continue;
    const Image<unsigned char> supported = find_supported(position->view(), min_support_frac);
    for (std::size_t i = 0; i < supported.samples().size(); ++i) {
      const bool is_lost = out.validity.samples()[i] == 0 && supported.samples()[i] == 0;
      if (is_lost) out.validity.samples()[i] = kNoCorrespondence;
    }
  }
}

void blank_invalid(Correspondence& out) {
  for (Image<float>* image : {&out.column_px, &out.row_px, &out.column_sd_px, &out.row_sd_px}) {
    for (std::size_t i = 0; i < image->samples().size(); ++i) {
      if (out.validity.samples()[i] != 0) image->samples()[i] = kNaN;
    }
  }
}

}  // namespace

Correspondence decode_correspondence(std::span<const PatternSignal> signals,
                                     const ProjectorInfo& projector,
                                     const CorrespondenceOptions& options) {
  check(!signals.empty(), "correspondence of no signals");
  check(!options.noise.empty(), "correspondence without a noise range");
  for (const PatternSignal& signal : signals) {
    check(signal.signal.height_px == signals[0].signal.height_px &&
              signal.signal.width_px == signals[0].signal.width_px &&
              signal.signal.channel_count == 1,
          "signals of different sizes");
  }
  Correspondence out;
  PatternPlan plan = plan_patterns(signals, projector, options);
  out.notes = std::move(plan.notes);
  Decoder decoder(plan, projector, options, signals, out);
  const auto rows = oneapi::tbb::blocked_range<int>(0, out.validity.height_px(), 8);
  oneapi::tbb::parallel_for(rows, [&](const oneapi::tbb::blocked_range<int>& range) {
    decoder.decode_rows(range.begin(), range.end());
  });
  decoder.reject_stray_light();
  blank_invalid(out);
  reject_unsupported(options.min_support_frac, out);
  blank_invalid(out);
  if (!plan.column.is_decodable && !plan.row.is_decodable) {
    std::fill(out.validity.samples().begin(), out.validity.samples().end(), kNoCorrespondence);
  }
  return out;
}

}  // namespace estimation
