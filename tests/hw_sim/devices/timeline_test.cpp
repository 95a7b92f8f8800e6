#include "hw_sim/devices/timeline.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>
#include <stop_token>
#include <vector>

namespace hw_sim {
namespace {

using std::chrono::milliseconds;

TEST(Timeline, RunsActionsInTheOrderOfTimeThenOfScheduling) {
  Timeline timeline;
  const rig::HostTime start = timeline.now();
  std::vector<int> order;
  timeline.schedule(start + milliseconds(2), [&] { order.push_back(3); });
  timeline.schedule(start + milliseconds(1), [&] {
    order.push_back(1);
    timeline.schedule(start, [&] { order.push_back(2); });  // past: at once, but not within
  });
  timeline.schedule(start + milliseconds(2), [&] { order.push_back(4); });
  EXPECT_FALSE(timeline.wait(start + milliseconds(2), {}));
  EXPECT_THAT(order, testing::ElementsAre(1, 2, 3, 4));
}

TEST(Timeline, StandsAtTheMomentOfTheEvent) {
  Timeline timeline;
  const rig::HostTime start = timeline.now();
  timeline.schedule(start + milliseconds(5), [&] { timeline.post(rig::PictureShown{7, {}}); });
  timeline.schedule(start + milliseconds(6), [] { ADD_FAILURE() << "ran ahead"; });
  const std::optional<rig::Event> event = timeline.wait(start + milliseconds(100), {});
  ASSERT_TRUE(event);
  EXPECT_EQ(std::get<rig::PictureShown>(*event).show_id, 7U);
  EXPECT_EQ(timeline.now(), start + milliseconds(5));
}

TEST(Timeline, ReachesTheDeadlineWhenNothingComes) {
  Timeline timeline;
  const rig::HostTime deadline = timeline.now() + milliseconds(40);
  EXPECT_FALSE(timeline.wait(deadline, {}));
  EXPECT_EQ(timeline.now(), deadline);
}

TEST(Timeline, StopsWithoutMovingTime) {
  Timeline timeline;
  const rig::HostTime start = timeline.now();
  std::stop_source stop;
  stop.request_stop();
  EXPECT_FALSE(timeline.wait(start + milliseconds(40), stop.get_token()));
  EXPECT_EQ(timeline.now(), start);
}

}  // namespace
}  // namespace hw_sim
