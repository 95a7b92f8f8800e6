// The calibration board and its corners in a picture.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/calibration/board_view.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace estimation {

enum class BoardKind { kCheckerboard, kCharuco };

// Counts are of squares, for both kinds. A ChArUco board is as OpenCV 4.6 draws it, of dictionary
// DICT_5X5_250, with markers of 0.75 of a square.
struct Board {
  BoardKind kind = BoardKind::kCheckerboard;
  int row_count = 0;
  int col_count = 0;
  double square_mm = 0;
};

inline constexpr double kCharucoMarkerFrac = 0.75;

// "checkerboard" or "charuco", "11x15", square's edge in mm; every error at once.
Result<Board> parse_board(std::string_view kind, std::string_view counts, double square_mm);

std::string to_string(const Board& board);  // "checkerboard of 11 x 15 squares of 18 mm"

struct DetectedCorner {
  Vec2 board_mm;       // from the first inner corner
  Vec2 frame_px;       // (col, row) in the frame
  double sd_px = 0.1;  // of each coordinate
};

// The 2 x 2 sites of a Bayer picture of something grey, brought to one level: full resolution
// without demosaicing. Others are returned as they are (an RGB picture's bands are summed).
Image<float> grey_picture(ImageView<const float> signal, ColorFilter filter);

// Inner corners, found and refined to sub-pixel in a grey picture of the evenly lit board. All of a
// checkerboard's or none; those of a ChArUco board that are seen. NaN counts as dark. Errors:
// kInsufficient, with what to look at.
Result<std::vector<DetectedCorner>> detect_board(ImageView<const float> grey, const Board& board);

}  // namespace estimation
