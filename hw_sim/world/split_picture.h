// A projector picture as lines: stripes and codes vary along one axis, and only a sync square does
// not.
#pragma once

#include <vector>

#include "estimation/base/image.h"

namespace hw_sim {

// A projector picture taken apart into what varies along one axis alone and the rectangle where it
// differs from that (the sync square).
struct SplitPicture {
  enum class Kind { kColumns, kRows, kGeneral };
  struct Rect {
    int row_begin = 0, row_end = 0, col_begin = 0, col_end = 0;
    bool empty() const { return row_begin >= row_end || col_begin >= col_end; }
    bool meets(const Rect& other) const {
      return row_begin < other.row_end && other.row_begin < row_end && col_begin < other.col_end &&
             other.col_begin < col_end;
    }
  };
  Kind kind = Kind::kGeneral;
  std::vector<unsigned char> line;  // brightness by column or by row
  Rect rest;                        // kGeneral: everything
};
SplitPicture split_picture(estimation::ImageView<const unsigned char> brightness);

}  // namespace hw_sim
