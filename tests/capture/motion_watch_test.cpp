// Whole captures of a head that moves, or whose light changes: what the repeats of the first
// pattern say.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "capture/take.h"
#include "estimation/session/manifest.h"
#include "estimation/session/verify.h"
#include "tests/capture/watched_capture.h"

namespace capture {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::StartsWith;

TEST_F(WatchedCapture, StillHeadIsGoodAndTheSessionHoldsItsOwnSlotsAlone) {
  const CaptureResult result = capture([](double) { return Pose{}; });
  EXPECT_THAT(result.motion, StartsWith("good: "));
  EXPECT_EQ(told_before_the_maps_, result.motion);
  EXPECT_EQ(state_when_told_, "capturing") << "the verdict waited for the disk";
  const int slot_count = 2 * (40 + 2 * (2 * 8 + 4));  // eight bits of Gray code for 256 px
  EXPECT_EQ(last_total_, slot_count);
  EXPECT_THAT(result.message, HasSubstr("160 of 160 slots"));
  const auto verified = estimation::verify_session(result.session);
  ASSERT_TRUE(verified);
  EXPECT_TRUE(verified->problems.empty());
  EXPECT_EQ(verified->frame_count, slot_count);
  const nlohmann::json report = report_of(result);
  EXPECT_EQ(report["verdict"], "good");
  EXPECT_GT(report["verdict_ms"].get<double>(), 0);
  EXPECT_EQ(report["repeats"].size(), 4U);  // after 22, 44, 66 and all 80 patterns
  EXPECT_TRUE(report["reasons"].empty());
  EXPECT_TRUE(report["brief_changes"].empty());
}

TEST_F(WatchedCapture, DriftIsTheVerdictsReasonInPixelsAndMillimetres) {
  const CaptureResult little = capture([](double s) { return Pose{.stripes_px = 0.02 * s}; });
  EXPECT_THAT(little.motion, StartsWith("usable: "));
  EXPECT_THAT(little.motion, HasSubstr("the stripes moved by"));
  const CaptureResult much = capture([](double s) { return Pose{.stripes_px = 0.2 * s}; });
  EXPECT_THAT(much.motion, StartsWith("retake: "));
  const nlohmann::json last = report_of(much)["repeats"].back();
  const double expected_px = 0.2 * last["elapsed_s"].get<double>();
  EXPECT_NEAR(last["stripes_projector_px"].get<double>(), expected_px, 0.05 * expected_px);
  // At 1000 mm one projector px is 1000^2 / (800 * 250) = 5 mm in depth, a frame's px 3.3 sideways.
  EXPECT_NEAR(last["head_mm"].get<double>(), 5 * expected_px, 0.5 * expected_px);
}

TEST_F(WatchedCapture, ShuffledOrderBearsMoreDrift) {
  rig_file_.sequence.is_shuffled = true;
  const CaptureResult result = capture([](double s) { return Pose{.stripes_px = 0.02 * s}; });
  EXPECT_THAT(result.motion, StartsWith("good: "));
}

TEST_F(WatchedCapture, LightThatChangedIsToldFromAmbientLight) {
  const CaptureResult lamp = capture([](double s) { return Pose{.light = 1 - 0.004 * s}; });
  EXPECT_THAT(lamp.motion, StartsWith("usable: "));
  EXPECT_THAT(lamp.motion, HasSubstr("the projector's light changed by -"));
  const CaptureResult room =
      capture([](double s) { return Pose{.ambient_frac = s < 5 ? 0 : 0.03}; });
  EXPECT_THAT(room.motion, HasSubstr("ambient light changed by +"));
  EXPECT_THAT(room.motion, testing::Not(HasSubstr("the projector's light changed")));
}

TEST_F(WatchedCapture, BlinkAtARepeatHasItsPlace) {
  const CaptureResult still = capture([](double) { return Pose{}; });
  const double third_s = report_of(still)["repeats"][2]["elapsed_s"];
  const CaptureResult result = capture(
      [third_s](double s) { return Pose{.eye_light = std::abs(s - third_s) < 0.6 ? 0.5 : 1}; });
  EXPECT_THAT(result.motion, StartsWith("usable: "));
  EXPECT_THAT(result.motion, HasSubstr("(a blink?)"));
  const nlohmann::json places = report_of(result)["repeats"][2]["local_changes"];
  ASSERT_FALSE(places.empty());
  EXPECT_NEAR(places[0]["row_px"].get<double>(), StripedWorld::kEyeRow, 8);
  EXPECT_NEAR(places[0]["col_px"].get<double>(), StripedWorld::kEyeCol, 8);
}

// The patterns of the session that were exposed within a time from the first of them.
std::vector<int> patterns_within(const CaptureResult& result, double begin_s, double end_s) {
  const auto manifest = estimation::read_manifest(result.session);
  EXPECT_TRUE(manifest);
  std::vector<int> patterns;
  for (const estimation::FrameRecord& frame : manifest->frames) {
    const double at_s = 1e-9 * static_cast<double>(*frame.camera_timestamp_ns -
                                                   *manifest->frames.front().camera_timestamp_ns);
    const bool is_new = patterns.empty() || patterns.back() != frame.pattern;
    if (is_new && at_s >= begin_s && at_s < end_s) patterns.push_back(frame.pattern);
  }
  return patterns;
}

// At no repeat: of 80 patterns, each 22nd is followed by one. Nor under the four fringes after
// either Gray code, which have too few relatives.
TEST_F(WatchedCapture, BlinkBetweenRepeatsIsFoundUnderItsPatterns) {
  for (const double begin_s : {1.0, 4.28}) {  // under stripes and under Gray code
    SCOPED_TRACE(begin_s);
    const double end_s = begin_s + 0.2;
    const CaptureResult result =
        capture([=](double s) { return Pose{.eye_light = s >= begin_s && s < end_s ? 0.5 : 1}; });
    EXPECT_THAT(result.motion, StartsWith("usable: "));
    EXPECT_THAT(result.motion, HasSubstr("(a blink?) under patterns "));
    const nlohmann::json changes = report_of(result)["brief_changes"];
    ASSERT_EQ(changes.size(), 1U);
    EXPECT_NEAR(changes[0]["row_px"].get<double>(), StripedWorld::kEyeRow, 6);
    EXPECT_NEAR(changes[0]["col_px"].get<double>(), StripedWorld::kEyeCol, 10);
    EXPECT_LT(changes[0]["change_frac"].get<double>(), -0.1);
    const std::vector<int> blinked = patterns_within(result, begin_s, end_s);
    ASSERT_GE(blinked.size(), 2U);
    const auto named = changes[0]["patterns"].get<std::vector<int>>();
    EXPECT_GE(named.size(), 2U);
    // The world's time is from the priming, and of a Gray code's pair either may be the one.
    EXPECT_THAT(named, testing::Each(testing::AllOf(testing::Ge(blinked.front() - 3),
                                                    testing::Le(blinked.back() + 2))));
  }
}

TEST_F(WatchedCapture, FlashBetweenRepeatsIsToldAsOne) {
  const CaptureResult result =
      capture([](double s) { return Pose{.ambient_frac = s >= 2.3 && s < 2.4 ? 0.2 : 0}; });
  EXPECT_THAT(result.motion, HasSubstr("all over (a flash?) under pattern"));
  EXPECT_EQ(report_of(result)["brief_changes"].size(), 1U);
}

TEST_F(WatchedCapture, WithoutRepeatsNothingIsSaid) {
  rig_file_.sequence.repeat_every = 0;
  const CaptureResult result = capture([](double s) { return Pose{.stripes_px = s}; });
  EXPECT_EQ(result.motion, "");
  EXPECT_FALSE(fs::exists(result.session / "report/motion.json"));
}

TEST_F(WatchedCapture, PlansOfAnyKindAreJudged) {
  const auto paper = make_plan("paper", rig_file_.projector, rig_file_.sequence);
  ASSERT_TRUE(paper);
  const auto part = [&paper](std::size_t begin, std::size_t count) {
    Plan plan{"part", {}, {}, paper->exposures};
    for (std::size_t i = 0; i < count; ++i) {
      plan.patterns.push_back({static_cast<int>(i), paper->patterns[begin + i].kind});
      plan.order.push_back(static_cast<int>(i));
    }
    return plan;
  };
  struct Case {
    std::size_t begin, count, bracket_count;
    int repeat_every;
  };
  for (const Case& each : {Case{0, 40, 1, 22}, Case{40, 40, 2, 22}, Case{50, 2, 1, 1},
                           Case{7, 1, 2, 22}, Case{7, 1, 1, 1}}) {
    SCOPED_TRACE(each.begin);
    rig_file_.sequence.repeat_every = each.repeat_every;
    rig_file_.sequence.exposures = paper->exposures;
    rig_file_.sequence.exposures.resize(each.bracket_count);
    own_plan_ = part(each.begin, each.count);
    own_plan_->exposures = rig_file_.sequence.exposures;
    EXPECT_THAT(capture([](double) { return Pose{}; }).motion, StartsWith("good: "));
  }
}

TEST(Take, RepeatsComeAtOnceNowAndThenAndLast) {
  Plan plan{"test", {}, {2, 1, 0, 4, 3}, {std::chrono::microseconds(10)}};
  for (int i = 0; i < 5; ++i) plan.patterns.push_back({i, estimation::White{}});
  const Take take = make_take(plan, 2);
  EXPECT_EQ(take.plan.order, (std::vector<int>{2, 5, 1, 6, 0, 4, 7, 3, 8}));
  EXPECT_EQ(take.repeated, 2);
  EXPECT_EQ(take.name_of({6, 0}), "repeat 2 of pattern 2 bracket 0");
  EXPECT_EQ(take.session_slot({6, 0}), std::nullopt);
  EXPECT_EQ(take.session_slot({4, 0}), (SlotId{4, 0}));
  // Of two patterns that lack a frame.
  const Take rest = make_take(plan, {true, false, false, true, false}, 4, 22);
  EXPECT_EQ(rest.plan.order, (std::vector<int>{0, 1, 2}));
  EXPECT_EQ(rest.session_slot({1, 0}), (SlotId{3, 0}));
  EXPECT_EQ(rest.entry({2, 0}).pattern, 4);
  const Take none = make_take(plan, 0);
  EXPECT_EQ(none.plan.order, plan.order);
  EXPECT_EQ(make_repeat(plan, 3).plan.order, (std::vector<int>{0, 1}));
}

}  // namespace
}  // namespace capture
