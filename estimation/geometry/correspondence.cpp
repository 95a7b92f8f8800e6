#include "estimation/geometry/correspondence.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

#include "estimation/base/check.h"
#include "estimation/geometry/pattern_plan.h"
#include "estimation/geometry/row_reader.h"
#include "estimation/geometry/support.h"

namespace estimation {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();
// Two phases of one pixel agree within this many standard deviations plus the slack, or are not
// combined; light that enters obliquely comes out shifted by up to a px.
constexpr double kAgreementSd = 4;
constexpr double kAgreementSlackPx = 1;
// No phase counts as better than this, whatever the noise options say.
constexpr double kLeastSdPx = 1e-3;

// Scratch of one worker.
struct Workspace {
  RowReader reader;
  std::vector<float> scores = {};
  std::vector<BitReading> bits = {};
  std::vector<PhaseReading> phases = {};
  std::vector<std::size_t> usable = {};
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
        out_(out),
        workspaces_([&plan, &options] { return Workspace{RowReader(plan, options)}; }) {
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
    for (int row = begin; row < end; ++row) {
      work.reader.read(row);
      const int width = out_.validity.width_px();
      for (int col = 0; col < work.reader.lit_begin(); ++col) leave_dark(row, col, work.reader);
      for (int col = work.reader.lit_begin(); col < work.reader.lit_end(); ++col)
        decode_pixel(row, col, work);
      for (int col = work.reader.lit_end(); col < width; ++col) leave_dark(row, col, work.reader);
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
  void leave_dark(int row, int col, const RowReader& reader) {
    const auto i = static_cast<std::size_t>(col);
    if (plan_.column.is_decodable) modulation_.at(row, col) = reader.column().contrast[i];
    if (plan_.row.is_decodable)
      modulation_.at(row, col) = std::max(modulation_.at(row, col), reader.row().contrast[i]);
    const bool is_decodable = plan_.column.is_decodable || plan_.row.is_decodable;
    out_.validity.at(row, col) = is_decodable ? std::uint32_t{kBackground} : 0U;
  }

  void decode_pixel(int row, int col, Workspace& work) {
    const auto i = static_cast<std::size_t>(col);
    Decoded column, line;
    float modulation = 0;
    if (plan_.column.is_decodable) {
      column = decode_axis(plan_.column, work.reader.column(), i, options_, work, modulation);
      modulation_.at(row, col) = modulation;
      out_.column_px.at(row, col) = column.position_px;
      out_.column_sd_px.at(row, col) = column.sd_px;
    }
    if (plan_.row.is_decodable) {
      line = decode_axis(plan_.row, work.reader.row(), i, options_, work, modulation);
      modulation_.at(row, col) = std::max(modulation, modulation_.at(row, col));
      out_.row_px.at(row, col) = line.position_px;
      out_.row_sd_px.at(row, col) = line.sd_px;
    }
    std::uint32_t error = column.error | line.error;
    if (in_sync_square(column.position_px, line.position_px)) error |= kNoCorrespondence;
    if (error != 0 && work.reader.has_lost_samples(col)) error = kSaturated;
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
