// One row of a bracket, merged by vectors of samples.
#pragma once

#include <cstdint>
#include <span>

namespace estimation {

struct ExposedRow {
  const std::uint16_t* dn = nullptr;
  const float* black_dn = nullptr;
  float exposure_us = 0;
};

// out[i] = sum(dn - black) / sum(exposure) over the rows below saturation there, over
// flat_field[i / channel_count]; NaN where none is, or the flat field is not positive.
//   rows        of out's length, at least one
//   flat_field  [width], or empty
// A sample's bits do not depend on its place in the row.
void merge_row(std::span<const ExposedRow> rows, double saturation_dn,
               std::span<const float> flat_field, int channel_count, std::span<float> out);

}  // namespace estimation
