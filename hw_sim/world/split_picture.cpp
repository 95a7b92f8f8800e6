#include "hw_sim/world/split_picture.h"

#include <algorithm>
#include <cstddef>

namespace hw_sim {
namespace {

using Rect = SplitPicture::Rect;

std::size_t to_size(int value) { return static_cast<std::size_t>(value); }

}  // namespace

SplitPicture split_picture(estimation::ImageView<const unsigned char> brightness) {
  const int height = brightness.height_px, width = brightness.width_px;
  const Rect whole{0, height, 0, width};
  // The middle row and column miss a sync square, which sits in a corner.
  SplitPicture columns{SplitPicture::Kind::kColumns, {}, {height, 0, width, 0}};
  SplitPicture rows{SplitPicture::Kind::kRows, {}, {height, 0, width, 0}};
  for (int col = 0; col < width; ++col) columns.line.push_back(brightness.at(height / 2, col));
  for (int row = 0; row < height; ++row) rows.line.push_back(brightness.at(row, width / 2));
  const auto grow = [](Rect& rect, int row, int col) {
    rect.row_begin = std::min(rect.row_begin, row);
    rect.row_end = std::max(rect.row_end, row + 1);
    rect.col_begin = std::min(rect.col_begin, col);
    rect.col_end = std::max(rect.col_end, col + 1);
  };
  for (int row = 0; row < height; ++row)
    for (int col = 0; col < width; ++col) {
      const unsigned char value = brightness.at(row, col);
      if (value != columns.line[to_size(col)]) grow(columns.rest, row, col);
      if (value != rows.line[to_size(row)]) grow(rows.rest, row, col);
    }
  const auto area = [](const Rect& rect) {
    return rect.empty() ? 0.0
                        : static_cast<double>(rect.row_end - rect.row_begin) *
                              static_cast<double>(rect.col_end - rect.col_begin);
  };
  SplitPicture& best = area(columns.rest) <= area(rows.rest) ? columns : rows;
  // A rest as large as a twentieth of the picture is no sync square.
  if (area(best.rest) > 0.05 * area(whole)) return {SplitPicture::Kind::kGeneral, {}, whole};
  if (best.rest.empty()) best.rest = {};
  return best;
}

}  // namespace hw_sim
