// What a camera under test needs around it: a trigger line, a clock and the session's queue.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include "rig/camera.h"
#include "rig/event.h"

// A camera's surroundings: its trigger line and the session thread's queue.
class CameraBench {
 public:
  virtual ~CameraBench() = default;
  // The camera posts to source(). It is closed before the bench goes.
  virtual rig::Result<std::unique_ptr<rig::Camera>> open() = 0;
  // A pulse on the trigger line that rises now (source().now()) and lasts `width`. Returns at once.
  virtual void pulse(std::chrono::microseconds width) = 0;
  virtual rig::EventSource& source() = 0;
  // From the end of an exposure until the camera takes the next pulse, at most.
  virtual std::chrono::microseconds readout() const = 0;
};

struct CameraBenchMaker {
  std::string name;
  std::function<std::unique_ptr<CameraBench>()> make;
};

inline std::string camera_bench_name(const testing::TestParamInfo<CameraBenchMaker>& info) {
  return info.param.name;
}
