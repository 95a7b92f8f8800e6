#include "capture/captured_frame.h"

#include <algorithm>
#include <bit>

#include "estimation/base/check.h"

namespace capture {

static_assert(std::endian::native == std::endian::little, "frames are little-endian");

FrameSamples::FrameSamples(const rig::Frame& frame) {
  const bool is_8_bit = frame.pixel_format.ends_with("8");
  const int channel_count = frame.pixel_format.starts_with("RGB") ? 3 : 1;
  const std::size_t sample_count = static_cast<std::size_t>(frame.width_px) *
                                   static_cast<std::size_t>(frame.height_px) *
                                   static_cast<std::size_t>(channel_count);
  estimation::check(frame.pixels.size() == sample_count * (is_8_bit ? 1 : 2),
                    "a camera delivered a frame whose size is not its width x height");
  if (is_8_bit) {
    widened_ = estimation::Image<std::uint16_t>(frame.height_px, frame.width_px, channel_count);
    std::transform(frame.pixels.begin(), frame.pixels.end(), widened_.samples().begin(),
                   [](std::byte sample) { return std::to_integer<std::uint16_t>(sample); });
    view_ = widened_.view();
    return;
  }
  // Buffers come from the allocator or the page: aligned for any sample.
  view_ = {reinterpret_cast<const std::uint16_t*>(frame.pixels.data()), frame.height_px,
           frame.width_px, channel_count,
           static_cast<std::ptrdiff_t>(frame.width_px) * channel_count};
}

}  // namespace capture
