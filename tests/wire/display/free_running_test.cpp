// A display that does not wait for its refresh: this program is not linked to the GLX shim.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/contract/projector_events.h"
#include "tests/wire/display/display_fixture.h"

namespace {

TEST(FreeRunningDisplay, IsReportedAndStillShows) {
  display_test::run_projector(display_test::projector_settings(),
                              [](rig::Projector& projector, rig::EventSource& events) {
                                const rig::DisplayReport report = projector.report();
                                EXPECT_FALSE(report.is_vsynced);
                                EXPECT_THAT(report.text, testing::HasSubstr("not synchronised"));
                                ASSERT_TRUE(projector.show({.show_id = 1}));
                                EXPECT_TRUE(rig::contract::wait_for_shown(events));
                              });
}

}  // namespace
