// Plots of measured points: axes with linear or logarithmic ticks, labelled marks, reference lines,
// a legend.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "tests/bench/scene.h"

namespace bench {

struct Axis {
  std::string label;  // with its unit
  bool is_log = false;
  std::optional<double> low = {}, high = {};  // else from the points
};

struct Series {
  std::string name;  // in the legend; empty: not there
  Color color = kInk;
  MarkShape shape = MarkShape::kDisc;
  std::vector<Point> points;
  std::vector<std::string> labels = {};  // beside the points; may be shorter
  bool is_joined = false;                // by a line, in the order given
  bool has_marks = true;
};

struct Level {  // a dashed line across the plot
  double y = 0;
  std::string label;
  Color color = kInk;
};

struct Figure {
  std::string title;
  Axis x, y;
  std::vector<Series> series;
  std::vector<Level> levels = {};
};

// Panels side by side, with one legend below for the names of all.
Scene draw(const std::vector<Figure>& panels, double panel_width_px = 520,
           double panel_height_px = 400);

inline constexpr Color kPalette[] = {{0, 114, 178}, {213, 94, 0},   {0, 158, 115},  {204, 121, 167},
                                     {230, 159, 0}, {86, 180, 233}, {120, 94, 240}, {90, 90, 90}};

}  // namespace bench
