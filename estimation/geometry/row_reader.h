// What the patterns say along one image row: bits as contrasts, stripe families as phases.
#pragma once

#include <map>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "estimation/geometry/correspondence.h"
#include "estimation/geometry/pattern_plan.h"

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

// Scratch of one worker: it allocates at its first row only. Not thread-safe; borrows its plan.
class RowReader {
 public:
  RowReader(const PatternPlan& plan, const CorrespondenceOptions& options);

  void read(int row);

  // What the last row said. Pairs of bits and families have been read for lit_begin() <= col <
  // lit_end() alone: elsewhere no bit has a contrast worth the name.
  const AxisRow& column() const { return column_; }
  const AxisRow& row() const { return row_; }
  int lit_begin() const { return lit_begin_; }
  int lit_end() const { return lit_end_; }
  bool has_lost_samples(int col) const { return lost_[static_cast<std::size_t>(col)] != 0; }

 private:
  // MergedNoise in single precision, for the inner loops.
  struct NoiseRange {
    float up_to_dn_per_us = 0, read_variance = 0, shot_dn_per_us = 0;
  };
  struct Phasor {
    float mean = 0, cosine = 0, sine = 0;
    float cos_cos = 0, cos_sin = 0, sin_sin = 0;  // covariance of cosine and sine
    double aliasing_px = 0;
  };

  float variance_of(float signal) const;
  void read_variance(const float* samples, std::size_t begin, std::size_t end,
                     float* variance) const;
  void note_lost(int row);
  void find_contrast(const AxisPlan& plan, int row, AxisRow& out);
  void read_bits(const AxisPlan& plan, int row, AxisRow& out);
  void read_pair(const BitSource& source, int row, Row& value, Row& variance);
  void read_single(const BitSource& source, int row, Row& value, Row& variance);
  void find_lit();
  void read_families(const AxisPlan& plan, int row, AxisRow& out);
  void read_family(const FamilySource& source, int row, FamilyRow& out);
  Phasor demodulate_partial(const FamilySource& source, int row, int col);
  static void store_phase(const FamilySource& source, const Phasor& phasor, std::size_t col,
                          FamilyRow& out);
  void read_midpoint(int row);
  void read_middle_of_bits(int row);

  const PatternPlan& plan_;
  const CorrespondenceOptions& options_;
  std::vector<NoiseRange> noise_;
  std::vector<ImageView<const float>> signals_;  // all that count as lost when they are NaN
  std::size_t width_ = 0;
  AxisRow column_, row_;
  int lit_begin_ = 0, lit_end_ = 0;
  Row lost_;  // 0, or NaN
  bool is_any_lost_ = false;
  Row midpoint_, least_, most_, scratch_;
  Row cosine_, sine_, cos_cos_, cos_sin_, sin_sin_;
  // Weights for pixels that lost samples, by family and used shifts.
  std::map<std::pair<const FamilySource*, std::vector<char>>, std::optional<Demodulation>> partial_;
};

}  // namespace estimation
