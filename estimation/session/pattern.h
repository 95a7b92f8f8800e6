// Projected patterns as numbers: the kinds of the session format, their pixels, and the paper's
// plan.
#pragma once

#include <string>
#include <variant>
#include <vector>

#include "estimation/base/image.h"

namespace estimation {

enum class Axis { kColumn, kRow };  // the projector coordinate along which a pattern varies

// Column (row) c is lit where (c - shift_px) mod period_px < width_px, mod never negative.
struct Stripes {
  Axis axis = Axis::kColumn;
  int period_px = 40;
  int width_px = 8;
  int shift_px = 0;
  bool operator==(const Stripes&) const = default;
};

// Bit `bit` (0 is the least significant) of g = i ^ (i >> 1); lit where it is 1, or 0 if inverted.
struct GrayCode {
  Axis axis = Axis::kColumn;
  int bit = 0;
  bool inverted = false;
  bool operator==(const GrayCode&) const = default;
};

// Brightness (1 + cos(2 pi (i - shift_px) / period_px)) / 2.
struct Fringe {
  Axis axis = Axis::kColumn;
  double period_px = 0;
  double shift_px = 0;
  bool operator==(const Fringe&) const = default;
};

struct White {
  bool operator==(const White&) const = default;
};
struct Black {
  bool operator==(const Black&) const = default;
};
struct ImageFile {
  std::string file;  // relative to the session folder
  bool operator==(const ImageFile&) const = default;
};

using PatternKind = std::variant<Stripes, GrayCode, Fringe, White, Black, ImageFile>;

struct Pattern {
  int index = 0;  // unique in a session; frames refer to it
  PatternKind kind;
  bool operator==(const Pattern&) const = default;
};

// Brightness in 0..1 at projector pixel (row, col). An ImageFile has none: check() fails.
double brightness(const PatternKind& kind, int row, int col);

// The pattern as the projector shows it, 0..255, rounded to nearest. An ImageFile fails check().
Image<unsigned char> render_pattern(const PatternKind& kind, int height_px, int width_px);

// The 88 patterns of plan "paper" with index 0..87: stripes of period 40, width 8, shift 0..39;
// then for columns and for rows ten Gray-code bits, most significant first, each followed by its
// inverse, and stripes of period 16, width 8, shift 0, 4, 8, 12.
std::vector<Pattern> paper_patterns();

// "stripes column 40/8 shift 3", for messages and logs.
std::string describe(const PatternKind& kind);

}  // namespace estimation
