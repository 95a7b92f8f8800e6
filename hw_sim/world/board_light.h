// A projected picture as light on a surface: lit squares, blurred by the projector's optics by as
// much as the place asks for.
#pragma once

#include <array>
#include <vector>

#include "estimation/base/image.h"

namespace hw_sim {

// Nearly all pictures are stripes with a sync square in a corner: constant along one axis but for a
// small box. Such a line is blurred once for a few widths of blur; what lies near the box is summed
// pixel by pixel. Immutable, so thread-safe.
class BlurredPicture {
 public:
  // Light = grey^gamma. Blur is a Gaussian's standard deviation, px, between `least` and
  // `greatest`.
  BlurredPicture(const estimation::Image<unsigned char>& brightness, double gamma,
                 double least_blur_px, double greatest_blur_px);

  // 0..1 at a place of the picture (integers are pixel centres); dark beyond its border.
  double at(double col_px, double row_px, double blur_px) const;

 private:
  struct Box {
    int first_row = 0, last_row = -1, first_col = 0, last_col = -1;
  };
  struct Line {
    double blur_px = 0;
    std::vector<float> samples;  // kFine a px, from kReachPx before the first pixel
  };

  void find_line(const estimation::Image<unsigned char>& brightness);
  void blur_line(double blur_px);
  bool is_near_box(double col_px, double row_px) const;
  double summed(double col_px, double row_px, double blur_px) const;
  double on_line(const Line& line, double position_px) const;

  estimation::Image<unsigned char> brightness_;
  std::array<double, 256> light_{};     // [grey] 0..1
  bool is_along_columns_ = true;        // the line's axis
  std::vector<unsigned char> profile_;  // [column or row]
  Box box_;                             // of the pixels that are not as the line says
  double greatest_blur_px_;
  std::vector<Line> lines_;  // by rising blur
};

}  // namespace hw_sim
