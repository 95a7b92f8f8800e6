#include "estimation/geometry/correspondence.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "estimation/base/check.h"
#include "estimation/geometry/clear_pixels.h"
#include "estimation/geometry/combining.h"
#include "estimation/geometry/pattern_plan.h"
#include "estimation/geometry/row_reader.h"
#include "estimation/geometry/signal_rows.h"
#include "estimation/geometry/support.h"

namespace estimation {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();
// Scratch of one worker.
struct Workspace {
  RowReader reader;
  std::vector<float> scores = {};
  std::vector<BitReading> bits = {};
  std::vector<PhaseReading> phases = {};
  std::vector<std::size_t> usable = {};
  std::vector<std::uint32_t> column_errors = {}, row_errors = {};  // [col]
};

// --- one pixel ----------------------------------------------------------------------------------

struct Modulation {
  float value = 0, sd = 0;
};

// White minus black: the clearest bit's contrast, or what the stripes' amplitude says.
Modulation find_modulation(const AxisRow& rows, std::size_t col) {
  Modulation best;
  if (rows.contrast[col] > 0) return {rows.contrast[col], std::sqrt(rows.contrast_variance[col])};
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
    const double sd_px = std::hypot(double{phase.sd_px}, double{kLeastSdPx});
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

// One axis of the result.
struct AxisImages {
  const AxisPlan& plan;
  Image<float>& position_px;
  Image<float>& sd_px;
  std::optional<ClearCode> clear_code;
};

class Decoder {
 public:
  Decoder(const PatternPlan& plan, const SignalSet& signals, const ProjectorInfo& projector,
          const CorrespondenceOptions& options, Correspondence& out)
      : projector_(projector),
        options_(options),
        column_{plan.column, out.column_px, out.column_sd_px, find_clear_code(plan.column)},
        row_{plan.row, out.row_px, out.row_sd_px, find_clear_code(plan.row)},
        out_(out),
        workspaces_(
            [&plan, &signals, &options] { return Workspace{RowReader(plan, signals, options)}; }) {
    out.validity = Image<std::uint32_t>(signals.height_px, signals.width_px);
    out.modulation_dn_per_us = Image<float>(signals.height_px, signals.width_px);
    for (AxisImages* axis : {&column_, &row_}) {
      if (!axis->plan.is_decodable) continue;
      axis->position_px = Image<float>(signals.height_px, signals.width_px, 1, kNaN);
      axis->sd_px = Image<float>(signals.height_px, signals.width_px, 1, kNaN);
    }
  }

  void decode_rows(int begin, int end) {
    Workspace& work = workspaces_.local();
    for (int row = begin; row < end; ++row) {
      work.reader.read(row);
      const int lit_begin = work.reader.lit_begin(), lit_end = work.reader.lit_end();
      const std::uint32_t unlit =
          column_.plan.is_decodable || row_.plan.is_decodable ? std::uint32_t{kBackground} : 0U;
      const std::span<std::uint32_t> validity = out_.validity.view().row(row);
      std::fill(validity.begin(), validity.begin() + lit_begin, unlit);
      std::fill(validity.begin() + lit_end, validity.end(), unlit);
      decode_axis_row(column_, work.reader.column(), row, work.column_errors, work);
      decode_axis_row(row_, work.reader.row(), row, work.row_errors, work);
      for (std::size_t col = 0; col < validity.size(); ++col)
        validity[col] |= error_of(work.column_errors[col], work.row_errors[col]);
      for (int col = lit_begin; col < lit_end; ++col) judge_pixel(row, col, work.reader);
    }
  }

  // Stray light: lit so weakly beside the rest that it is not the subject. What lost its samples
  // tells no modulation.
  void reject_stray_light() {
    constexpr std::size_t kStride = 7;  // a seventh of the pixels tells a percentile
    std::vector<float> values;
    for (std::size_t i = 0; i < out_.modulation_dn_per_us.samples().size(); i += kStride) {
      if (out_.modulation_dn_per_us.samples()[i] > 0)
        values.push_back(out_.modulation_dn_per_us.samples()[i]);
    }
    if (values.empty()) return;
    const auto rank = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 99 / 100);
    std::nth_element(values.begin(), rank, values.end());
    const float least = static_cast<float>(options_.min_modulation_frac) * *rank;
    for (std::size_t i = 0; i < out_.modulation_dn_per_us.samples().size(); ++i) {
      std::uint32_t& error = out_.validity.samples()[i];
      if (out_.modulation_dn_per_us.samples()[i] < least && (error & kSaturated) == 0)
        error |= kBackground;
    }
  }

 private:
  // Where patterns of the lesser axis are missing, so that it cannot place all pixels, the other
  // alone will do. Not the other way round: a coarse axis makes a coarse surface beside a fine one.
  std::uint32_t error_of(std::uint32_t column_error, std::uint32_t row_error) const {
    const bool is_row_lesser = signal_count(row_.plan) <= signal_count(column_.plan);
    const AxisImages& lesser = is_row_lesser ? row_ : column_;
    const std::uint32_t its_error = is_row_lesser ? row_error : column_error;
    const std::uint32_t other_error = is_row_lesser ? column_error : row_error;
    const bool is_forgiven = !lesser.plan.is_whole && (its_error & kBackground) == 0 &&
                             (is_row_lesser ? column_ : row_).plan.is_decodable;
    return is_forgiven ? other_error : other_error | its_error;
  }

  // Of stripes and fringes.
  static std::size_t signal_count(const AxisPlan& plan) {
    std::size_t count = 0;
    for (const FamilySource& source : plan.families) count += source.signals.size();
    return count;
  }

  // Clear pixels by vectors, the others one by one.
  void decode_axis_row(AxisImages& axis, const AxisRow& rows, int row,
                       std::vector<std::uint32_t>& errors, Workspace& work) {
    errors.assign(static_cast<std::size_t>(out_.validity.width_px()), 0);
    if (!axis.plan.is_decodable) return;
    const auto begin = static_cast<std::size_t>(work.reader.lit_begin());
    const auto end = static_cast<std::size_t>(work.reader.lit_end());
    const std::span<float> position_px = axis.position_px.view().row(row);
    const std::span<float> sd_px = axis.sd_px.view().row(row);
    const std::span<float> modulation = out_.modulation_dn_per_us.view().row(row);
    for (std::size_t col = 0; col < modulation.size(); ++col)
      modulation[col] = std::max(modulation[col], rows.contrast[col]);
    if (axis.clear_code)
      decode_clear(
          *axis.clear_code, rows,
          {static_cast<float>(options_.min_modulation_sd), static_cast<float>(options_.max_sd_px)},
          begin, end, position_px.data(), sd_px.data());
    for (std::size_t col = begin; col < end; ++col) {
      if (!std::isnan(position_px[col])) continue;
      float found_modulation = 0;
      const Decoded found = decode_axis(axis.plan, rows, col, options_, work, found_modulation);
      position_px[col] = found.position_px;
      sd_px[col] = found.sd_px;
      errors[col] = found.error;
      modulation[col] = std::max(modulation[col], found_modulation);
    }
  }

  void judge_pixel(int row, int col, const RowReader& reader) {
    std::uint32_t& error = out_.validity.at(row, col);
    if (projector_.sync_square && is_in_sync_square(row, col)) error |= kNoCorrespondence;
    if (error != 0 && reader.has_lost_readings(col)) error = kSaturated;
  }

  bool is_in_sync_square(int row, int col) const {
    if (!column_.plan.is_decodable || !row_.plan.is_decodable) return false;
    const float column_px = column_.position_px.at(row, col),
                row_px = row_.position_px.at(row, col);
    if (std::isnan(column_px) || std::isnan(row_px)) return false;
    return projector_.sync_square->contains(static_cast<int>(std::lround(row_px)),
                                            static_cast<int>(std::lround(column_px)));
  }

  const ProjectorInfo& projector_;
  const CorrespondenceOptions& options_;
  AxisImages column_, row_;
  Correspondence& out_;
  oneapi::tbb::enumerable_thread_specific<Workspace> workspaces_;
};

template <typename Body>
void for_rows(int height_px, const Body& body) {
  oneapi::tbb::parallel_for(oneapi::tbb::blocked_range<int>(0, height_px, 8),
                            [&](const oneapi::tbb::blocked_range<int>& range) {
                              for (int row = range.begin(); row < range.end(); ++row) body(row);
                            });
}

void blank_invalid(Correspondence& out) {
  for_rows(out.validity.height_px(), [&](int row) {
    const std::span<const std::uint32_t> validity = std::as_const(out.validity).view().row(row);
    for (Image<float>* image : {&out.column_px, &out.row_px, &out.column_sd_px, &out.row_sd_px}) {
      if (image->empty()) continue;
      const std::span<float> samples = image->view().row(row);
      for (std::size_t col = 0; col < samples.size(); ++col)
        samples[col] = validity[col] != 0 ? kNaN : samples[col];
    }
  });
}

void reject_unsupported(double min_support_frac, Correspondence& out) {
  for (const Image<float>* position : {&out.column_px, &out.row_px}) {
    if (position->empty()) continue;
    const Image<unsigned char> supported = find_supported(position->view(), min_support_frac);
    for_rows(out.validity.height_px(), [&](int row) {
      const std::span<std::uint32_t> validity = out.validity.view().row(row);
      const std::span<const unsigned char> is_supported = supported.view().row(row);
      const std::span<const float> place_px = position->view().row(row);
      for (std::size_t col = 0; col < validity.size(); ++col) {
        // A place that this axis does not tell is the other one's to judge.
        const bool is_lost =
            validity[col] == 0 && is_supported[col] == 0 && !std::isnan(place_px[col]);
        validity[col] = is_lost ? std::uint32_t{kNoCorrespondence} : validity[col];
      }
    });
  }
}

}  // namespace

Correspondence decode_correspondence(std::span<const PatternSignal> signals,
                                     const ProjectorInfo& projector,
                                     const CorrespondenceOptions& options) {
  check(!options.noise.empty(), "correspondence without a noise range");
  Correspondence out;
  const SignalSet set = collect_signals(signals, options.levels);
  PatternPlan plan = plan_patterns(set, projector, options);
  out.notes = std::move(plan.notes);
  Decoder decoder(plan, set, projector, options, out);
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
