// A frame made ready for comparison: binned to one value per cell, black removed. Private to
// estimation/motion.
#pragma once

#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/manifest.h"

namespace estimation {

struct Picture {
  int bin_px = 1;                  // side of a cell in the frame's px
  Image<float> light;              // [row][col] DN above black, mean of the cell's samples
  Image<unsigned char> is_usable;  // 1 where no sample of the cell is clipped
};

// From which a sample counts as clipped, DN: the format's full scale where the session names none.
double clip_level_dn(const CameraInfo& camera);

// Cells are as large as gives at most 640 of them in a row, and whole Bayer quads.
Picture make_picture(const CameraInfo& camera, ImageView<const std::uint16_t> frame_dn);

struct CellShift {
  double row = 0, col = 0;
};

// light(row + shift.row, col + shift.col) under a Gaussian of at least one cell: so wide, its
// samples at any fraction of a cell are as good as itself, and the shift is exact. Borders repeat.
// Of nothing: nothing.
Image<float> smoothed(const Image<float>& light, double sigma_cells, const CellShift& shift = {});

// Its mean over a period of the pattern, as far as that is little against the picture: what the
// skin gives back of light that comes from everywhere. `period_px` is the frame's; 0: none.
Image<float> local_mean(const Picture& picture, double period_px);

// Where `second` shows what `first` does, by phase correlation: whole cells, for a start.
CellShift coarse_shift(const Image<float>& first, const Image<float>& second);

// Cells at least `margin_cells` from any that is not usable and from the border.
Image<unsigned char> shrunk(const Image<unsigned char>& is_usable, int margin_cells);

// 0 of none.
double median_of(std::vector<double> values);

}  // namespace estimation
