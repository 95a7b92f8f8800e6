// Plans of faults as files, and how a schedule carries them out.
#include "hw_sim/faults/fault_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "hw_sim/faults/fault_schedule.h"

namespace hw_sim {
namespace {

using testing::HasSubstr;

rig::Result<FaultPlan> parse(const std::string& toml) {
  return parse_fault_plan(toml, "plan.toml");
}

std::string error_of(const std::string& toml) {
  const auto plan = parse(toml);
  if (plan) return "no error";
  EXPECT_EQ(plan.error().fault, rig::Fault::kConfiguration);
  return plan.error().detail;
}

// One showing of two brackets; the frames' faults.
std::vector<ShotFaults> show(FaultSchedule& schedule) {
  std::vector<ShotFaults> shots;
  schedule.train_started();
  for (int bracket = 0; bracket < 2; ++bracket) {
    schedule.pulse_started(bracket);
    shots.push_back(schedule.take_shot());
  }
  return shots;
}

TEST(FaultPlan, SaysWhatWhereAndHowOften) {
  const auto plan = parse(
      "seed = 9\n"
      "faults = [{fault = \"frame_lost\", slot = 17, bracket = 1, count = 2},\n"
      "          {fault = \"flip_late\", rate_frac = 0.25, duration_ms = 50},\n"
      "          {fault = \"gamma_wrong\", at = \"idle\", gamma_exponent = 1.8}]\n");
  ASSERT_TRUE(plan) << plan.error().detail;
  EXPECT_EQ(plan->seed, 9U);
  ASSERT_EQ(plan->faults.size(), 3U);
  EXPECT_EQ(plan->faults[0].kind, FaultKind::kFrameLost);
  EXPECT_EQ(plan->faults[0].place, (FaultPlace{showing_of_slot(17), 1}));
  EXPECT_EQ(plan->faults[0].count, 2);
  EXPECT_FALSE(plan->faults[1].place);
  EXPECT_EQ(plan->faults[1].rate_frac, 0.25);
  EXPECT_EQ(plan->faults[1].duration, std::chrono::milliseconds(50));
  EXPECT_EQ(plan->faults[2].place, (FaultPlace{kIdle, 0}));
  EXPECT_EQ(plan->faults[2].gamma_exponent, 1.8);
}

TEST(FaultPlan, ExampleIsAPlan) {
  const auto plan = read_fault_plan(FAULTS_EXAMPLE);
  ASSERT_TRUE(plan) << plan.error().detail;
  EXPECT_GT(plan->faults.size(), 5U);
}

TEST(FaultPlan, NamesOfAllKindsAreUnderstood) {
  for (int kind = 0; kind < kFaultKindCount; ++kind)
    EXPECT_EQ(parse_fault_kind(to_string(static_cast<FaultKind>(kind))),
              static_cast<FaultKind>(kind));
  EXPECT_FALSE(parse_fault_kind("frame_lots"));
}

TEST(FaultPlan, MistakesAreNamedWithLineAndRemedy) {
  EXPECT_THAT(error_of("faults = [\n"), HasSubstr("plan.toml:"));
  EXPECT_THAT(error_of("\nsed = 1\n"),
              HasSubstr("plan.toml:2: unknown key sed; a plan has seed and faults"));
  EXPECT_THAT(error_of("seed = -1\n"), HasSubstr("plan.toml:1: seed is no whole number from 0"));
  EXPECT_THAT(error_of("faults = 3\n"), HasSubstr("write faults = ["));
  EXPECT_THAT(error_of("faults = [\n\n{slot = 3}]\n"),
              HasSubstr("plan.toml:3: an entry without a"));
  EXPECT_THAT(error_of("faults = [{fault = \"frame_lots\", slot = 3}]\n"),
              HasSubstr("\"frame_lots\" is no fault; there are packet_loss, "));
  EXPECT_THAT(error_of("faults = [{fault = \"frame_lost\"}]\n"),
              HasSubstr("frame_lost needs one of slot = 17, at = \"priming\" and rate_frac"));
  EXPECT_THAT(error_of("faults = [{fault = \"frame_lost\", slot = 3, rate_frac = 0.1}]\n"),
              HasSubstr("needs one of"));
  EXPECT_THAT(error_of("faults = [{fault = \"frame_lost\", slot = -3}]\n"),
              HasSubstr("slot is no whole number from 0 to 9999"));
  EXPECT_THAT(error_of("faults = [{fault = \"frame_lost\", at = \"idle\"}]\n"),
              HasSubstr("frame_lost cannot happen while idle; give it a slot"));
  EXPECT_THAT(error_of("faults = [{fault = \"usb_gap\", at = \"noon\"}]\n"),
              HasSubstr("at is \"idle\" or \"priming\""));
  EXPECT_THAT(error_of("faults = [{fault = \"flip_late\", slot = 3, bracket = 1}]\n"),
              HasSubstr("concerns a whole pattern; leave bracket out"));
  EXPECT_THAT(
      error_of("faults = [{fault = \"frame_lost\", slot = 3, duration_ms = 5}]\n"),
      HasSubstr("frame_lost has no duration_ms; it has slot, at, bracket, count, rate_frac"));
  EXPECT_THAT(error_of("faults = [{fault = \"packet_loss\", rate_frac = 1.5}]\n"),
              HasSubstr("rate_frac is no number from 0 to 1"));
  EXPECT_THAT(error_of("faults = [{fault = \"frame_lost\", slot = 3, count = 0}]\n"),
              HasSubstr("count is no whole number from 1"));
  const auto missing = read_fault_plan("/nonexistent/plan.toml");
  ASSERT_FALSE(missing);
  EXPECT_THAT(missing.error().detail, HasSubstr("/nonexistent/plan.toml: cannot be read"));
}

TEST(FaultSchedule, HitsItsPlaceSoOftenAndNoMore) {
  PlannedFault lost = default_fault(FaultKind::kFrameLost);
  lost.place = FaultPlace{showing_of_slot(1), 1};
  lost.count = 2;
  FaultSchedule schedule({.seed = 1, .faults = {lost}});
  schedule.opened();
  schedule.armed();
  std::vector<bool> is_lost;
  for (int showing = 0; showing < 5; ++showing)
    for (const ShotFaults& shot : show(schedule)) is_lost.push_back(shot.is_lost);
  EXPECT_THAT(is_lost, testing::ElementsAre(false, false, false, false, false, true, true, false,
                                            false, false));
  EXPECT_THAT(schedule.happened(), testing::ElementsAre("frame_lost at slot 1, bracket 1",
                                                        "frame_lost at slot 2, bracket 0"));
  EXPECT_TRUE(schedule.outstanding().empty());
}

TEST(FaultSchedule, FlipsAreOfTheShowingToCome) {
  PlannedFault missed = default_fault(FaultKind::kEdgeMissed);
  missed.place = FaultPlace{kPrimingShowing, 0};
  FaultSchedule schedule({.seed = 1, .faults = {missed}});
  schedule.opened();
  EXPECT_FALSE(schedule.take_flip().is_edge_missed) << "nothing is armed";
  schedule.armed();
  EXPECT_TRUE(schedule.take_flip().is_edge_missed);
  EXPECT_FALSE(schedule.take_flip().is_edge_missed);
}

TEST(FaultSchedule, RestIsBetweenOpeningAndArming) {
  PlannedFault gone = default_fault(FaultKind::kCameraRebooted);
  gone.place = FaultPlace{kIdle, 0};
  FaultSchedule schedule({.seed = 1, .faults = {gone}});
  EXPECT_FALSE(schedule.take(FaultKind::kCameraRebooted));
  schedule.opened();
  EXPECT_TRUE(schedule.take(FaultKind::kCameraRebooted));
  EXPECT_FALSE(schedule.take(FaultKind::kCameraRebooted));
}

TEST(FaultSchedule, RatesAreDrawnFromTheSeed) {
  const auto lost_count = [](std::uint64_t seed) {
    PlannedFault lost = default_fault(FaultKind::kFrameLost);
    lost.rate_frac = 0.1;
    lost.count = 1'000'000;
    FaultSchedule schedule({.seed = seed, .faults = {lost}});
    schedule.armed();
    std::vector<int> lost_shots;
    for (int showing = 0; showing < 1000; ++showing)
      for (const ShotFaults& shot : show(schedule))
        if (shot.is_lost) lost_shots.push_back(showing);
    return lost_shots;
  };
  EXPECT_EQ(lost_count(1), lost_count(1));
  EXPECT_NE(lost_count(1), lost_count(2));
  // 2000 draws of 0.1: 200 with a standard deviation of 13.4.
  EXPECT_THAT(lost_count(1).size(), testing::AllOf(testing::Gt(140U), testing::Lt(260U)));
}

}  // namespace
}  // namespace hw_sim
