// A private X server for a test program, and a GlfwProjector on its second monitor.
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <stop_token>
#include <thread>
#include <utility>

#include "hw_sim/display/virtual_screen.h"
#include "rig/devices/glfw_projector.h"
#include "rig/event.h"
#include "rig/projector.h"

namespace display_test {

inline constexpr int kWidth_px = 320;  // small: llvmpipe shares the computer with other tests
inline constexpr int kHeight_px = 240;

inline hw_sim::VirtualScreenSettings screen_settings() {
  return {.projector_width_px = kWidth_px, .projector_height_px = kHeight_px};
}

inline rig::ProjectorSettings projector_settings() {
  rig::ProjectorSettings settings;
  settings.monitor = hw_sim::VirtualScreen::kProjectorOutput;
  settings.width_px = kWidth_px;
  settings.height_px = kHeight_px;
  settings.sync_square.size_px = 32;
  return settings;
}

// The X server of this test program, with DISPLAY set to it by main().
hw_sim::VirtualScreen& screen();

using Body = std::function<void(rig::GlfwProjector&, rig::EventSource&)>;

// Serves the window on the main thread, as GLFW wants it, and runs `body` on another.
inline void run_projector(const rig::ProjectorSettings& settings, const Body& body) {
  rig::EventQueue events;
  rig::Result<std::unique_ptr<rig::GlfwProjector>> projector =
      rig::GlfwProjector::open(settings, events);
  ASSERT_TRUE(projector) << projector.error().detail;
  std::stop_source body_ended;
  const std::jthread session([&] {
    body(**projector, events);
    body_ended.request_stop();
  });
  const rig::Result<void> ran = (*projector)->run(body_ended.get_token());
  EXPECT_TRUE(ran) << ran.error().detail;
}

}  // namespace display_test
