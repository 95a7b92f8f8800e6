// What the camera's frames say in place of a trigger box.
#include "rig/camera_trigger.h"

#include <gtest/gtest.h>

#include <optional>
#include <utility>
#include <vector>

namespace rig {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr milliseconds kCameraAhead{123'456};  // of the host's clock

// A camera with a clock and nothing else; of its answers the third is the quickest.
class ClockCamera final : public Camera {
 public:
  const CameraIdentity& identity() const override { return identity_; }
  Result<void> arm(const std::vector<microseconds>&, int) override { return {}; }
  void disarm() noexcept override {}
  Result<CameraCounters> counters() override {
    return CameraCounters{.trigger_count = 7, .missed_trigger_count = 2};
  }
  Result<CameraClockSample> read_clock() override {
    if (is_mute) return failure(Fault::kUnsupported, "no clock");
    const bool is_quick = ++read_count_ == 3;
    const nanoseconds error = is_quick ? nanoseconds(0) : milliseconds(5);
    return CameraClockSample{CameraClock::time_point(kCameraAhead), HostTime(error),
                             is_quick ? nanoseconds(1000) : nanoseconds(milliseconds(5))};
  }
  Result<void> trigger_software() override { return {}; }

  bool is_mute = false;

 private:
  CameraIdentity identity_;
  int read_count_ = 0;
};

class CameraTriggerTest : public testing::Test, public EventSink {
 protected:
  CameraTriggerTest() {
    trigger_.watch(camera_);
    EXPECT_TRUE(trigger_.arm({milliseconds(10), milliseconds(40)}, 1));
  }
  void post(Event event) override { events_.push_back(std::move(event)); }
  void frame(std::uint64_t block_id, std::uint64_t trigger_count, milliseconds start,
             std::optional<bool> is_line_high = {}) {
    Frame frame;
    frame.is_line_high = is_line_high;
    frame.block_id = block_id;
    frame.trigger_count = trigger_count;
    frame.timestamp = CameraClock::time_point(kCameraAhead + start);
    trigger_.post(FrameArrived{std::move(frame)});
  }
  template <typename Wanted>
  const Wanted* event(std::size_t index) const {
    return index < events_.size() ? std::get_if<Wanted>(&events_[index]) : nullptr;
  }

  ClockCamera camera_;
  CameraTrigger trigger_{*this};
  std::vector<Event> events_;
};

TEST_F(CameraTriggerTest, AFrameIsAnEdgeAndItsPulseOnTheHostsClock) {
  frame(1, 1, milliseconds(50));
  frame(2, 2, milliseconds(100));
  ASSERT_EQ(events_.size(), 6U);
  const auto* edge = event<EdgeSeen>(0);
  ASSERT_TRUE(edge);
  EXPECT_EQ(edge->edge_number, 1U);
  EXPECT_TRUE(edge->is_light) << "armed in the dark";
  EXPECT_EQ(edge->time, HostTime(milliseconds(50)));
  EXPECT_TRUE(event<FrameArrived>(2)) << "the frame last: its pulse must be known";
  EXPECT_FALSE(event<EdgeSeen>(3)->is_light);
  const auto* pulse = event<PulseEnded>(4);
  ASSERT_TRUE(pulse);
  EXPECT_EQ(pulse->pulse_number, 2U);
  EXPECT_EQ(pulse->edge_number, 2U);
  EXPECT_EQ(pulse->pulse_index, 0);
  EXPECT_EQ(pulse->ended - pulse->started, milliseconds(40)) << "exposures take turns";
}

TEST_F(CameraTriggerTest, TheLevelIsTheLinesWhateverTheCount) {
  frame(1, 1, milliseconds(50), true);
  frame(2, 2, milliseconds(100), true);  // no change of the square made it
  EXPECT_TRUE(event<EdgeSeen>(0)->is_light);
  EXPECT_TRUE(event<EdgeSeen>(3)->is_light);
}

TEST_F(CameraTriggerTest, AFrameThatComesTwiceIsOneEdge) {
  frame(1, 1, milliseconds(50));
  frame(1, 1, milliseconds(50));
  EXPECT_EQ(events_.size(), 4U);
  EXPECT_TRUE(event<FrameArrived>(3));
}

TEST_F(CameraTriggerTest, ATriggerThatGaveNoFrameLeavesAGapInTheEdges) {
  frame(1, 1, milliseconds(50));
  frame(2, 4, milliseconds(100));
  EXPECT_EQ(event<EdgeSeen>(3)->edge_number, 4U);
}

TEST_F(CameraTriggerTest, BlocksThatNeverCameAreToldOfOnce) {
  frame(1, 1, milliseconds(50));
  trigger_.post(FrameDamaged{2, {Fault::kFrameIncomplete, "holes"}});
  frame(4, 4, milliseconds(200));
  ASSERT_EQ(events_.size(), 8U);
  EXPECT_EQ(event<FrameDamaged>(3)->error.detail, "holes");
  EXPECT_EQ(event<FrameDamaged>(4)->block_id, 3U);
  EXPECT_EQ(event<EdgeSeen>(5)->edge_number, 4U);
}

TEST_F(CameraTriggerTest, DisarmedItOnlyPassesOn) {
  trigger_.disarm();
  frame(1, 1, milliseconds(50));
  EXPECT_EQ(events_.size(), 1U);
  EXPECT_TRUE(trigger_.arm({milliseconds(10)}, 2));
  frame(1, 1, milliseconds(50));
  EXPECT_EQ(events_.size(), 4U) << "counts start anew";
}

TEST_F(CameraTriggerTest, CountsAreTheCameras) {
  const auto counters = trigger_.counters();
  ASSERT_TRUE(counters);
  EXPECT_EQ(counters->edge_count, 7U);
  EXPECT_EQ(counters->pulse_count, 5U);
  EXPECT_EQ(counters->ignored_edge_count, 2U);
}

TEST_F(CameraTriggerTest, ACameraWithoutAClockIsRefused) {
  trigger_.disarm();
  camera_.is_mute = true;
  const auto armed = trigger_.arm({milliseconds(10)}, 2);
  ASSERT_FALSE(armed);
  EXPECT_EQ(armed.error().fault, Fault::kUnsupported);
  EXPECT_EQ(trigger_.device(), Device::kCamera) << "which is then to be opened anew";
}

}  // namespace
}  // namespace rig
