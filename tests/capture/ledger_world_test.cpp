// Whole captures in the ledger world: every frame says in its pixels what it is, so a wrong
// assignment cannot hide.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>
#include <string>

#include "tests/capture/ledger_rig.h"

namespace capture {
namespace {

using hw_sim::SimFaults;

TEST(LedgerWorldCapture, FillsEverySlotWithItsOwnFrame) {
  LedgerCapture capture;
  const RunResult result = capture.run();
  EXPECT_EQ(result.outcome, Outcome::kComplete) << (result.failure ? result.failure->text : "");
  EXPECT_EQ(capture.keeper.frames.size(), 176U);
  EXPECT_EQ(capture.wrong_frame_count(), 0);
  EXPECT_EQ(result.retake_count, 0);
  EXPECT_TRUE(capture.incidents.empty());
}

}  // namespace
}  // namespace capture
