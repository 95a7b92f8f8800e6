// Every frame of a simulated head says in a corner, where no face is, which trigger and which light
// made it. Only tests read it: the proof that a frame is the one it is taken for.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include "estimation/base/image.h"

namespace hw_sim {

struct IdentityBlock {
  std::uint32_t trigger_number = 0;
  std::chrono::microseconds exposure{0};  // tells the bracket
  // The picture that was lit longest while the shutter was open; 0 if none was.
  std::uint64_t picture_id = 0;
  std::uint32_t picture_hash = 0;  // see picture_hash()
  int share_of_255 = 0;            // of the exposure that this picture was lit
  int picture_count = 0;           // lit one after the other, up to 15
  bool operator==(const IdentityBlock&) const = default;
};

// Of a picture's pixels and size: tells patterns apart.
std::uint32_t picture_hash(const estimation::Image<unsigned char>& brightness);

// One bit a pixel in the top left corner, kWidthPx x kHeightPx; a set bit stands a few DN above the
// black level, so that a block is darker than any skin.
struct IdentityBlockLayout {
  static constexpr int kWidthPx = 6, kHeightPx = 36;

  int black_level_dn = 0;
  int adc_max_dn = 4095;
  // More than noise, less than a hundredth of full scale for ten bits and more.
  int set_dn() const {
    return black_level_dn + (adc_max_dn + 1 > 2048 ? (adc_max_dn + 1) / 512 : 4);
  }

  // Over what the frame holds there. Frames smaller than a block stay as they are.
  void write(const IdentityBlock& identity, estimation::ImageView<std::uint16_t> frame_dn) const;
  // nullopt where the corner holds no block, or a damaged one. Noise of up to a quarter of
  // set_dn() - black_level_dn leaves it readable.
  std::optional<IdentityBlock> read(estimation::ImageView<const std::uint16_t> frame_dn) const;
};

}  // namespace hw_sim
