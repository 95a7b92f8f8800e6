// Separable filters of image rows, by vectors.
#pragma once

#include <cstddef>
#include <span>

namespace estimation {

// For window offsets x, y and Gaussian weights g: value = sum g(x) g(y) (a + b (x^2 + y^2)) q,
// slopes = sum g(x) g(y) s x q and s y q (Savitzky-Golay with a weight).
struct FilterKernels {
  int radius = 0;
  std::span<const float> plain, first, second;  // g, g x, g x^2; [offset + radius]
  float a = 0, b = 0, s = 0;
};

// One image row filtered along x by the three kernels.
struct FilteredRow {
  float *plain = nullptr, *first = nullptr, *second = nullptr;
};

// Over [begin, end); reads `radius` samples more on either side.
void filter_along_row(const float* samples, const FilterKernels& kernels, std::size_t begin,
                      std::size_t end, const FilteredRow& out);

struct SmoothedRow {
  float *value = nullptr, *by_col = nullptr, *by_row = nullptr;
};

// 2 radius + 1 filtered rows across, over [begin, end).
void filter_across_rows(std::span<const FilteredRow> rows, const FilterKernels& kernels,
                        std::size_t begin, std::size_t end, const SmoothedRow& out);

}  // namespace estimation
