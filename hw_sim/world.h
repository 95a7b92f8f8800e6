// What stands in front of the simulated camera. Two kinds: a lit head (hw_sim/world) and the
// ledger world, 64 x 48 px of identity and nothing else (hw_sim/devices/ledger_world.h).
#pragma once

#include <chrono>
#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "hw_sim/lamp_timing.h"
#include "hw_sim/light.h"

namespace hw_sim {

struct Exposure {
  // What the projector showed until the shutter closed, from LampTiming::scanout before it opened.
  std::vector<LightSegment> light;
  std::chrono::microseconds duration{0};
  std::chrono::nanoseconds start{0};  // on the host's clock
  std::uint64_t trigger_number = 0;   // 1, 2, ...: seeds the noise, and is the frame's identity
};

class World {
 public:
  virtual ~World() = default;
  virtual int width_px() const = 0;
  virtual int height_px() const = 0;
  virtual int channel_count() const = 0;  // 3 for an RGB camera, else 1
  // The frame, DN right-aligned, [height_px][width_px][channel_count]. The same exposure gives the
  // same bytes. Thread-safe.
  virtual void expose(const Exposure& exposure,
                      estimation::ImageView<std::uint16_t> frame_dn) const = 0;
  virtual LampTiming lamp_timing() const { return {}; }
  // Called as soon as a picture is lit, so that its light can be computed before the shutter
  // closes. Thread-safe.
  virtual void prepare(const std::shared_ptr<const Picture>& /*picture*/) const {}
};

}  // namespace hw_sim
