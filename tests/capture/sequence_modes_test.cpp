// The state machine without a trigger box, and at a pace: fed with events by hand.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <optional>
#include <vector>

#include "capture/sequence.h"

namespace capture {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr milliseconds kRefresh{16};
constexpr milliseconds kLag{20};  // from a swap to its light

// A rig played by the test: two patterns of two exposures.
class ModesTest : public testing::Test {
 protected:
  static SequenceRules boxless() {
    SequenceRules rules;
    rules.ledger.exposures = {milliseconds(10), milliseconds(40)};
    rules.ledger.refresh_interval = kRefresh;
    rules.ledger.has_edge_per_bracket = true;
    rules.ledger.is_lag_checked = true;
    rules.retake_limit = 1;
    return rules;
  }
  static SequenceRules software() {
    SequenceRules rules = boxless();
    rules.ledger.is_lag_checked = false;
    rules.ledger.latency = milliseconds(30);
    return rules;
  }
  void play(const SequenceRules& rules) {
    sequence_.emplace(rules, std::vector<int>{0, 1});
    state_ = sequence_->initial();
    reacted_.clear();
    tell(Start{});
    arm();
  }
  void arm() {  // from Darkening
    tell(rig::PictureShown{shown_.show_id, now_});
    time_out();
    number_ = 0;
    tell(Armed{});
  }
  void tell(const SequenceEvent& event) {
    Step step = sequence_->next(std::move(*state_), event, now_);
    state_ = std::move(step.state);
    reacted_.insert(reacted_.end(), step.reacted.begin(), step.reacted.end());
    for (const Action& action : step.actions) {
      if (const auto* show = std::get_if<Show>(&action)) shown_ = show->request;
      if (const auto* keep = std::get_if<KeepFrame>(&action)) kept_.push_back(keep->slot);
      if (std::holds_alternative<Fire>(action)) fired_ = now_;
    }
  }
  void time_out() {
    now_ = *Sequence::deadline(*state_);
    tell(TimePassed{});
  }
  std::string_view phase() const { return name_of(state_->phase); }

  void swap() {
    now_ += kRefresh;
    swapped_ = now_;
    tell(rig::PictureShown{shown_.show_id, now_});
  }
  // What a CameraTrigger says of a frame whose exposure began at `start`.
  void frame(rig::HostTime start) {
    const int bracket = static_cast<int>(number_ % 2);
    const milliseconds exposure(bracket == 0 ? 10 : 40);
    ++number_;
    now_ = std::max(now_, start + exposure + milliseconds(2));
    FrameFacts facts;
    facts.ticket = facts.block_id = number_;
    facts.trigger_count = number_;
    facts.exposure = exposure;
    facts.timestamp = rig::CameraClock::time_point(start.time_since_epoch() + milliseconds(777));
    facts.received = now_;
    tell(rig::EdgeSeen{number_, number_ % 2 == 1, start});
    tell(rig::PulseEnded{number_, 0, number_, start, start + exposure});
    tell(FrameSeen{facts});
  }
  // A showing as it should be.
  void showing() {
    swap();
    frame(swapped_ + kLag);
  }
  void prime() {
    for (int bracket = 0; bracket < 2; ++bracket) {
      if (phase() == "pacing") time_out();
      showing();
    }
    if (phase() == "pacing" && state_->ledger.is_primed()) time_out();
  }
  Incident found() const {
    return reacted_.empty() ? Incident::kStorage : reacted_.front().finding.incident;
  }

  std::optional<Sequence> sequence_;
  std::optional<SequenceState> state_;
  rig::HostTime now_{std::chrono::hours(1)};
  rig::HostTime swapped_, fired_;
  std::vector<Reacted> reacted_;
  rig::ShowRequest shown_;
  std::vector<SlotId> kept_;
  std::uint32_t number_ = 0;  // of edge, pulse and block alike
};

TEST_F(ModesTest, EachBracketIsAFlipOfItsOwn) {
  play(boxless());
  EXPECT_EQ(phase(), "showing");
  EXPECT_EQ(shown_.picture, rig::kBlackPicture);
  EXPECT_TRUE(shown_.is_square_light);
  showing();
  EXPECT_EQ(shown_.picture, rig::kBlackPicture) << "the priming has two brackets, too";
  EXPECT_FALSE(shown_.is_square_light);
  showing();
  EXPECT_EQ(shown_.picture, 0);
  showing();
  EXPECT_EQ(shown_.picture, 0);
  EXPECT_FALSE(shown_.is_square_light);
  showing();
  EXPECT_EQ(shown_.picture, 1);
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{0, 0})) << "a frame waits for the next edge";
  showing();
  showing();
  EXPECT_EQ(phase(), "confirming");
  EXPECT_EQ(shown_.picture, rig::kBlackPicture);
  EXPECT_TRUE(shown_.is_square_light) << "one more edge";
  EXPECT_EQ(kept_.size(), 3U);
  showing();
  EXPECT_EQ(phase(), "blackening");
  EXPECT_EQ(state_->outcome, Outcome::kComplete);
  EXPECT_EQ(kept_.size(), 4U);
}

// A frame that was damaged is the edge's only sign; then the swap alone is awaited.
TEST_F(ModesTest, ASwapThatIsNeverToldOfHasADeadlineAlthoughTheFrameWasDamaged) {
  SequenceRules paced = boxless();
  paced.refreshes_per_showing = {3, 6};
  SequenceRules sole = boxless();
  sole.ledger.relies_on_swaps = true;
  for (SequenceRules rules : {boxless(), paced, sole}) {
    rules.retake_limit = 2;
    play(rules);
    prime();
    ASSERT_EQ(shown_.picture, 0);
    tell(rig::FrameDamaged{++number_, {rig::Fault::kFrameIncomplete, "packets are missing"}});
    for (int step = 0; step < 20 && phase() != "darkening"; ++step) {
      ASSERT_TRUE(Sequence::deadline(*state_)) << phase();
      time_out();
    }
    EXPECT_EQ(phase(), "darkening");
  }
}

// Whose edge it was, only the next ones could tell, and they have no level.
TEST_F(ModesTest, ADamagedFrameIsARestartWhereOnlyTimesTellFlipsApart) {
  SequenceRules sole = boxless();
  sole.ledger.relies_on_swaps = true;
  for (const SequenceRules& rules : {boxless(), sole}) {
    play(rules);
    prime();
    swap();
    tell(rig::FrameDamaged{++number_, {rig::Fault::kFrameIncomplete, "packets are missing"}});
    ASSERT_FALSE(reacted_.empty());
    EXPECT_EQ(found(), Incident::kFrameDamaged);
    EXPECT_EQ(reacted_[0].reaction,
              rules.ledger.relies_on_swaps ? Reaction::kRestart : Reaction::kRetake);
  }
}

// An edge of a run before would have taken the first flip's place, and each flip the next one's.
TEST_F(ModesTest, WithoutALevelThePrimingListensForAnEdgeTooMany) {
  SequenceRules sole = boxless();
  sole.ledger.relies_on_swaps = true;
  sole.ledger.priming_rounds = 2;
  for (const bool is_one_too_many : {false, true}) {
    play(sole);
    prime();
    if (is_one_too_many) {
      frame(now_);
      EXPECT_EQ(phase(), "darkening");
      EXPECT_EQ(found(), Incident::kEdgeOutOfOrder);
    } else {
      prime();
      EXPECT_EQ(shown_.picture, 0);
      EXPECT_TRUE(reacted_.empty());
    }
  }
}

TEST_F(ModesTest, AStrayTriggerBeforeThePictureWasAskedForIsNoEdge) {
  play(boxless());
  prime();
  const rig::HostTime stray = now_ - milliseconds(5);
  swap();
  frame(stray);
  EXPECT_EQ(found(), Incident::kEdgeBeforeFlip);
  EXPECT_EQ(phase(), "darkening");
}

TEST_F(ModesTest, AnEdgeFarFromTheRunsLagIsNoEdgeOfOurs) {
  for (const int off_refreshes : {-1, 2}) {
    SCOPED_TRACE(off_refreshes);
    play(boxless());
    prime();
    swap();
    frame(swapped_ + kLag + off_refreshes * kRefresh);
    if (off_refreshes < 0) {
      EXPECT_TRUE(reacted_.empty()) << "swaps are reported up to a refresh late";
      continue;
    }
    EXPECT_EQ(found(), Incident::kEdgeLate);
    EXPECT_EQ(phase(), "darkening");
  }
}

TEST_F(ModesTest, ATriggerThatGaveNoFrameRestartsBeforeAFrameIsHandedOn) {
  play(boxless());
  prime();
  showing();
  ++number_;  // a flash while the shutter was open
  showing();
  EXPECT_EQ(found(), Incident::kEdgeOutOfOrder);
  EXPECT_THAT(kept_, testing::IsEmpty());
  EXPECT_EQ(phase(), "darkening");
}

TEST_F(ModesTest, ADamagedFrameStandsForItsEdgeAndThePatternComesAgain) {
  play(boxless());
  prime();
  swap();
  tell(rig::FrameDamaged{++number_, {rig::Fault::kFrameIncomplete, "holes"}});
  EXPECT_EQ(found(), Incident::kFrameDamaged);
  EXPECT_EQ(reacted_.front().reaction, Reaction::kRetake);
  EXPECT_EQ(shown_.picture, 0) << "the sequencer's round is finished first";
  showing();
  EXPECT_EQ(shown_.picture, 0) << "and again";
  showing();
  showing();
  EXPECT_EQ(shown_.picture, 1);
  EXPECT_THAT(kept_, testing::ElementsAre(SlotId{0, 1}, SlotId{0, 0}));
}

TEST_F(ModesTest, AConfirmationThatNeverComesFailsInTheEnd) {
  play(boxless());
  prime();
  for (int i = 0; i < 4; ++i) showing();
  for (int round = 0; round < 3 && phase() != "blackening"; ++round) {
    EXPECT_EQ(phase(), "confirming");
    swap();
    time_out();
    if (phase() != "darkening") break;
    arm();
    prime();
    showing();
    showing();
  }
  EXPECT_EQ(phase(), "blackening");
  ASSERT_TRUE(state_->failure);
  EXPECT_EQ(state_->failure->incident, Incident::kEdgeMissing);
  EXPECT_THAT(state_->failure->text, testing::HasSubstr("pattern 1"));
}

// Where the camera does not tell the level.
TEST_F(ModesTest, FlipsAreKeptApartWhereTheirTimeMustTellThem) {
  SequenceRules rules = boxless();
  rules.ledger.relies_on_swaps = true;
  play(rules);
  const auto first = shown_.show_id;
  swap();
  frame(swapped_ + milliseconds(1));
  EXPECT_EQ(phase(), "pacing");
  EXPECT_EQ(shown_.show_id, first);
  time_out();
  EXPECT_EQ(shown_.show_id, first + 1);
  EXPECT_EQ(now_ - swapped_, kRefresh * 9 / 4);
}

TEST_F(ModesTest, ALateSwapRestartsWhereOnlySwapsTellWhatWasShown) {
  for (const bool relies_on_swaps : {true, false}) {
    SequenceRules rules = boxless();
    rules.ledger.relies_on_swaps = relies_on_swaps;
    play(rules);
    now_ += kRefresh + milliseconds(1);
    swap();
    EXPECT_EQ(phase(), relies_on_swaps ? "darkening" : "showing");
    EXPECT_EQ(reacted_.size(), relies_on_swaps ? 1U : 0U);
  }
  EXPECT_EQ(reacted_.size(), 0U);
}

TEST_F(ModesTest, ThePrimingTeachesTheLagInMoreThanOneRound) {
  SequenceRules rules = boxless();
  rules.ledger.priming_rounds = 2;
  play(rules);
  prime();
  EXPECT_EQ(shown_.picture, rig::kBlackPicture);
  swap();
  frame(swapped_ + kLag - kRefresh * 3 / 2);
  EXPECT_EQ(found(), Incident::kEdgeBeforeFlip) << "the priming must agree with itself";
  EXPECT_EQ(phase(), "darkening");
}

TEST_F(ModesTest, SoftwareFiresAfterTheLatency) {
  play(software());
  swap();
  EXPECT_EQ(phase(), "delaying");
  time_out();
  EXPECT_EQ(phase(), "exposing");
  EXPECT_EQ(fired_, swapped_ + milliseconds(30));
  frame(fired_);
  swap();
  time_out();
  frame(fired_);
  EXPECT_EQ(shown_.picture, 0) << "primed";
  EXPECT_TRUE(Sequence::deadline(*state_));
}

TEST_F(ModesTest, SoftwareTrustsNoExposureBeforeTheLatency) {
  play(software());
  swap();
  time_out();
  frame(fired_ - milliseconds(10));
  EXPECT_EQ(found(), Incident::kEdgeBeforeFlip);
}

TEST_F(ModesTest, PacedAsksForTheNextPictureAFixedTimeAfterTheSwap) {
  SequenceRules rules = boxless();
  rules.refreshes_per_showing = {3, 5};
  play(rules);
  prime();
  EXPECT_EQ(shown_.picture, 0);
  swap();
  EXPECT_EQ(phase(), "pacing");
  const auto first = shown_.show_id;
  time_out();
  EXPECT_EQ(shown_.show_id, first + 1) << "without having seen a frame";
  // In the last of three refreshes.
  EXPECT_EQ(now_ - swapped_, 2 * kRefresh + kRefresh / 4);
  const rig::HostTime before = swapped_;
  now_ = swapped_ + 2 * kRefresh;
  swap();
  EXPECT_EQ(swapped_ - before, 3 * kRefresh);
  frame(before + kLag);
  EXPECT_TRUE(reacted_.empty());
  EXPECT_EQ(phase(), "pacing");
  time_out();
  EXPECT_EQ(shown_.picture, 1);
  EXPECT_EQ(now_ - swapped_, 4 * kRefresh + kRefresh / 4);
}

TEST_F(ModesTest, PacedDoesNotTakeAnEdgeForThatOfTheNextFlip) {
  SequenceRules rules = boxless();
  rules.refreshes_per_showing = {3, 3};
  play(rules);
  prime();
  swap();
  time_out();
  now_ = swapped_ + 2 * kRefresh;
  swap();
  frame(swapped_ + kLag);  // the one before was missed
  EXPECT_EQ(found(), Incident::kEdgeLate);
  EXPECT_THAT(kept_, testing::IsEmpty());
}

}  // namespace
}  // namespace capture
