// The X server stands still below the projector. A program of its own: afterwards GLFW is of no
// use.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>

#include "tests/contract/projector_events.h"
#include "tests/wire/display/display_fixture.h"

namespace {

TEST(GlfwProjector, XServerThatStandsStillIsLostAfterItsDeadline) {
  rig::ProjectorSettings settings = display_test::projector_settings();
  settings.server_deadline = std::chrono::seconds(2);
  rig::EventQueue events;
  auto projector = rig::GlfwProjector::open(settings, events);
  ASSERT_TRUE(projector) << projector.error().detail;
  ASSERT_TRUE((*projector)->show({.show_id = 1, .is_square_light = true}));
  display_test::screen().freeze();

  const rig::Result<void> ran = (*projector)->run({});

  ASSERT_FALSE(ran);
  EXPECT_EQ(ran.error().fault, rig::Fault::kDeviceLost);
  EXPECT_THAT(ran.error().detail, testing::HasSubstr("did not answer for 2 s"));
  const std::optional<rig::Event> event =
      events.wait(events.now() + rig::contract::kEventPatience, {});
  ASSERT_TRUE(event);
  EXPECT_TRUE(std::holds_alternative<rig::DeviceFault>(*event)) << "what was asked was not shown";
  EXPECT_FALSE((*projector)->show({.show_id = 2}));
}

}  // namespace
