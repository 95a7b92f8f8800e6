// A frame that fills its slot, on its way from the session thread to those that use it.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "capture/ledger.h"
#include "capture/plan.h"
#include "estimation/base/image.h"
#include "rig/frame.h"

namespace capture {

struct CapturedFrame {
  SlotId slot;
  std::chrono::microseconds exposure{0};  // the bracket's
  Evidence evidence;
  // Shared: the write thread and the estimate thread both read it, and the last one to finish gives
  // the buffer back to the camera.
  std::shared_ptr<const rig::Frame> frame;
};

// Takes the frames of one capture, each slot once, in the order in which they were proved.
class FrameConsumer {
 public:
  virtual ~FrameConsumer() = default;
  // On the session thread: hands over and returns.
  virtual void consume(const CapturedFrame& frame) = 0;
  // One sentence once frames can no longer be taken; ends the capture. On the session thread.
  virtual std::optional<std::string> failure() const = 0;
};

// The samples of a frame as DN, [height_px][width_px][channels]: borrowed where the frame has 16
// bits, widened where it has 8. The frame outlives it.
class FrameSamples {
 public:
  explicit FrameSamples(const rig::Frame& frame);
  FrameSamples(const FrameSamples&) = delete;
  FrameSamples& operator=(const FrameSamples&) = delete;
  estimation::ImageView<const std::uint16_t> view() const { return view_; }

 private:
  estimation::Image<std::uint16_t> widened_;
  estimation::ImageView<const std::uint16_t> view_;
};

}  // namespace capture
