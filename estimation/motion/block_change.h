// What each block of a fitted picture says by itself. Private to estimation/motion.
#pragma once

#include <optional>
#include <vector>

#include "estimation/motion/frame_change.h"
#include "estimation/motion/picture_fit.h"

namespace estimation {

// What one block says beyond the whole: its shift across its strongest edges, and its light.
struct BlockChange {
  double shift_cells = 0, shift_sd_cells = 0;  // the whole's included
  double light_frac = 0, light_sd_frac = 0;    // beyond the whole's
};

// [block]; nullopt: too few cells, or without an edge. Each against the noise of the median block:
// one that changed has no noise to be measured by. `sums` are those at `whole`, outliers counted.
std::vector<std::optional<BlockChange>> block_changes(const std::vector<AlignmentSums>& sums,
                                                      const Alignment& whole);

// Blocks that changed by themselves, those that touch as one place; the largest change first.
std::vector<LocalChange> find_local_changes(const std::vector<std::optional<BlockChange>>& changes,
                                            const PictureBlocks& blocks, int bin_px);

// Root mean square of the blocks' shifts, less what their noise adds; the twentieth that moved most
// is left out, for a strand of hair is not the head.
double rms_shift_cells(const std::vector<std::optional<BlockChange>>& changes);

}  // namespace estimation
