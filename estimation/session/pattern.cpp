#include "estimation/session/pattern.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <sstream>

namespace estimation {
namespace {

constexpr int kLargestGrayBit = 30;  // of a non-negative int

template <typename... Visitors>
struct Overloaded : Visitors... {
  using Visitors::operator()...;
};
template <typename... Visitors>
Overloaded(Visitors...) -> Overloaded<Visitors...>;

double stripe_brightness(const Stripes& stripes, int position_px) {
  check(stripes.period_px > 0, "stripes need a period above 0 px");
  // 64 bit: a shift near the limits of int must not overflow.
  const long long period_px = stripes.period_px;
  const long long offset_px = (position_px - static_cast<long long>(stripes.shift_px)) % period_px;
  const long long phase_px = offset_px < 0 ? offset_px + period_px : offset_px;
  return phase_px < stripes.width_px ? 1.0 : 0.0;
}

double gray_brightness(const GrayCode& gray, int position_px) {
  check(gray.bit >= 0 && gray.bit <= kLargestGrayBit, "a Gray-code bit is 0..30");
  const auto binary = static_cast<unsigned>(position_px);
  const unsigned code = binary ^ (binary >> 1);
  const bool is_one = (code >> gray.bit & 1U) != 0;
  return is_one != gray.inverted ? 1.0 : 0.0;
}

double fringe_brightness(const Fringe& fringe, int position_px) {
  check(fringe.period_px > 0, "a fringe needs a period above 0 px");
  const double cycles = (position_px - fringe.shift_px) / fringe.period_px;
  return (1.0 + std::cos(2.0 * std::numbers::pi * cycles)) / 2.0;
}

// The coordinate a kind varies along; a uniform kind may take either.
Axis axis_of(const PatternKind& kind) {
  return std::visit(
      [](const auto& k) {
        if constexpr (requires { k.axis; }) {
          return k.axis;
        } else {
          return Axis::kColumn;
        }
      },
      kind);
}

const char* name(Axis axis) { return axis == Axis::kColumn ? "column" : "row"; }

// One axis of the paper's correspondence patterns: Gray code with inverses, then fine stripes.
void append_correspondence(std::vector<Pattern>& patterns, Axis axis) {
  constexpr int kGrayBits = 10;  // of a 1024 px projector
  const auto append = [&](const PatternKind& kind) {
    patterns.push_back({.index = static_cast<int>(patterns.size()), .kind = kind});
  };
  for (int bit = kGrayBits - 1; bit >= 0; --bit) {
    append(GrayCode{.axis = axis, .bit = bit, .inverted = false});
    append(GrayCode{.axis = axis, .bit = bit, .inverted = true});
  }
  for (int shift_px = 0; shift_px < 16; shift_px += 4) {
    append(Stripes{.axis = axis, .period_px = 16, .width_px = 8, .shift_px = shift_px});
  }
}

}  // namespace

double brightness(const PatternKind& kind, int row, int col) {
  const auto position_px = [&](Axis axis) { return axis == Axis::kColumn ? col : row; };
  return std::visit(Overloaded{
                        [&](const Stripes& k) { return stripe_brightness(k, position_px(k.axis)); },
                        [&](const GrayCode& k) { return gray_brightness(k, position_px(k.axis)); },
                        [&](const Fringe& k) { return fringe_brightness(k, position_px(k.axis)); },
                        [](const White&) { return 1.0; },
                        [](const Black&) { return 0.0; },
                        [](const ImageFile&) {
                          check(false, "an image pattern has no formula: read its file instead");
                          return 0.0;
                        },
                    },
                    kind);
}

Image<unsigned char> render_pattern(const PatternKind& kind, int height_px, int width_px) {
  Image<unsigned char> image(height_px, width_px);
  const auto level = [&](int row, int col) {
    return static_cast<unsigned char>(std::lround(255.0 * brightness(kind, row, col)));
  };
  if (axis_of(kind) == Axis::kRow) {
    for (int row = 0; row < height_px; ++row) {
      std::ranges::fill(image.view().row(row), level(row, 0));
    }
    return image;
  }
  std::vector<unsigned char> line(static_cast<std::size_t>(width_px));
  for (int col = 0; col < width_px; ++col) line[static_cast<std::size_t>(col)] = level(0, col);
  for (int row = 0; row < height_px; ++row) std::ranges::copy(line, image.view().row(row).begin());
  return image;
}

std::vector<Pattern> paper_patterns() {
  std::vector<Pattern> patterns;
  patterns.reserve(88);
  for (int shift_px = 0; shift_px < 40; ++shift_px) {
    patterns.push_back(
        {.index = shift_px,
         .kind =
             Stripes{.axis = Axis::kColumn, .period_px = 40, .width_px = 8, .shift_px = shift_px}});
  }
  append_correspondence(patterns, Axis::kColumn);
  append_correspondence(patterns, Axis::kRow);
  return patterns;
}

std::string describe(const PatternKind& kind) {
  std::ostringstream text;
  std::visit(Overloaded{
                 [&](const Stripes& k) {
                   text << "stripes " << name(k.axis) << ' ' << k.period_px << '/' << k.width_px
                        << " shift " << k.shift_px;
                 },
                 [&](const GrayCode& k) {
                   text << "gray code " << name(k.axis) << " bit " << k.bit
                        << (k.inverted ? " inverted" : "");
                 },
                 [&](const Fringe& k) {
                   text << "fringe " << name(k.axis) << ' ' << k.period_px << " shift "
                        << k.shift_px;
                 },
                 [&](const White&) { text << "white"; },
                 [&](const Black&) { text << "black"; },
                 [&](const ImageFile& k) { text << "image " << k.file; },
             },
             kind);
  return text.str();
}

}  // namespace estimation
