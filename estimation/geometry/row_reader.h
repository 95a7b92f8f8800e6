// What the patterns say along one image row: bits as contrasts, stripe families as phases.
#pragma once

#include <map>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "estimation/geometry/correspondence.h"
#include "estimation/geometry/pattern_plan.h"
#include "estimation/geometry/row_kernels.h"
#include "estimation/geometry/signal_rows.h"

namespace estimation {

using Row = std::vector<float>;  // [col]

// One phase family along one image row.
struct FamilyRow {
  Row position_px, sd_px;         // modulo the period; NaN, infinity: no phase
  Row modulation, modulation_sd;  // white minus black as the amplitude tells, DN/us
  Row mean;
};

// One axis along one image row.
struct AxisRow {
  // [bit] lit minus dark, DN/us; an infinite value: a saturated sample tells it
  std::vector<Row> bit_value, bit_variance;
  Row contrast, contrast_variance;  // of the clearest bit; 0 without bits
  std::vector<FamilyRow> families;
};

// Scratch of one worker: it allocates at its first row only. Not thread-safe; borrows its plan and
// signals.
class RowReader {
 public:
  RowReader(const PatternPlan& plan, const SignalSet& signals,
            const CorrespondenceOptions& options);

  void read(int row);

  // What the last row said. Families have been read for lit_begin() <= col < lit_end() alone:
  // elsewhere no bit has a contrast worth the name.
  const AxisRow& column() const { return column_; }
  const AxisRow& row() const { return row_; }
  int lit_begin() const { return lit_begin_; }
  int lit_end() const { return lit_end_; }
  // Whether samples that the pixel lost leave a bit or a phase of an axis unread.
  bool has_lost_readings(int col) const;

 private:
  struct Phasor {
    float mean = 0, cosine = 0, sine = 0;
    float cos_cos = 0, cos_sin = 0, sin_sin = 0;  // covariance of cosine and sine
    double aliasing_px = 0;
  };

  SampleNoise noise() const { return {ranges_, saturation_dn_}; }
  float variance_of(float signal) const;
  void read_bits(const AxisPlan& plan, AxisRow& out);
  void read_singles(const AxisPlan& plan, AxisRow& out);
  void find_lit();
  void read_families(const AxisPlan& plan, AxisRow& out);
  void read_family(const FamilySource& source, FamilyRow& out);
  Phasor demodulate_partial(const FamilySource& source, std::size_t col);
  static void store_phase(const FamilySource& source, const Phasor& phasor, std::size_t col,
                          FamilyRow& out);
  void read_midpoint();
  void read_middle_of_pairs();
  void read_middle_of_bits();

  const PatternPlan& plan_;
  const CorrespondenceOptions& options_;
  SignalRows signals_;
  std::vector<NoiseRange> ranges_;
  float saturation_dn_ = 0;
  std::size_t width_ = 0;
  bool is_unpaired_ = false;      // some bit has no inverse
  bool is_told_by_bits_ = false;  // bits tell everywhere if a pixel is lit
  AxisRow column_, row_;
  int lit_begin_ = 0, lit_end_ = 0;
  Row lost_;  // 0, or NaN
  Row midpoint_, pair_count_, least_, most_, samples_, sums_;
  std::vector<SampleRow> shifts_;
  // Weights for pixels that lost samples, by family and used shifts.
  std::map<std::pair<const FamilySource*, std::vector<char>>, std::optional<Demodulation>> partial_;
};

}  // namespace estimation
