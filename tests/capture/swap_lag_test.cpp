// What a run's priming teaches of the time from a swap to its edge.
#include "capture/swap_lag.h"

#include <gtest/gtest.h>

namespace capture {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kRefresh{16};  // and 20 ms of tolerance

TEST(SwapLag, TheLongestOfThePrimingIsTheMeasure) {
  SwapLag lag(kRefresh);
  EXPECT_FALSE(lag.learn(milliseconds(20)));
  EXPECT_FALSE(lag.learn(milliseconds(33)));
  EXPECT_FALSE(lag.learn(milliseconds(25)));
  EXPECT_FALSE(lag.check(milliseconds(53)));
  EXPECT_EQ(lag.check(milliseconds(54)), milliseconds(21));
  EXPECT_FALSE(lag.check(milliseconds(13)));
  EXPECT_EQ(lag.check(milliseconds(12)), milliseconds(-21));
}

TEST(SwapLag, APrimingThatDisagreesIsNotLearnt) {
  SwapLag lag(kRefresh);
  EXPECT_FALSE(lag.learn(milliseconds(30)));
  EXPECT_FALSE(lag.learn(milliseconds(20)));
  EXPECT_EQ(lag.learn(milliseconds(9)), milliseconds(-21)) << "from the longest";
  EXPECT_EQ(lag.learn(milliseconds(41)), milliseconds(21)) << "from the shortest";
  EXPECT_EQ(lag.check(milliseconds(51)), milliseconds(21));
}

TEST(SwapLag, TheFirstOfAllIsLearnt) {
  SwapLag lag(kRefresh);
  EXPECT_FALSE(lag.check(milliseconds(5)));
  EXPECT_TRUE(lag.check(milliseconds(50)));
  lag.forget();
  EXPECT_FALSE(lag.check(milliseconds(50)));
}

}  // namespace
}  // namespace capture
