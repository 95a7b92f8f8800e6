#include "capture/plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

namespace capture {
namespace {

rig::ProjectorSettings projector(int width_px, int height_px) {
  rig::ProjectorSettings settings;
  settings.width_px = width_px;
  settings.height_px = height_px;
  return settings;
}

TEST(PaperPlan, IsThePapersOnThePapersProjector) {
  const auto plan = make_plan("paper", projector(1024, 768), {});
  ASSERT_TRUE(plan);
  EXPECT_EQ(plan->patterns, estimation::paper_patterns());
}

TEST(PaperPlan, HasTheBitsThatTheProjectorNeeds) {
  const auto plan = make_plan("paper", projector(1920, 1080), {});
  ASSERT_TRUE(plan);
  EXPECT_EQ(plan->patterns.size(), 40U + 2 * (22 + 4));
  int highest_bit = 0;
  for (std::size_t i = 0; i < plan->patterns.size(); ++i) {
    EXPECT_EQ(plan->patterns[i].index, static_cast<int>(i));
    if (const auto* gray = std::get_if<estimation::GrayCode>(&plan->patterns[i].kind))
      highest_bit = std::max(highest_bit, gray->bit);
  }
  EXPECT_EQ(highest_bit, 10);
  EXPECT_EQ(make_plan("paper", projector(1025, 512), {})->patterns.size(), 40U + 22 + 4 + 18 + 4);
}

TEST(PaperPlan, ShuffleMovesTheShiftsAndNothingElse) {
  rig::SequenceSettings sequence;
  sequence.is_shuffled = true;
  const auto plan = make_plan("paper", projector(1024, 768), sequence);
  ASSERT_TRUE(plan);
  EXPECT_EQ(std::set<int>(plan->order.begin(), plan->order.end()).size(), 88U);
  int moved_count = 0;
  for (int i = 0; i < 88; ++i) {
    const int pattern = plan->order[static_cast<std::size_t>(i)];
    if (i >= 40) {
      EXPECT_EQ(pattern, i);
    }
    if (pattern != i) ++moved_count;
  }
  EXPECT_GT(moved_count, 30);
  EXPECT_EQ(plan->order, make_plan("paper", projector(1024, 768), sequence)->order);
}

TEST(PaperPlan, UnknownNameIsAnErrorWithTheRemedy) {
  const auto plan = make_plan("poster", projector(1024, 768), {});
  ASSERT_FALSE(plan);
  EXPECT_THAT(plan.error().detail, testing::HasSubstr("choose \"paper\""));
}

}  // namespace
}  // namespace capture
