// Pixels whose Gray code is clear, decoded by vectors of them. What is not clear is left to the
// readings' likelihood, a pixel at a time.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "estimation/geometry/pattern_plan.h"
#include "estimation/geometry/row_reader.h"

namespace estimation {

// The bits that place a pixel on one axis: all from the projector's highest down to low_bit.
struct ClearCode {
  int size_px = 0;
  int low_bit = 0;
  std::size_t bit_count = 0;
  // Of the plan's families. Runs of the lowest bit are so short beside the first one's that a bit
  // misread at its own transition leads to the same period. None: whole columns.
  std::vector<float> period_px;
};

// Nullopt if bits are missing.
std::optional<ClearCode> find_clear_code(const AxisPlan& plan);

struct ClearLimits {
  float min_modulation_sd = 5;
  float max_sd_px = 1;
};

// Over [begin, end): the same position and standard deviation as the likelihood's where every bit
// used reads as the position says and all phases agree, NaN elsewhere.
void decode_clear(const ClearCode& code, const AxisRow& rows, const ClearLimits& limits,
                  std::size_t begin, std::size_t end, float* position_px, float* sd_px);

}  // namespace estimation
