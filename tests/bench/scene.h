// A picture as a list of strokes, marks and words, written as SVG and as PNG from the same list.
#pragma once

#include <string>
#include <variant>
#include <vector>

namespace bench {

struct Point {
  double x = 0, y = 0;
};
struct Color {
  unsigned char red = 0, green = 0, blue = 0;
};
inline constexpr Color kWhite{255, 255, 255};
inline constexpr Color kInk{40, 40, 40};
inline constexpr Color kFaintInk{125, 125, 125};
inline constexpr Color kGrid{232, 232, 232};

struct Stroke {
  std::vector<Point> points;
  Color color = kInk;
  double width_px = 1;
  bool is_dashed = false;
};
enum class MarkShape { kDisc, kSquare, kDiamond, kTriangle, kCross };
struct Mark {
  Point at;
  MarkShape shape = MarkShape::kDisc;
  double radius_px = 4;
  Color color = kInk;
};
enum class Anchor { kStart, kMiddle, kEnd };
struct Words {
  std::string text;       // ASCII: the PNG's letters are strokes
  Point at;               // on the baseline
  double height_px = 12;  // of the font
  Color color = kInk;
  Anchor anchor = Anchor::kStart;
  bool is_upwards = false;  // turned to read upwards
};
using Item = std::variant<Stroke, Mark, Words>;

struct Scene {
  double width_px = 0, height_px = 0;
  std::vector<Item> items;  // later ones cover earlier ones
};

// As the PNG draws it; the SVG's letters are no wider.
double words_width_px(const std::string& text, double height_px);

std::string svg(const Scene& scene);
// PNG bytes, two image pixels a scene pixel.
std::vector<unsigned char> png(const Scene& scene);

}  // namespace bench
