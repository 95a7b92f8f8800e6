// The X server dies below the projector. A program of its own: afterwards GLFW is of no use.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "tests/contract/projector_events.h"
#include "tests/wire/display/display_fixture.h"

namespace {

TEST(GlfwProjector, DeadXServerIsAFaultAndNotTheEndOfTheProcess) {
  rig::EventQueue events;
  auto projector = rig::GlfwProjector::open(display_test::projector_settings(), events);
  ASSERT_TRUE(projector) << projector.error().detail;
  display_test::screen().crash();

  const rig::Result<void> ran = (*projector)->run({});

  ASSERT_FALSE(ran);
  EXPECT_EQ(ran.error().fault, rig::Fault::kDeviceLost);
  const std::optional<rig::Event> event =
      events.wait(events.now() + rig::contract::kEventPatience, {});
  ASSERT_TRUE(event);
  ASSERT_TRUE(std::holds_alternative<rig::DeviceFault>(*event));
  EXPECT_FALSE((*projector)->show({.show_id = 1}));

  projector->reset();
  const auto again = rig::GlfwProjector::open(display_test::projector_settings(), events);
  ASSERT_FALSE(again);
  EXPECT_EQ(again.error().fault, rig::Fault::kDeviceLost);
}

}  // namespace
