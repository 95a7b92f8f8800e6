// A world of identity and little else: every frame says which pictures lit it, for how long, and
// which pulse made it, so that a test can prove whose a frame is. 64 x 48 px, 16 bit, mono. What
// the identity leaves of the frame is as bright as the light that fell in.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <vector>

#include "estimation/base/image.h"
#include "hw_sim/world.h"

namespace hw_sim {

struct FrameIdentity {
  struct Light {
    std::uint64_t picture_id = 0;
    std::uint64_t content_hash = 0;  // of the picture's pixels, see content_hash()
    std::chrono::microseconds duration{0};
    bool operator==(const Light&) const = default;
  };
  std::vector<Light> light;  // in order
  std::chrono::microseconds exposure{0};
  std::uint64_t trigger_number = 0;
  bool operator==(const FrameIdentity&) const = default;
};

std::uint64_t content_hash(const estimation::Image<unsigned char>& picture);

// nullopt if the frame is none of a LedgerWorld's, or any sample of it was changed.
std::optional<FrameIdentity> decode_identity(estimation::ImageView<const std::uint16_t> frame_dn);

class LedgerWorld final : public World {
 public:
  static constexpr int kWidthPx = 64;
  static constexpr int kHeightPx = 48;

  int width_px() const override { return kWidthPx; }
  int height_px() const override { return kHeightPx; }
  int channel_count() const override { return 1; }
  void expose(const Exposure& exposure,
              estimation::ImageView<std::uint16_t> frame_dn) const override;
};

}  // namespace hw_sim
