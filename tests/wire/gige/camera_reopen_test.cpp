// A camera as another program left it, and as it comes back after it was lost.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/wire/gige/wire_bench.h"

namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::HasSubstr;

// The simulated camera powers up with a delayed trigger and an inverted line.
TEST(CameraAsItWasLeft, ExposesWithThePulse) {
  constexpr microseconds kPulse = milliseconds(30);
  for (const rig::Bracketing bracketing :
       {rig::Bracketing::kSequencer, rig::Bracketing::kTriggerWidth}) {
    WireBench bench(bracketing);
    const auto camera = bench.open();
    ASSERT_TRUE(camera.has_value()) << camera.error().detail;
    ASSERT_TRUE((*camera)->arm({kPulse}, 1).has_value());
    const auto clock = (*camera)->read_clock();
    ASSERT_TRUE(clock.has_value()) << clock.error().detail;
    const rig::HostTime start = rig::HostClock::now();
    bench.device().pulse(start, kPulse);
    auto event = bench.source().wait(rig::HostClock::now() + seconds(10), {});
    ASSERT_TRUE(event && std::holds_alternative<rig::FrameArrived>(*event));
    const auto begun =
        clock->host + (std::get<rig::FrameArrived>(*event).frame.timestamp - clock->device);
    EXPECT_LT(std::chrono::abs(begun - start), milliseconds(5) + clock->uncertainty);
  }
}

class Reopened : public testing::Test {
 protected:
  rig::Result<std::unique_ptr<rig::AravisCamera>> open() {
    if (const auto started = bench_.start(); !started) return tl::unexpected(started.error());
    auto camera = rig::AravisCamera::open(bench_.settings, bench_.source(), past_);
    if (camera) past_ = (*camera)->past();
    return camera;
  }

  WireBench bench_;
  std::optional<rig::CameraPast> past_;
};

TEST_F(Reopened, HasTheGainThatItHad) {
  bench_.options.gain_db = 6;
  ASSERT_TRUE(open());
  bench_.power_off();
  bench_.options.gain_db = 0;
  const auto again = open();
  ASSERT_TRUE(again) << again.error().detail;
  EXPECT_FLOAT_EQ(bench_.device().gain_db(), 6);
}

TEST_F(Reopened, IsNoOtherCameraOfItsKind) {
  ASSERT_TRUE(open());
  bench_.power_off();
  bench_.options.serial = "SIM0002";
  const auto again = open();
  ASSERT_FALSE(again);
  EXPECT_EQ(again.error().fault, rig::Fault::kNotFound);
  EXPECT_THAT(again.error().detail, HasSubstr("SIM0002"));
  EXPECT_THAT(again.error().detail, HasSubstr("SIM0001"));
}

}  // namespace
