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
void expect_exposure_with_the_pulse(WireBench& bench) {
  constexpr microseconds kPulse = milliseconds(30);
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

TEST(CameraAsItWasLeft, ExposesWithThePulse) {
  for (const rig::Bracketing bracketing :
       {rig::Bracketing::kSequencer, rig::Bracketing::kTriggerWidth}) {
    WireBench bench(bracketing);
    expect_exposure_with_the_pulse(bench);
  }
}

TEST(CameraAsItWasLeft, MayTellItsTimesAsIntegers) {
  WireBench bench;
  bench.options.variant.has_integer_times = true;
  expect_exposure_with_the_pulse(bench);
}

TEST(CameraAsItWasLeft, MayHaveALineInverterWithoutALineSelector) {
  WireBench bench;
  bench.options.variant.has_line_selector = false;
  expect_exposure_with_the_pulse(bench);
}

TEST(CameraAsItWasLeft, MayHaveALineThatCannotBeChanged) {
  WireBench bench;
  bench.options.variant.fixed_features = {"TriggerDelay", "LineInverter", "LineDebouncerTime"};
  expect_exposure_with_the_pulse(bench);
}

// A trigger box's pulse may be shorter than the debouncer that somebody set.
TEST(CameraAsItWasLeft, LosesItsDebouncerAndSaysSo) {
  WireBench bench;
  bench.options.variant.line_debounce_us = 250;
  const auto camera = bench.open();
  ASSERT_TRUE(camera.has_value()) << camera.error().detail;
  EXPECT_FLOAT_EQ(bench.device().line_debounce_us(), 0);
  EXPECT_THAT((*camera)->identity().note, HasSubstr("LineDebouncerTime 250 us, now 0 us"));
}

TEST(CameraAsItWasLeft, NeedNotTellHowItLooks) {
  WireBench bench;
  bench.options.variant.refused_features = {"Gain", "BlackLevel", "BalanceWhiteAuto",
                                            "BalanceRatio"};
  const auto camera = bench.open();
  EXPECT_TRUE(camera.has_value()) << camera.error().detail;
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
  bench_.options.variant.gain_db = 6;
  ASSERT_TRUE(open());
  bench_.power_off();
  bench_.options.variant.gain_db = 0;
  const auto again = open();
  ASSERT_TRUE(again) << again.error().detail;
  EXPECT_FLOAT_EQ(bench_.device().gain_db(), 6);
}

// The second falls to the step below when it is written as it was read, the first only when it is
// written with six digits.
TEST_F(Reopened, HasAGainOfManyDigits) {
  constexpr double kStep_db = 0.0359133;
  bench_.options.variant.gain_step_db = kStep_db;
  for (const int step_count : {180, 213}) {
    const auto gain_db = static_cast<float>(step_count * kStep_db);
    SCOPED_TRACE(step_count);
    bench_.power_off();
    past_.reset();
    bench_.options.variant.gain_db = gain_db;
    ASSERT_TRUE(open());
    bench_.power_off();
    bench_.options.variant.gain_db = 0;
    const auto again = open();
    ASSERT_TRUE(again) << again.error().detail;
    EXPECT_FLOAT_EQ(bench_.device().gain_db(), gain_db);
  }
}

// Which is in units of the pixel format, and this is not the one that the camera powers up with.
TEST_F(Reopened, HasTheBlackLevelThatItHad) {
  bench_.options.pixel_formats = {"BayerRG8", "BayerRG12"};
  bench_.options.variant.black_level_dn = 8;
  ASSERT_TRUE(open());
  EXPECT_FLOAT_EQ(bench_.device().black_level_dn(), 128);
  bench_.power_off();
  bench_.options.variant.black_level_dn = 0;
  const auto again = open();
  ASSERT_TRUE(again) << again.error().detail;
  EXPECT_FLOAT_EQ(bench_.device().black_level_dn(), 128);
}

TEST_F(Reopened, HasTheColoursThatItHad) {
  bench_.options.variant.balance_ratios = {1.75F, 1, 2.125F};
  ASSERT_TRUE(open());
  bench_.power_off();
  bench_.options.variant.balance_ratios = {1, 1, 1};
  const auto again = open();
  ASSERT_TRUE(again) << again.error().detail;
  EXPECT_FLOAT_EQ(bench_.device().balance_ratio(0), 1.75F);
  EXPECT_FLOAT_EQ(bench_.device().balance_ratio(1), 1);
  EXPECT_FLOAT_EQ(bench_.device().balance_ratio(2), 2.125F);
}

TEST_F(Reopened, NamesWhatItCannotBeSetTo) {
  bench_.options.variant.gain_db = 7.5F;
  ASSERT_TRUE(open());
  bench_.power_off();
  bench_.options.variant.gain_db = 2;
  bench_.options.variant.fixed_features = {"Gain"};
  const auto again = open();
  ASSERT_FALSE(again);
  EXPECT_EQ(again.error().fault, rig::Fault::kReadBackMismatch);
  EXPECT_THAT(again.error().detail, HasSubstr("Gain is 2 and was 7.5"));
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
