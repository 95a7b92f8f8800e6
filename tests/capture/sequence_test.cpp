// The state machine fed with events by hand: no device, no clock, no sleep.
#include "capture/sequence.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <optional>
#include <vector>

namespace capture {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;

// A rig played by the test: two patterns of two exposures.
class SequenceTest : public testing::Test {
 protected:
  static SequenceRules rules() {
    SequenceRules rules;
    rules.ledger.exposures = {milliseconds(10), milliseconds(40)};
    rules.ledger.gap = milliseconds(5);
    rules.retake_limit = 1;
    return rules;
  }

  void tell(const SequenceEvent& event) {
    Step step = sequence_.next(std::move(state_), event, now_);
    state_ = std::move(step.state);
    actions_ = std::move(step.actions);
    reacted_ = std::move(step.reacted);
    for (const Action& action : actions_) {
      if (const auto* show = std::get_if<Show>(&action)) shown_ = show->request;
      if (const auto* arm = std::get_if<Arm>(&action)) armed_ = *arm;
      if (const auto* keep = std::get_if<KeepFrame>(&action)) kept_.push_back(keep->slot);
    }
    if (std::holds_alternative<Arming>(state_.phase)) pulse_number_ = edge_number_ = 0;
  }
  void wait(milliseconds duration) { now_ += duration; }
  void time_out() {
    now_ = *Sequence::deadline(state_);
    tell(TimePassed{});
  }
  std::string_view phase() const { return name_of(state_.phase); }
  bool did(std::size_t alternative) const {
    for (const Action& action : actions_)
      if (action.index() == alternative) return true;
    return false;
  }
  bool did_disarm() const { return did(Action(Disarm{}).index()); }

  void start() { tell(Start{}); }
  void arm() {
    start();
    arm_again();
  }
  void arm_and_expose() {
    arm();
    swap();
    edge();
  }
  void arm_again() {  // from Darkening
    tell(rig::PictureShown{shown_.show_id, now_});
    time_out();
    tell(Armed{});
  }
  void arm_after_a_missing_edge() {
    swap();
    time_out();
    if (phase() == "darkening") arm_again();
  }
  void swap() {
    wait(milliseconds(16));
    tell(rig::PictureShown{shown_.show_id, now_});
  }
  void edge() {
    wait(milliseconds(16));
    tell(rig::EdgeSeen{++edge_number_, shown_.is_square_light, now_});
  }
  void pulses() {
    for (int bracket = 0; bracket < 2; ++bracket) {
      const rig::HostTime start = now_;
      wait(bracket == 0 ? milliseconds(10) : milliseconds(40));
      tell(rig::PulseEnded{edge_number_, bracket, ++pulse_number_, start, now_});
      starts_.push_back(start);
      wait(milliseconds(5));
    }
  }
  FrameFacts facts(std::uint32_t pulse_number, rig::HostTime pulse_start, int bracket) {
    FrameFacts facts;
    facts.ticket = next_ticket_++;
    facts.block_id = pulse_number;
    facts.trigger_count = pulse_number;
    facts.exposure = bracket == 0 ? milliseconds(10) : milliseconds(40);
    facts.timestamp =
        rig::CameraClock::time_point(pulse_start.time_since_epoch() + milliseconds(123'456));
    facts.received = now_;
    return facts;
  }
  // The two frames of the pulses that were sent last.
  void frames() {
    for (int bracket = 0; bracket < 2; ++bracket) {
      const auto pulse =
          static_cast<std::uint32_t>(pulse_number_ - 1) + static_cast<std::uint32_t>(bracket);
      tell(FrameSeen{
          facts(pulse, starts_[starts_.size() - 2 + static_cast<std::size_t>(bracket)], bracket)});
    }
  }
  void expose() {
    swap();
    edge();
    pulses();
  }
  void prime() {
    expose();
    frames();
  }

  Sequence sequence_{rules(), {0, 1}};
  SequenceState state_ = sequence_.initial();
  rig::HostTime now_{std::chrono::hours(1)};
  std::vector<Action> actions_;
  std::vector<Reacted> reacted_;
  rig::ShowRequest shown_;
  Arm armed_;
  std::vector<SlotId> kept_;
  std::vector<rig::HostTime> starts_;
  std::uint32_t edge_number_ = 0;
  std::uint32_t pulse_number_ = 0;
  std::uint64_t next_ticket_ = 1;
};

TEST_F(SequenceTest, GoesThroughItsStatesAndFillsEverySlot) {
  EXPECT_EQ(phase(), "idle");
  tell(Start{});
  EXPECT_EQ(phase(), "darkening");
  EXPECT_EQ(shown_.picture, rig::kBlackPicture);
  EXPECT_FALSE(shown_.is_square_light);
  tell(rig::PictureShown{shown_.show_id, now_});
  EXPECT_EQ(phase(), "settling");
  time_out();
  EXPECT_EQ(phase(), "arming");
  EXPECT_EQ(armed_.frame_count, 2 * (2 + 1 + 1));  // patterns, priming, one retake
  tell(Armed{});
  EXPECT_EQ(phase(), "showing");
  EXPECT_EQ(shown_.picture, rig::kBlackPicture) << "primes first";
  EXPECT_TRUE(shown_.is_square_light);
  swap();
  edge();
  EXPECT_EQ(phase(), "exposing");
  pulses();
  EXPECT_EQ(phase(), "collecting") << "the priming must prove itself before a pattern is shown";
  frames();
  EXPECT_EQ(phase(), "showing");
  EXPECT_EQ(shown_.picture, 0);
  EXPECT_FALSE(shown_.is_square_light) << "the square flips with every picture";
  expose();
  EXPECT_EQ(shown_.picture, 1) << "the next one while the frames of this one travel";
  frames();
  EXPECT_THAT(kept_, testing::IsEmpty()) << "was the display still as opened?";
  expose();
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{0, 0}));
  EXPECT_EQ(phase(), "collecting");
  frames();
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{0, 0}, SlotId{0, 1}))
      << "the last frame waits for the next one's number";
  EXPECT_EQ(phase(), "confirming");
  EXPECT_EQ(shown_.picture, rig::kBlackPicture);
  EXPECT_TRUE(shown_.is_square_light) << "no edge now";
  swap();
  EXPECT_EQ(kept_.size(), 4U);
  EXPECT_EQ(phase(), "blackening");
  EXPECT_TRUE(did_disarm());
  tell(rig::PictureShown{shown_.show_id, now_});
  EXPECT_EQ(phase(), "ended");
  EXPECT_EQ(state_.outcome, Outcome::kComplete);
  EXPECT_FALSE(Sequence::deadline(state_));
}

TEST_F(SequenceTest, EveryWaitingStateHasADeadline) {
  tell(Start{});
  EXPECT_TRUE(Sequence::deadline(state_)) << phase();
  tell(rig::PictureShown{shown_.show_id, now_});
  EXPECT_TRUE(Sequence::deadline(state_)) << phase();
  time_out();
  EXPECT_TRUE(Sequence::deadline(state_)) << phase();
  tell(Armed{});
  EXPECT_TRUE(Sequence::deadline(state_)) << phase();
  swap();
  edge();
  EXPECT_TRUE(Sequence::deadline(state_)) << phase();
  pulses();
  EXPECT_EQ(phase(), "collecting");
  EXPECT_TRUE(Sequence::deadline(state_)) << phase();
  tell(AbortRequested{});
  EXPECT_TRUE(Sequence::deadline(state_)) << phase();
}

TEST_F(SequenceTest, AnEdgeOfTheFarFutureHasItsPulsesDeadlineNow) {
  for (const auto off : {std::chrono::hours(1000), std::chrono::hours(-1)}) {
    state_ = sequence_.initial();
    arm();
    swap();
    tell(rig::EdgeSeen{++edge_number_, shown_.is_square_light, now_ + off});
    if (phase() == "darkening") continue;  // it cannot be
    EXPECT_EQ(phase(), "exposing");
    ASSERT_TRUE(Sequence::deadline(state_));
    EXPECT_GT(*Sequence::deadline(state_), now_);
    EXPECT_LE(*Sequence::deadline(state_), now_ + std::chrono::seconds(1));
  }
}

// In Confirming frames of the last showing may still be out; that they are given up is the end.
TEST_F(SequenceTest, AFrameThatNobodyNeedsAnyMoreDoesNotHoldUpTheEnd) {
  arm();
  prime();
  expose();
  tell(FrameSeen{facts(pulse_number_ - 1, starts_[starts_.size() - 2], 0)});
  tell(rig::FrameDamaged{pulse_number_, {rig::Fault::kFrameIncomplete, "packets are missing"}});
  expose();  // pattern 1
  frames();
  expose();  // pattern 0 again, for its second bracket
  tell(FrameSeen{facts(pulse_number_, starts_.back(), 1)});
  EXPECT_EQ(phase(), "confirming");
  swap();
  for (int step = 0; step < 3 && phase() == "confirming"; ++step) {
    ASSERT_TRUE(Sequence::deadline(state_));
    ASSERT_LT(*Sequence::deadline(state_), now_ + std::chrono::seconds(2));
    time_out();
  }
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(state_.outcome, Outcome::kComplete);
  EXPECT_EQ(kept_.size(), 4U);
}

TEST_F(SequenceTest, BlackThatIsNeverShownIsTriedAgainAndThenFails) {
  tell(Start{});
  time_out();
  EXPECT_EQ(phase(), "darkening");
  EXPECT_EQ(state_.restart_count, 1);
  time_out();
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(state_.failure->incident, Incident::kPictureNotShown);
}

TEST_F(SequenceTest, ArmingThatNeverEndsIsALostDevice) {
  tell(Start{});
  tell(rig::PictureShown{shown_.show_id, now_});
  time_out();
  time_out();
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(state_.failure->incident, Incident::kDeviceLost);
}

TEST_F(SequenceTest, PictureWithoutSwapOrEdgeIsArmedAnew) {
  arm();
  prime();
  time_out();
  EXPECT_EQ(phase(), "darkening");
  EXPECT_TRUE(did_disarm());
  ASSERT_EQ(reacted_.size(), 1U);
  EXPECT_EQ(reacted_[0].finding.incident, Incident::kPictureNotShown);
  EXPECT_EQ(reacted_[0].finding.pattern, 0);
}

TEST_F(SequenceTest, EdgeThatDoesNotComeIsArmedAnewAndThenFailsWithSlotsNamed) {
  arm();
  prime();
  swap();
  time_out();
  ASSERT_EQ(reacted_.size(), 1U);
  EXPECT_EQ(reacted_[0].finding.incident, Incident::kEdgeMissing);
  EXPECT_EQ(phase(), "darkening");
  arm_again();
  prime();
  swap();
  time_out();
  ASSERT_TRUE(state_.failure);
  EXPECT_EQ(state_.failure->incident, Incident::kEdgeMissing);
  EXPECT_THAT(state_.failure->slots, testing::ElementsAre(SlotId{0, 0}, SlotId{0, 1}));
  EXPECT_THAT(state_.failure->text, testing::HasSubstr("thresholds"));
}

TEST_F(SequenceTest, PulsesThatDoNotEndAreArmedAnew) {
  arm();
  prime();
  swap();
  edge();
  time_out();
  ASSERT_EQ(reacted_.size(), 1U);
  EXPECT_EQ(reacted_[0].finding.incident, Incident::kPulseMissing);
  EXPECT_EQ(phase(), "darkening");
}

// A stray exposure right before a pulse has that pulse's number, time and exposure; the pulse,
// which the camera had no time for, is counted all the same.
TEST_F(SequenceTest, FrameThatTheNumbersAfterItDisproveIsNotKept) {
  arm();
  prime();
  expose();
  frames();  // of pattern 0, the second one a stray's
  expose();
  const std::size_t first = starts_.size() - 2;
  tell(FrameSeen{facts(pulse_number_, starts_[first], 0)});  // one ahead of its pulse
  EXPECT_EQ(phase(), "darkening");
  ASSERT_FALSE(reacted_.empty());
  EXPECT_EQ(reacted_[0].finding.incident, Incident::kFrameMistimed);
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{0, 0}));
  EXPECT_FALSE(state_.ledger.is_filled(0)) << "to be taken again";
}

TEST_F(SequenceTest, WhatIsOnItsWayThroughADisplayHasAsLongAsAnEdgeBeforeARunIsArmedAgain) {
  start();
  tell(rig::PictureShown{shown_.show_id, now_});
  EXPECT_EQ(*Sequence::deadline(state_), now_ + rules().settle_time) << "nothing was flipped yet";
  time_out();
  tell(Armed{});
  prime();
  expose();
  tell(rig::DeviceFault{rig::Device::kTrigger, {rig::Fault::kSequenceGap, "records were lost"}});
  EXPECT_EQ(phase(), "darkening");
  tell(rig::PictureShown{shown_.show_id, now_});
  EXPECT_EQ(phase(), "settling");
  EXPECT_EQ(*Sequence::deadline(state_), now_ + rules().ledger.edge_deadline);
}

TEST_F(SequenceTest, FrameThatDoesNotComeIsRetaken) {
  arm();
  prime();
  expose();  // pattern 0, no frames
  expose();  // pattern 1
  frames();
  time_out();
  ASSERT_FALSE(reacted_.empty());
  EXPECT_EQ(reacted_[0].finding.incident, Incident::kFrameMissing);
  EXPECT_EQ(reacted_[0].reaction, Reaction::kRetake);
  while (phase() == "collecting") time_out();
  EXPECT_EQ(phase(), "showing");
  EXPECT_EQ(shown_.picture, 0);
  expose();
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{1, 0}));
  frames();
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{1, 0}, SlotId{1, 1}));
  swap();
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(state_.outcome, Outcome::kComplete);
  EXPECT_EQ(kept_.size(), 4U);
}

TEST_F(SequenceTest, PrimingsThatGetTheirWayAreNotHeldAgainstTheLimit) {
  arm();
  for (int fault = 0; fault < 5; ++fault) {  // the limit is 1
    prime();
    EXPECT_EQ(shown_.picture, 0) << fault;
    state_.retake_counts[1] = 0;  // other patterns' faults, as far as the priming is concerned
    arm_after_a_missing_edge();
    arm_after_a_missing_edge();  // of the priming itself
    ASSERT_NE(phase(), "blackening") << fault;
  }
  EXPECT_EQ(state_.retake_total, 10);
}

// With somebody to open a lost device anew.
class ReopeningTest : public SequenceTest {
 protected:
  ReopeningTest() {
    SequenceRules patient = rules();
    patient.reopen_deadline = std::chrono::seconds(10);
    patient.reopen_limit = 1;
    sequence_ = Sequence(patient, {0, 1});
    state_ = sequence_.initial();
  }
  void lose(rig::Device device) {
    tell(rig::DeviceFault{device, {rig::Fault::kDeviceLost, "it is gone"}});
  }
  void refuse(rig::Device device) {
    tell(ReopenRefused{device, {rig::Fault::kNotFound, "nobody answers"}});
  }
  std::optional<rig::Device> asked_to_open() const {
    for (const Action& action : actions_)
      if (const auto* reopen = std::get_if<Reopen>(&action)) return reopen->device;
    return std::nullopt;
  }
  std::vector<rig::ShowRequest> asked_to_show() const {
    std::vector<rig::ShowRequest> requests;
    for (const Action& action : actions_)
      if (const auto* show = std::get_if<Show>(&action)) requests.push_back(show->request);
    return requests;
  }
};

TEST_F(ReopeningTest, LostDeviceIsOpenedAndTheOpenSlotsAreTakenInANewRun) {
  arm();
  prime();
  expose();
  frames();
  expose();
  frames();
  lose(rig::Device::kCamera);
  EXPECT_EQ(phase(), "reopening");
  EXPECT_TRUE(did_disarm());
  EXPECT_EQ(asked_to_open(), rig::Device::kCamera);
  EXPECT_TRUE(state_.ledger.is_filled(0)) << "confirmed by the second picture and its frames";
  tell(Reopened{rig::Device::kCamera});
  EXPECT_EQ(phase(), "darkening");
  EXPECT_THAT(state_.queue, testing::ElementsAre(1));
}

TEST_F(ReopeningTest, TriesAgainUntilItsTimeIsUpAndThenFailsWithTheDevicesName) {
  arm();
  prime();
  lose(rig::Device::kTrigger);
  int try_count = 0;
  while (phase() == "reopening" && ++try_count < 100) {
    refuse(rig::Device::kTrigger);
    EXPECT_FALSE(asked_to_open()) << "at once";
    time_out();
    EXPECT_TRUE(phase() == "blackening" || asked_to_open() == rig::Device::kTrigger);
  }
  EXPECT_EQ(try_count, 20);  // every half second of ten
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(state_.outcome, Outcome::kFailed);
  ASSERT_TRUE(state_.failure);
  EXPECT_EQ(state_.failure->device, rig::Device::kTrigger);
  EXPECT_THAT(state_.failure->text, testing::HasSubstr("not back within 10 s: nobody answers"));
}

TEST_F(ReopeningTest, AnOpeningThatDoesNotEndEndsWithTheDevicesTime) {
  arm();
  prime();
  const rig::HostTime lost_at = now_;
  lose(rig::Device::kCamera);
  EXPECT_EQ(Sequence::deadline(state_), lost_at + std::chrono::seconds(10));
  time_out();
  EXPECT_EQ(phase(), "blackening");
  ASSERT_TRUE(state_.failure);
  EXPECT_THAT(state_.failure->text, testing::HasSubstr("camera: lost, and not back within 10 s"));
  tell(Reopened{rig::Device::kCamera});  // too late
  EXPECT_EQ(phase(), "blackening");
}

TEST_F(ReopeningTest, AbortIsHeardInTheMidstOfAnOpening) {
  arm();
  prime();
  lose(rig::Device::kCamera);
  tell(AbortRequested{});
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(state_.outcome, Outcome::kAborted);
  tell(Reopened{rig::Device::kCamera});
  EXPECT_EQ(phase(), "blackening") << "nothing is begun anew";
}

TEST_F(ReopeningTest, IsBlackUntilTheDeviceIsBack) {
  arm();
  prime();
  expose();
  frames();
  ASSERT_EQ(phase(), "showing");
  lose(rig::Device::kCamera);
  const auto asked = asked_to_show();
  ASSERT_EQ(asked.size(), 1U);
  EXPECT_EQ(asked[0].picture, rig::kBlackPicture);
  EXPECT_FALSE(asked[0].is_square_light);
  tell(rig::PictureShown{asked[0].show_id, now_});
  EXPECT_EQ(phase(), "reopening");
  for (int i = 0; i < 3; ++i) {
    refuse(rig::Device::kCamera);
    EXPECT_TRUE(asked_to_show().empty());
    time_out();
    EXPECT_TRUE(asked_to_show().empty());
  }
  tell(Reopened{rig::Device::kCamera});
  arm_again();
  prime();
  ASSERT_EQ(asked_to_show().size(), 1U);
  EXPECT_EQ(asked_to_show()[0].picture, 0) << "the pattern that was lit";
}

// It is black by itself, and takes no orders.
TEST_F(ReopeningTest, AProjectorThatIsGoneIsNotAskedForBlack) {
  arm();
  prime();
  tell(rig::DeviceFault{rig::Device::kProjector, {rig::Fault::kDisplayChanged, "monitor gone"}});
  EXPECT_EQ(phase(), "reopening");
  EXPECT_TRUE(asked_to_show().empty());
}

TEST_F(ReopeningTest, SecondDeviceLostMeanwhileIsOpenedNext) {
  arm();
  prime();
  lose(rig::Device::kCamera);
  lose(rig::Device::kTrigger);
  lose(rig::Device::kCamera);  // what it had still to say
  tell(Reopened{rig::Device::kCamera});
  EXPECT_EQ(phase(), "reopening");
  EXPECT_EQ(asked_to_open(), rig::Device::kTrigger);
  tell(Reopened{rig::Device::kTrigger});
  EXPECT_EQ(phase(), "darkening");
  EXPECT_EQ(state_.reopen_count, 1);
}

TEST_F(ReopeningTest, SoOftenAndNoMore) {
  arm();
  lose(rig::Device::kCamera);
  tell(Reopened{rig::Device::kCamera});
  arm_again();
  prime();
  lose(rig::Device::kCamera);
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(state_.outcome, Outcome::kFailed);
}

TEST_F(ReopeningTest, AbortEndsTheWaiting) {
  arm();
  lose(rig::Device::kCamera);
  refuse(rig::Device::kCamera);
  tell(AbortRequested{});
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(state_.outcome, Outcome::kAborted);
}

TEST_F(ReopeningTest, WindowWithoutItsServerIsFinal) {
  arm();
  prime();
  lose(rig::Device::kProjector);
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(state_.outcome, Outcome::kFailed);
}

TEST_F(ReopeningTest, FramesThatKeepFailingToComeHaveTheCameraOpenedAnew) {
  arm();
  prime();
  expose();
  for (int i = 0; phase() != "reopening" && i < 20; ++i) {
    if (phase() == "showing")
      expose();
    else
      time_out();
  }
  ASSERT_EQ(phase(), "reopening");
  EXPECT_EQ(asked_to_open(), rig::Device::kCamera);
  tell(Reopened{rig::Device::kCamera});
  EXPECT_THAT(state_.retake_counts, testing::Each(0)) << "it was not the patterns' fault";
}

TEST_F(SequenceTest, DisplayThatChangedAfterTheLastPatternTakesItsFramesAlong) {
  arm();
  prime();
  expose();
  frames();
  expose();
  frames();
  EXPECT_EQ(phase(), "confirming");
  tell(rig::DeviceFault{rig::Device::kProjector, {rig::Fault::kDisplayChanged, "gamma"}});
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{0, 0}, SlotId{0, 1}));
  EXPECT_FALSE(state_.ledger.is_filled(1));
  EXPECT_NE(state_.outcome, Outcome::kComplete);
}

TEST_F(SequenceTest, BlackAfterTheLastPatternThatIsNeverShownIsARestart) {
  arm();
  prime();
  expose();
  frames();
  expose();
  frames();
  time_out();
  ASSERT_EQ(reacted_.size(), 1U);
  EXPECT_EQ(reacted_[0].finding.incident, Incident::kPictureNotShown);
  EXPECT_EQ(phase(), "darkening");
  EXPECT_FALSE(state_.ledger.is_filled(1));
}

TEST_F(SequenceTest, NextPatternWaitsWhileFramesOfTheOneBeforeLastAreOut) {
  arm();
  prime();
  expose();
  EXPECT_EQ(shown_.picture, 1);
  expose();
  EXPECT_EQ(phase(), "collecting");
}

TEST_F(SequenceTest, BlackThatIsNeverConfirmedEndsAllTheSame) {
  arm();
  tell(AbortRequested{});
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(shown_.picture, rig::kBlackPicture);
  EXPECT_TRUE(did_disarm());
  time_out();
  EXPECT_EQ(phase(), "ended");
  EXPECT_EQ(state_.outcome, Outcome::kAborted);
}

TEST_F(SequenceTest, EventsOfARunThatIsOverChangeNothing) {
  arm();
  prime();
  swap();
  time_out();
  ASSERT_EQ(phase(), "darkening");
  tell(rig::EdgeSeen{99, true, now_});
  tell(rig::PulseEnded{99, 0, 99, now_, now_});
  tell(rig::FrameDamaged{99, {}});
  tell(rig::DeviceFault{rig::Device::kTrigger, {rig::Fault::kSequenceGap, "old"}});
  EXPECT_EQ(phase(), "darkening");
  tell(FrameSeen{facts(99, now_, 0)});
  EXPECT_TRUE(did(Action(DropFrame{}).index())) << "its buffer goes back";
}

TEST_F(SequenceTest, LostDeviceFailsInAnyState) {
  const rig::DeviceFault lost{rig::Device::kTrigger, {rig::Fault::kDeviceLost, "unplugged"}};
  const std::vector<std::function<void()>> ways = {[this] { start(); }, [this] { arm(); },
                                                   [this] { arm_and_expose(); }};
  for (const auto& way : ways) {
    state_ = sequence_.initial();
    way();
    SCOPED_TRACE(std::string(phase()));
    tell(lost);
    EXPECT_EQ(phase(), "blackening");
    EXPECT_EQ(state_.failure->device, rig::Device::kTrigger);
    EXPECT_THAT(state_.failure->text, testing::HasSubstr("unplugged"));
  }
}

}  // namespace
}  // namespace capture
