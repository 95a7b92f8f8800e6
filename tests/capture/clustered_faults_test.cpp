// Several faults at once, with light, reports and frames that are late: what once came out complete
// and wrong, and a draw of others.
#include "tests/capture/clustered_faults.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/capture/expect_promise.h"

namespace capture {
namespace {

using enum hw_sim::FaultKind;
using std::chrono::microseconds;
using std::chrono::milliseconds;

Cluster cluster_on(rig::SyncMode sync, int shorter_ms, int longer_ms) {
  Cluster cluster;
  cluster.rig_file =
      sync == rig::SyncMode::kTriggerBox ? ledger_rig_file() : boxless_rig_file(sync);
  cluster.rig_file.sequence.exposures = {milliseconds(shorter_ms), milliseconds(longer_ms)};
  return cluster;
}

// Flips of the run before are on their way through a slow display when the next is armed: taken
// for the priming's, they put every frame after it one or two pictures off.
TEST(SlowDisplay, FlipsOfTheRunBeforeAreNotTheNextOnes) {
  for (const bool tells_level : {true, false})
    for (const auto sync : {rig::SyncMode::kTriggerBox, rig::SyncMode::kCameraLine})
      for (const auto pace : {rig::Pace::kHandshake, rig::Pace::kPaced})
        for (int light_ms = 40; light_ms <= 80; light_ms += 2)
          for (const int bracket : {0, 1}) {
            SCOPED_TRACE(testing::Message()
                         << "level " << tells_level << ", sync " << static_cast<int>(sync)
                         << ", pace " << static_cast<int>(pace) << ", light +" << light_ms
                         << " ms, bracket " << bracket);
            Cluster cluster = cluster_on(sync, 10, 40);
            cluster.rig_file.sequence.pace = pace;
            cluster.camera.has_line_status = tells_level;
            cluster.display.input_lag_refreshes = 3;
            cluster.display.light_delay = milliseconds(light_ms);
            cluster.faults.faults.push_back(fault_at(kExposureStuck, 40, bracket, 2));
            const Trial trial = try_cluster(cluster);
            expect_promise(trial);
            EXPECT_EQ(trial.outcome, Outcome::kComplete);
          }
}

// With a box and no lag: a stray exposure while the next picture comes up, and no time left for
// the picture's own pulse.
TEST(StrayExposure, DoesNotStandForThePulseThatItLeavesNoTimeFor) {
  for (const auto bracketing : {rig::Bracketing::kSequencer, rig::Bracketing::kTriggerWidth})
    for (const int gap_us : {1500, 5000})
      for (int longer_ms = 23; longer_ms < 60; longer_ms += 3)
        for (int showing = 40; showing < 46; ++showing)
          for (const int bracket : {0, 1}) {
            SCOPED_TRACE(testing::Message()
                         << "bracketing " << static_cast<int>(bracketing) << ", gap " << gap_us
                         << " us, " << longer_ms << " ms, showing " << showing << "." << bracket);
            Cluster cluster = cluster_on(rig::SyncMode::kTriggerBox, 20, longer_ms);
            cluster.rig_file.camera.bracketing = bracketing;
            cluster.rig_file.trigger.gap = microseconds(gap_us);
            cluster.display.input_lag_refreshes = 0;
            cluster.faults.faults.push_back(fault_at(kTriggerDoubled, showing, bracket));
            const Trial trial = try_cluster(cluster);
            expect_promise(trial);
            EXPECT_EQ(trial.outcome, Outcome::kComplete);
          }
}

// Without chunks a stray in the gap between two pulses has the later one's number.
TEST(StrayExposure, OfAMillisecondIsNoBracketOfACameraWithoutChunks) {
  Cluster cluster = cluster_on(rig::SyncMode::kTriggerBox, 5, 65);
  cluster.rig_file.camera.bracketing = rig::Bracketing::kTriggerWidth;
  cluster.camera.has_chunks = false;
  cluster.camera.transfer = milliseconds(68);
  cluster.faults.faults.push_back(fault_at(kTriggerDoubled, 7, 0, 3));
  expect_promise(try_cluster(cluster));
}

// Flips that are late come all at once, and the box answers one of them: from there on each edge
// would be taken for that of a flip before.
TEST(PacedFlips, ThatComeAllAtOnceAreNotOne) {
  for (const auto bracketing : {rig::Bracketing::kSequencer, rig::Bracketing::kTriggerWidth})
    for (int lag = 0; lag <= 3; ++lag)
      for (int late_ms = 40; late_ms <= 240; late_ms += 4) {
        SCOPED_TRACE(testing::Message() << "bracketing " << static_cast<int>(bracketing) << ", lag "
                                        << lag << ", late by " << late_ms << " ms");
        Cluster cluster = cluster_on(rig::SyncMode::kTriggerBox, 5, 8);
        cluster.rig_file.camera.bracketing = bracketing;
        cluster.rig_file.sequence.pace = rig::Pace::kPaced;
        cluster.rig_file.trigger.gap = microseconds(2200);
        cluster.display.input_lag_refreshes = lag;
        // Both flips that teach the lag, and one more.
        cluster.faults.faults.push_back(fault_at(kFlipLate, 0, 0, 3));
        cluster.faults.faults.back().duration = milliseconds(late_ms);
        expect_promise(try_cluster(cluster));
      }
}

// Two flips unseen, and a clock that steps back by as long as they took.
TEST(NoLevel, FlipsThatDoNotWaitForEachOtherAreNotToldApartByTimeAlone) {
  for (int step_ms = 90; step_ms <= 190; step_ms += 10) {
    SCOPED_TRACE(step_ms);
    Cluster cluster = cluster_on(rig::SyncMode::kCameraLine, 10, 70);
    cluster.rig_file.sequence.pace = rig::Pace::kPaced;
    cluster.camera.has_line_status = false;
    cluster.camera.transfer = milliseconds(68);
    cluster.faults.faults.push_back(fault_at(kEdgeMissed, 15, 0, 2));
    cluster.faults.faults.push_back(fault_at(kClockStep, 15));
    cluster.faults.faults.back().duration = milliseconds(-step_ms);
    expect_promise(try_cluster(cluster));
  }
}

// The same where the level is told: two flips leave it as it is, but frames come later from then
// on.
TEST(PacedFlips, ThatNobodySawAndAClockThatStepsBackByThemAreTold) {
  for (const int showing : {15, 81})
    for (int step_ms = 90; step_ms <= 190; step_ms += 2) {
      SCOPED_TRACE(testing::Message() << "showing " << showing << ", " << step_ms << " ms");
      Cluster cluster = cluster_on(rig::SyncMode::kCameraLine, 20, 30);
      cluster.rig_file.sequence.pace = rig::Pace::kPaced;
      cluster.display.input_lag_refreshes = 3;
      cluster.display.report_delay = milliseconds(16);
      cluster.faults.faults.push_back(fault_at(kTriggerMissed, showing, 0, 2));
      cluster.faults.faults.push_back(fault_at(kClockStep, showing + 2));
      cluster.faults.faults.back().duration = milliseconds(-step_ms);
      cluster.faults.faults.push_back(fault_at(kFrameTruncated, showing + 2, 1));
      const Trial trial = try_cluster(cluster);
      expect_promise(trial);
      EXPECT_EQ(trial.outcome, Outcome::kComplete);
    }
}

TEST(PacedFlips, WhoseFramesStayLateEndComplete) {
  for (const int count : {1, 7, 8, 9, 10, 30, 120}) {
    SCOPED_TRACE(count);
    Cluster cluster = cluster_on(rig::SyncMode::kCameraLine, 20, 30);
    cluster.rig_file.sequence.pace = rig::Pace::kPaced;
    cluster.faults.faults.push_back(fault_at(kFrameLate, 40, 0, count));
    const Trial trial = try_cluster(cluster);
    expect_promise(trial);
    EXPECT_EQ(trial.outcome, Outcome::kComplete);
  }
}

// Frames of such a link queue up, later by the frame, and restart nothing.
TEST(PacedFlips, OutrunASlowLinkWithoutHarm) {
  for (const auto sync : {rig::SyncMode::kTriggerBox, rig::SyncMode::kCameraLine})
    for (const int transfer_ms : {34, 69, 110, 160}) {
      SCOPED_TRACE(testing::Message() << static_cast<int>(sync) << ", " << transfer_ms << " ms");
      Cluster cluster = cluster_on(sync, 8, 33);
      cluster.rig_file.sequence.pace = rig::Pace::kPaced;
      cluster.camera.transfer = milliseconds(transfer_ms);
      const Trial trial = try_cluster(cluster);
      expect_promise(trial);
      EXPECT_EQ(trial.outcome, Outcome::kComplete) << trial.text;
      EXPECT_THAT(trial.done, testing::IsEmpty());
    }
}

// A photodiode that chatters at edges, while the next flip is in the display.
TEST(PacedFlips, MayBounce) {
  for (int lag = 0; lag <= 3; ++lag) {
    SCOPED_TRACE(lag);
    Cluster cluster = cluster_on(rig::SyncMode::kTriggerBox, 4, 6);
    cluster.rig_file.sequence.pace = rig::Pace::kPaced;
    cluster.display.input_lag_refreshes = lag;
    cluster.faults.faults.push_back(fault_at(kEdgeBounced, 20, 0, 40));
    const Trial trial = try_cluster(cluster);
    expect_promise(trial);
    EXPECT_EQ(trial.outcome, Outcome::kComplete) << trial.text;
    EXPECT_THAT(trial.done, testing::IsEmpty());
  }
}

// A flip that nothing was heard of until long after its deadline, or only black makes up for.
TEST(NoLevel, WhatChangesAfterARunIsArmedAgainIsNotThePriming) {
  Cluster slow = cluster_on(rig::SyncMode::kCameraLine, 20, 30);
  slow.camera.has_line_status = false;
  slow.camera.transfer = milliseconds(68);
  slow.display.input_lag_refreshes = 3;
  for (int late_ms = 1400; late_ms <= 2400; late_ms += 10) {
    SCOPED_TRACE(late_ms);
    Cluster cluster = slow;
    cluster.faults.faults.push_back(fault_at(kFlipLate, 51));
    cluster.faults.faults.back().duration = milliseconds(late_ms);
    expect_promise(try_cluster(cluster));
  }
  for (int light_ms = 40; light_ms <= 80; light_ms += 2) {
    SCOPED_TRACE(light_ms);
    Cluster cluster = slow;
    cluster.display.light_delay = milliseconds(light_ms);
    cluster.faults.faults.push_back(fault_at(kEdgeMissed, 63, 1));
    expect_promise(try_cluster(cluster));
  }
}

TEST(ClusteredFaults, EndCompleteOrFailedButNeverWrong) {
  constexpr std::uint64_t kCount = 60;
  for (const MatrixRig& rig : cluster_rigs()) {
    int complete_count = 0;
    for (std::uint64_t seed = 1; seed <= kCount; ++seed) {
      const Cluster cluster = draw_cluster(rig, seed);
      SCOPED_TRACE(rig.name + ", seed " + std::to_string(seed) + ": " + cluster.text());
      const Trial trial = try_cluster(cluster);
      expect_promise(trial);
      if (trial.outcome == Outcome::kComplete) ++complete_count;
    }
    EXPECT_GT(complete_count, static_cast<int>(kCount) * 2 / 3) << rig.name;
  }
}

}  // namespace
}  // namespace capture
