#include "rig/opening.h"

#include <gtest/gtest.h>

#include <atomic>
#include <latch>
#include <memory>
#include <utility>

namespace rig {
namespace {

// A device that knows how many there are, and where they were closed.
class Thing {
 public:
  explicit Thing(std::atomic<int>& count) : count_(count) { ++count_; }
  ~Thing() { --count_; }
  Thing(const Thing&) = delete;
  Thing& operator=(const Thing&) = delete;

 private:
  std::atomic<int>& count_;
};

class OpeningTest : public testing::Test {
 protected:
  std::unique_ptr<Thing> make() { return std::make_unique<Thing>(thing_count_); }
  Opening<Thing>::Opened open() {
    count_at_opening_ = thing_count_.load();
    may_open_.wait();
    ++open_count_;
    if (is_there_) return make();
    return failure(Fault::kNotFound, "nobody answers");
  }
  bool is_over() { return opening_.wait(HostTime::max(), {}); }

  std::atomic<int> thing_count_{0}, open_count_{0}, over_count_{0};
  int count_at_opening_ = -1;
  bool is_there_ = true;
  std::latch may_open_{1};
  Opening<Thing> opening_{[this] { return open(); }, [this] { ++over_count_; }};
};

TEST_F(OpeningTest, OldDeviceIsClosedBeforeTheNewOneIsOpenedAndHandedOutOnce) {
  opening_.reopen(make());
  EXPECT_TRUE(opening_.is_under_way());
  EXPECT_FALSE(opening_.take()) << "too early";
  may_open_.count_down();
  ASSERT_TRUE(is_over());
  EXPECT_EQ(count_at_opening_, 0);
  auto opened = opening_.take();
  ASSERT_TRUE(opened && *opened);
  EXPECT_EQ(thing_count_, 1);
  EXPECT_FALSE(opening_.take());
}

TEST_F(OpeningTest, AStopEndsTheWaitingNotTheOpening) {
  opening_.reopen(nullptr);
  std::stop_source stop;
  stop.request_stop();
  EXPECT_FALSE(opening_.wait(HostTime::max(), stop.get_token()));
  EXPECT_FALSE(opening_.wait(HostClock::now(), {})) << "nor does a deadline";
  EXPECT_FALSE(opening_.take());
  may_open_.count_down();
  ASSERT_TRUE(is_over());
  EXPECT_TRUE(opening_.take());
}

TEST_F(OpeningTest, WhatIsUnderWayOrReadyIsNotBegunTwice) {
  opening_.reopen(nullptr);
  opening_.reopen(nullptr);
  may_open_.count_down();
  ASSERT_TRUE(is_over());
  opening_.reopen(nullptr);  // whoever waited for the first has gone
  EXPECT_EQ(open_count_, 1);
  EXPECT_TRUE(opening_.take());
  opening_.close(nullptr);
  ASSERT_TRUE(is_over());
  EXPECT_EQ(over_count_, 2) << "the second for the ready one; closing tells nobody";
}

TEST_F(OpeningTest, AFailureIsToldAndTriedAgain) {
  is_there_ = false;
  may_open_.count_down();
  opening_.reopen(nullptr);
  ASSERT_TRUE(is_over());
  opening_.reopen(nullptr);
  ASSERT_TRUE(is_over());
  EXPECT_EQ(open_count_, 2);
  const auto opened = opening_.take();
  ASSERT_TRUE(opened && !*opened);
  EXPECT_EQ(opened->error().detail, "nobody answers");
}

TEST_F(OpeningTest, WhatNobodyTookIsClosed) {
  may_open_.count_down();
  opening_.reopen(nullptr);
  ASSERT_TRUE(is_over());
  EXPECT_EQ(thing_count_, 1);
  opening_.close(make());
  ASSERT_TRUE(is_over());
  EXPECT_EQ(thing_count_, 0);
  {
    Opening<Thing> late([this] { return open(); }, [] {});
    late.reopen(nullptr);
  }
  EXPECT_EQ(thing_count_, 0) << "waited for, and closed";
}

}  // namespace
}  // namespace rig
