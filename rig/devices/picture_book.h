// The pictures on the graphics card and the program that draws them.
#pragma once

#include <vector>

#include "estimation/base/image.h"
#include "rig/fault.h"
#include "rig/projector.h"

namespace rig {

// Where the sync square lies, [left, right) x [top, bottom).
struct SquarePlace {
  int left_px = 0, top_px = 0, right_px = 0, bottom_px = 0;
};

// Main thread, with the window's GL context current; everything goes with that context.
class PictureBook {
 public:
  // Errors: kUnsupported if the driver refuses our shaders.
  static Result<PictureBook> create(const ProjectorSettings& settings);

  // How many pictures the card holds.
  int limit() const { return limit_; }

  // Replaces the pictures. Errors: kOutOfRange if the card has no room for them.
  Result<void> upload(const std::vector<estimation::Image<unsigned char>>& pictures);

  void draw(const ShowRequest& request);
  // All dark, the square too.
  void draw_black();

 private:
  PictureBook(const ProjectorSettings& settings, unsigned vertex_shader, unsigned fragment_shader);
  void draw_layer(int layer);

  int width_px_, height_px_;
  bool is_inverted_;
  SquarePlace square_;
  // GL's names of the program's variables.
  int square_uniform_ = -1, square_level_uniform_ = -1, layer_uniform_ = -1;
  int limit_ = 0;
};

}  // namespace rig
