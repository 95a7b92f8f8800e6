// The ledger against evidence that does not agree.
#include "capture/ledger.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>
#include <vector>

namespace capture {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;

class LedgerTest : public testing::Test {
 protected:
  static LedgerRules rules() {
    LedgerRules rules;
    rules.exposures = {milliseconds(10), milliseconds(40)};
    rules.gap = milliseconds(5);
    return rules;
  }
  LedgerTest() {
    ledger_.start_run();
    showing(kPrimePattern);
    for (const auto& frame : frames_) ledger_.frame_seen(frame, now_);
    EXPECT_TRUE(judge().empty());
    EXPECT_TRUE(ledger_.is_primed());
    showing(0);
  }

  // A showing as it should be; leaves its two frames in frames_.
  void showing(int pattern) {
    frames_.clear();
    is_light_ = !is_light_;
    ledger_.open_showing({pattern, 0, ++show_id_, is_light_, now_});
    EXPECT_TRUE(ledger_.picture_shown({show_id_, now_ + milliseconds(10)}).empty());
    now_ += milliseconds(30);
    EXPECT_TRUE(ledger_.edge_seen({++edge_number_, is_light_, now_}, now_).empty());
    for (int bracket = 0; bracket < 2; ++bracket) {
      const rig::HostTime start = now_;
      now_ += bracket == 0 ? milliseconds(10) : milliseconds(40);
      EXPECT_TRUE(
          ledger_.pulse_ended({edge_number_, bracket, ++pulse_number_, start, now_}, now_).empty());
      now_ += milliseconds(5);
      FrameFacts facts;
      facts.ticket = pulse_number_;
      facts.block_id = pulse_number_;
      facts.trigger_count = pulse_number_;
      facts.timestamp = rig::CameraClock::time_point(start.time_since_epoch() + milliseconds(777));
      facts.received = now_;
      facts.exposure = bracket == 0 ? milliseconds(10) : milliseconds(40);
      frames_.push_back(facts);
    }
  }
  // The findings; what was kept goes to kept_.
  Findings judge() {
    Findings findings;
    for (const Verdict& verdict : ledger_.judge(findings))
      if (verdict.slot) kept_.push_back(*verdict.slot);
    return findings;
  }
  // What the ledger says of one frame.
  std::optional<Incident> incident_of_frame(const FrameFacts& facts) {
    ledger_.frame_seen(facts, now_);
    const Findings findings = judge();
    return findings.empty() ? std::nullopt : std::optional(findings.front().incident);
  }

  Ledger ledger_{rules(), 2};
  rig::HostTime now_{std::chrono::hours(1)};
  bool is_light_ = false;
  std::uint64_t show_id_ = 0;
  std::uint32_t edge_number_ = 0;
  std::uint32_t pulse_number_ = 0;
  std::vector<FrameFacts> frames_;
  std::vector<SlotId> kept_;
};

TEST_F(LedgerTest, AgreeingFramesFillTheirSlotsInAnyOrder) {
  EXPECT_EQ(incident_of_frame(frames_[1]), std::nullopt);
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{0, 1}, SlotId{0, 0}));
  EXPECT_TRUE(ledger_.is_filled(0));
  EXPECT_FALSE(ledger_.is_complete());
  const Evidence& evidence = *ledger_.slots()[1].evidence;
  EXPECT_EQ(evidence.pulse_number, 4U);
  EXPECT_EQ(evidence.block_id, 4U);
  EXPECT_EQ(evidence.is_light, is_light_);
}

TEST_F(LedgerTest, FrameOfAnotherExposureIsMisexposed) {
  frames_[0].exposure = milliseconds(40);
  EXPECT_EQ(incident_of_frame(frames_[0]), Incident::kFrameMisexposed);
  EXPECT_TRUE(kept_.empty());
}

TEST_F(LedgerTest, ExposureRoundedToALineIsTheSame) {
  frames_[0].exposure = microseconds(10'000 - 28);
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  EXPECT_EQ(kept_.size(), 1U);
}

TEST_F(LedgerTest, NumberOfOnePulseAndTimeOfAnotherIsMistimed) {
  std::swap(frames_[0].timestamp, frames_[1].timestamp);
  EXPECT_EQ(incident_of_frame(frames_[0]), Incident::kFrameMistimed);
  EXPECT_EQ(incident_of_frame(frames_[1]), Incident::kFrameMistimed);
  EXPECT_TRUE(kept_.empty());
}

// Between two pulses there is time for a stray exposure that leaves none for the second.
TEST_F(LedgerTest, FrameIsOfItsPulseToTwoMilliseconds) {
  frames_[0].timestamp += microseconds(1900);
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  frames_[1].timestamp -= microseconds(2100);
  EXPECT_EQ(incident_of_frame(frames_[1]), Incident::kFrameMistimed);
}

TEST(LedgerRules, ToleranceIsAtMostHalfTheWayToTheNextPulse) {
  LedgerRules rules;
  rules.exposures = {microseconds(1500)};
  rules.gap = microseconds(1000);
  EXPECT_EQ(rules.time_tolerance(), microseconds(1250));
}

// A stray pulse's frame that bears the next pulse's number, without chunks and close to it in time.
TEST_F(LedgerTest, FrameThatIsThereBeforeItsPulseHasEndedIsMistimed) {
  frames_[1].exposure.reset();
  frames_[1].timestamp -= microseconds(4400);
  frames_[1].received -= milliseconds(20);
  EXPECT_EQ(incident_of_frame(frames_[1]), Incident::kFrameMistimed);
  EXPECT_TRUE(kept_.empty());
}

TEST_F(LedgerTest, SlotThatIsEmptiedIsOpenAgain) {
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  ASSERT_EQ(ledger_.filled_count(), 1);
  ledger_.empty({0, 0});
  ledger_.empty({0, 1});  // was never filled
  EXPECT_EQ(ledger_.filled_count(), 0);
  EXPECT_FALSE(ledger_.slots()[0].evidence);
}

TEST_F(LedgerTest, FrameBeforeItsPulseIsMistimed) {
  frames_[0].received -= milliseconds(200);
  EXPECT_EQ(incident_of_frame(frames_[0]), Incident::kFrameMistimed);
}

TEST_F(LedgerTest, WithoutACounterTheBlockIdCounts) {
  frames_[0].trigger_count.reset();
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{0, 0}));
}

TEST_F(LedgerTest, ImpossibleNumbersAreUnexpected) {
  FrameFacts none = frames_[0];
  none.trigger_count = 0;
  EXPECT_EQ(incident_of_frame(none), Incident::kFrameUnexpected);
  FrameFacts more_frames_than_pulses = frames_[0];
  more_frames_than_pulses.block_id = *frames_[0].trigger_count + 1;
  EXPECT_EQ(incident_of_frame(more_frames_than_pulses), Incident::kFrameUnexpected);
}

TEST_F(LedgerTest, SecondFrameOfAPulseIsADuplicate) {
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  EXPECT_EQ(incident_of_frame(frames_[0]), Incident::kFrameDuplicate);
  EXPECT_EQ(kept_.size(), 1U);
}

TEST_F(LedgerTest, FrameAfterItsDeadlineIsLateAndNotUsed) {
  now_ += rules().frame_deadline;
  const Findings expired = ledger_.expire(now_);
  ASSERT_EQ(expired.size(), 2U);
  EXPECT_EQ(expired[0].incident, Incident::kFrameMissing);
  EXPECT_EQ(expired[1].bracket, 1);
  EXPECT_EQ(incident_of_frame(frames_[0]), Incident::kFrameLate);
  EXPECT_TRUE(kept_.empty());
}

TEST_F(LedgerTest, DamagedBlockEndsTheWait) {
  const Findings findings =
      ledger_.frame_damaged({frames_[1].block_id, {rig::Fault::kFrameIncomplete, "holes"}});
  ASSERT_EQ(findings.size(), 1U);
  EXPECT_EQ(findings[0].incident, Incident::kFrameDamaged);
  EXPECT_EQ(findings[0].bracket, 1);
  EXPECT_EQ(ledger_.open_showing_count(), 1);
  EXPECT_TRUE(ledger_.frame_damaged({0, {}}).empty());
  EXPECT_TRUE(ledger_.frame_damaged({4711, {}}).empty());
}

TEST_F(LedgerTest, FrameWaitsForTheNewsOfItsPulseButNotForEver) {
  FrameFacts early = frames_[0];
  early.ticket = 99;
  early.block_id = early.trigger_count.emplace(pulse_number_ + 1);
  EXPECT_EQ(incident_of_frame(early), std::nullopt);
  EXPECT_TRUE(kept_.empty());
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  EXPECT_EQ(incident_of_frame(frames_[1]), std::nullopt);
  now_ += rules().frame_deadline;
  const Findings expired = ledger_.expire(now_);
  ASSERT_EQ(expired.size(), 1U);
  EXPECT_EQ(expired[0].incident, Incident::kFrameUnexpected);
}

TEST_F(LedgerTest, EdgeToTheOtherLevelIsWrong) {
  ledger_.open_showing({1, 0, ++show_id_, !is_light_, now_});
  const Findings findings = ledger_.edge_seen({edge_number_ + 1, is_light_, now_}, now_);
  ASSERT_EQ(findings.size(), 1U);
  EXPECT_EQ(findings[0].incident, Incident::kEdgeWrongLevel);
}

TEST_F(LedgerTest, EdgeLongBeforeTheSwapIsNotOurs) {
  ledger_.open_showing({1, 0, ++show_id_, !is_light_, now_});
  EXPECT_TRUE(ledger_.edge_seen({edge_number_ + 1, !is_light_, now_}, now_).empty());
  const Findings findings = ledger_.picture_shown({show_id_, now_ + milliseconds(17)});
  ASSERT_EQ(findings.size(), 1U);
  EXPECT_EQ(findings[0].incident, Incident::kEdgeBeforeFlip);
}

TEST_F(LedgerTest, SkippedAndSurplusEdgesAreOutOfOrder) {
  EXPECT_EQ(ledger_.edge_seen({edge_number_ + 1, is_light_, now_}, now_).at(0).incident,
            Incident::kEdgeOutOfOrder);
  ledger_.open_showing({1, 0, ++show_id_, !is_light_, now_});
  EXPECT_EQ(ledger_.edge_seen({edge_number_ + 2, !is_light_, now_}, now_).at(0).incident,
            Incident::kEdgeOutOfOrder);
}

TEST_F(LedgerTest, SurplusSkippedAndForeignPulsesAreOutOfOrder) {
  EXPECT_EQ(
      ledger_.pulse_ended({edge_number_, 2, pulse_number_ + 1, now_, now_}, now_).at(0).incident,
      Incident::kPulseOutOfOrder);
  ledger_.open_showing({1, 0, ++show_id_, !is_light_, now_});
  ASSERT_TRUE(ledger_.edge_seen({++edge_number_, !is_light_, now_}, now_).empty());
  for (const rig::PulseEnded& wrong :
       {rig::PulseEnded{edge_number_, 0, pulse_number_ + 2, now_, now_},
        rig::PulseEnded{edge_number_, 1, pulse_number_ + 1, now_, now_},
        rig::PulseEnded{edge_number_ - 1, 0, pulse_number_ + 1, now_, now_}})
    EXPECT_EQ(ledger_.pulse_ended(wrong, now_).at(0).incident, Incident::kPulseOutOfOrder);
}

TEST_F(LedgerTest, BounceIsIgnoredButALaterChangeOfLightIsNot) {
  const rig::HostTime edge = now_ - milliseconds(60);  // 10 + 5 + 40 + 5
  EXPECT_TRUE(ledger_.edge_ignored({edge_number_, is_light_, edge + microseconds(1500)}).empty());
  const Findings findings =
      ledger_.edge_ignored({edge_number_, is_light_, edge + milliseconds(20)});
  ASSERT_EQ(findings.size(), 1U);
  EXPECT_EQ(findings[0].incident, Incident::kEdgeDuringExposure);
  ledger_.spoil_showing(show_id_);
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  EXPECT_TRUE(kept_.empty()) << "a frame of a spoiled showing";
}

// The next picture's light came with this one's, which was late.
TEST_F(LedgerTest, ABounceThatDoesNotComeBackIsNoBounce) {
  for (const bool is_back : {true, false}) {
    is_light_ = !is_light_;
    ledger_.open_showing({1, 0, ++show_id_, is_light_, now_});
    EXPECT_TRUE(ledger_.picture_shown({show_id_, now_}).empty());
    EXPECT_TRUE(ledger_.edge_seen({++edge_number_, is_light_, now_}, now_).empty());
    EXPECT_TRUE(ledger_.edge_ignored({edge_number_, !is_light_, now_ + microseconds(5)}).empty());
    if (is_back) {
      EXPECT_TRUE(ledger_.edge_ignored({edge_number_, is_light_, now_ + microseconds(9)}).empty());
    }
    for (int bracket = 0; bracket < 2; ++bracket) {
      const rig::HostTime start = now_;
      now_ += milliseconds(10);
      const Findings findings =
          ledger_.pulse_ended({edge_number_, bracket, ++pulse_number_, start, now_}, now_);
      ASSERT_EQ(findings.size(), is_back || bracket == 1 ? 0U : 1U);
      if (findings.empty()) continue;
      EXPECT_EQ(findings[0].incident, Incident::kEdgeDuringExposure);
    }
  }
}

TEST_F(LedgerTest, RetakeFillsOnlyWhatIsOpen) {
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  showing(0);
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  EXPECT_EQ(incident_of_frame(frames_[1]), std::nullopt);
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{0, 0}, SlotId{0, 1}));
  EXPECT_EQ(ledger_.slots()[0].evidence->pulse_number, 3U);
  EXPECT_EQ(ledger_.slots()[1].evidence->pulse_number, 6U);
}

TEST_F(LedgerTest, NewRunForgetsNumbersButNotFilledSlots) {
  EXPECT_EQ(incident_of_frame(frames_[0]), std::nullopt);
  ledger_.start_run();
  EXPECT_EQ(ledger_.filled_count(), 1);
  EXPECT_EQ(ledger_.open_showing_count(), 0);
  EXPECT_FALSE(ledger_.is_primed());
  EXPECT_FALSE(ledger_.next_due());
}

}  // namespace
}  // namespace capture
