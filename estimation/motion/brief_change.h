// What changed the light for a few frames only, between the repeats of a pattern: a blink, a flash
// in the room. Every pattern has relatives that tell what it should have been: stripes make each
// place's light a smooth function of their shift, and Gray code and its inverse add up to white.
// Pure: arrays in, numbers out.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "estimation/session/pattern.h"

namespace estimation {

// The frame in blocks of about an eyelid's height.
struct BlockGrid {
  int rows = 0, cols = 0;
  int height_px = 0, width_px = 0;  // of a block
  std::size_t count() const {
    return static_cast<std::size_t>(rows) * static_cast<std::size_t>(cols);
  }
};
// A block is as long along `axis` as the frame shows a period of the stripes, so that their shift
// hardly changes its light.
BlockGrid block_grid(const CameraInfo& camera, Axis axis, double period_px);

// [row * cols + col] mean of the block's samples, DN above black; NaN where more than one in a
// hundred is clipped. `frame_dn` is [height][width][channel] of the camera's size.
std::vector<float> block_light(const CameraInfo& camera, const BlockGrid& grid,
                               ImageView<const std::uint16_t> frame_dn);

struct SeenFrame {
  int pattern = 0;  // its index in the session
  int bracket = 0;
  double elapsed_s = 0;
  std::vector<float> light_dn;   // by block_light()
  bool is_square_light = false;  // the sync square's level, which the camera may see
};

// Under one pattern or several in a row.
struct BriefChange {
  std::vector<int> patterns;      // in the order of their showing
  double elapsed_s = 0;           // of the first
  double change_frac = 0;         // of the light of the block where it changed most
  double row_px = 0, col_px = 0;  // the middle of the place that changed
  bool is_everywhere = false;     // most of what is lit changed
};

// In the order of their showing. Of Gray code either frame of a pair may be the one: both are
// named. Changes of less than 5% of a block's light, or of less than 8 standard deviations of
// what the block did otherwise, are not told, nor single blocks.
std::vector<BriefChange> find_brief_changes(const CameraInfo& camera, const BlockGrid& grid,
                                            const std::vector<Pattern>& patterns,
                                            const std::vector<SeenFrame>& frames);

}  // namespace estimation
