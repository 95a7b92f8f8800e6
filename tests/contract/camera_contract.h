// What every rig::Camera does, tried on each: instantiate with
// INSTANTIATE_TEST_SUITE_P(Name, CameraContract, testing::Values(CameraBenchMaker{...}),
// camera_bench_name). A bench has its own clock, real or virtual, behind rig::EventSource.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "rig/camera.h"
#include "rig/event.h"
#include "tests/contract/camera_bench.h"

class CameraContract : public testing::TestWithParam<CameraBenchMaker> {
 protected:
  using microseconds = std::chrono::microseconds;

  std::vector<microseconds> exposures_{microseconds(1000), microseconds(3000), microseconds(2000)};
  // Long enough for a loaded machine; only failures wait for it.
  static constexpr std::chrono::seconds kPatience{5};
  // How long nothing must come where nothing may.
  static constexpr std::chrono::milliseconds kSilence{150};

  void SetUp() override {
    bench_ = GetParam().make();
    ASSERT_NE(bench_, nullptr);
    open();
  }

  void open() {
    auto camera = bench_->open();
    ASSERT_TRUE(camera.has_value()) << camera.error().detail;
    camera_ = std::move(*camera);
  }

  void arm(int frame_count) {
    const auto armed = camera_->arm(exposures_, frame_count);
    ASSERT_TRUE(armed.has_value()) << armed.error().detail;
  }

  microseconds exposure(int pulse_index) const {
    return exposures_[static_cast<std::size_t>(pulse_index) % exposures_.size()];
  }

  // Sorts what comes until `deadline`, or until `is_enough`.
  void collect(rig::HostTime deadline, const std::function<bool()>& is_enough) {
    while (!is_enough()) {
      std::optional<rig::Event> event = bench_->source().wait(deadline, {});
      if (!event) return;
      if (auto* arrived = std::get_if<rig::FrameArrived>(&*event))
        frames_.push_back(std::move(arrived->frame));
      else
        others_.push_back(std::move(*event));
    }
  }

  void let_pass(std::chrono::nanoseconds duration) {
    collect(bench_->source().now() + duration, [] { return false; });
  }

  // Pulses as the trigger box gives them: each bracket as wide as its exposure, far enough apart.
  void pulse_train(int pulse_count) {
    for (int i = 0; i < pulse_count; ++i) {
      bench_->pulse(exposure(i));
      let_pass(exposure(i) + bench_->readout() + microseconds(2000));
    }
  }

  void expect_frames(std::size_t frame_count) {
    collect(bench_->source().now() + kPatience, [&] { return frames_.size() >= frame_count; });
    EXPECT_EQ(frames_.size(), frame_count);
    EXPECT_TRUE(others_.empty());
  }

  // Declared so that frames go last: they outlive the camera, as leases may.
  std::unique_ptr<CameraBench> bench_;
  std::vector<rig::Frame> frames_;
  std::vector<rig::Event> others_;
  std::unique_ptr<rig::Camera> camera_;
};

TEST_P(CameraContract, EachPulseIsOneFrameNumberedFromOne) {
  ASSERT_NO_FATAL_FAILURE(arm(6));
  pulse_train(6);
  expect_frames(6);
  for (std::size_t i = 0; i < frames_.size(); ++i) {
    EXPECT_EQ(frames_[i].block_id, i + 1);
    EXPECT_EQ(frames_[i].trigger_count.value_or(i + 1), i + 1);
  }
}

TEST_P(CameraContract, FramesAreWholeAndAsTheirFormatSays) {
  ASSERT_NO_FATAL_FAILURE(arm(1));
  pulse_train(1);
  expect_frames(1);
  ASSERT_EQ(frames_.size(), 1U);
  const rig::Frame& frame = frames_.front();
  const auto pixel_count =
      static_cast<std::size_t>(frame.width_px) * static_cast<std::size_t>(frame.height_px);
  EXPECT_GT(pixel_count, 0U);
  EXPECT_EQ(frame.pixels.size() % pixel_count, 0U);
  EXPECT_FALSE(frame.pixel_format.empty());
}

TEST_P(CameraContract, ExposuresCycleFromTheFirstAfterEachArm) {
  for (int round = 0; round < 2; ++round) {
    SCOPED_TRACE(round);
    frames_.clear();
    ASSERT_NO_FATAL_FAILURE(arm(8));
    pulse_train(4);  // one more than a cycle: the next arm() must not go on where this stopped
    expect_frames(4);
    for (std::size_t i = 0; i < frames_.size(); ++i)
      EXPECT_EQ(frames_[i].exposure, exposure(static_cast<int>(i)));
    camera_->disarm();
  }
}

TEST_P(CameraContract, TimestampsAreThePulsesOnTheCamerasClock) {
  ASSERT_NO_FATAL_FAILURE(arm(3));
  std::vector<rig::HostTime> before;
  std::vector<rig::HostTime> after;
  for (int i = 0; i < 3; ++i) {
    before.push_back(bench_->source().now());
    bench_->pulse(exposure(i));
    after.push_back(bench_->source().now());
    let_pass(exposure(i) + bench_->readout() + microseconds(2000));
  }
  expect_frames(3);
  ASSERT_EQ(frames_.size(), 3U);
  for (std::size_t i = 1; i < frames_.size(); ++i) {
    const auto elapsed = frames_[i].timestamp - frames_[i - 1].timestamp;
    const microseconds slack(100);  // crystals differ
    EXPECT_GE(elapsed, before[i] - after[i - 1] - slack);
    EXPECT_LE(elapsed, after[i] - before[i - 1] + slack);
  }
}

TEST_P(CameraContract, ItsClockIsTheOneOfTheTimestamps) {
  ASSERT_NO_FATAL_FAILURE(arm(1));
  const auto sample = camera_->read_clock();
  ASSERT_TRUE(sample.has_value()) << sample.error().detail;
  const rig::HostTime before = bench_->source().now();
  bench_->pulse(exposure(0));
  const rig::HostTime after = bench_->source().now();
  expect_frames(1);
  ASSERT_EQ(frames_.size(), 1U);
  const rig::HostTime start = sample->host + (frames_[0].timestamp - sample->device);
  const auto slack = sample->uncertainty + microseconds(100);  // crystals differ
  EXPECT_GE(start, before - slack);
  EXPECT_LE(start, after + slack);
}

TEST_P(CameraContract, PulseWhileBusyGivesNoFrameAndIsCounted) {
  exposures_[0] = std::chrono::milliseconds(60);  // longer than this thread is ever held up
  ASSERT_NO_FATAL_FAILURE(arm(4));
  bench_->pulse(exposure(0));
  bench_->pulse(exposure(1));  // within the first exposure
  let_pass(exposure(0) + bench_->readout() + microseconds(2000));
  bench_->pulse(exposure(1));
  expect_frames(2);
  ASSERT_EQ(frames_.size(), 2U);
  EXPECT_EQ(frames_[1].block_id, 2U);
  EXPECT_EQ(frames_[1].trigger_count.value_or(3), 3U);
  const auto counters = camera_->counters();
  ASSERT_TRUE(counters.has_value()) << counters.error().detail;
  EXPECT_EQ(counters->trigger_count, 3);
  EXPECT_EQ(counters->missed_trigger_count, 1);
  EXPECT_EQ(counters->delivered_frame_count, 2);
  EXPECT_EQ(counters->damaged_frame_count, 0);
}

TEST_P(CameraContract, CountersStartAtZeroWithEachArm) {
  ASSERT_NO_FATAL_FAILURE(arm(2));
  pulse_train(2);
  expect_frames(2);
  camera_->disarm();
  ASSERT_NO_FATAL_FAILURE(arm(2));
  const auto counters = camera_->counters();
  ASSERT_TRUE(counters.has_value()) << counters.error().detail;
  EXPECT_EQ(counters->trigger_count, 0);
  EXPECT_EQ(counters->missed_trigger_count, 0);
  EXPECT_EQ(counters->delivered_frame_count, 0);
}

TEST_P(CameraContract, StartsAgainAfterStop) {
  for (int round = 0; round < 3; ++round) {
    SCOPED_TRACE(round);
    frames_.clear();
    ASSERT_NO_FATAL_FAILURE(arm(2));
    pulse_train(2);
    expect_frames(2);
    ASSERT_FALSE(frames_.empty());
    EXPECT_EQ(frames_.front().block_id, 1U);
    camera_->disarm();
    camera_->disarm();
  }
}

TEST_P(CameraContract, NothingComesWhileIdle) {
  camera_->disarm();
  bench_->pulse(exposure(0));
  let_pass(kSilence);
  ASSERT_NO_FATAL_FAILURE(arm(2));
  bench_->pulse(exposure(0));
  camera_->disarm();
  bench_->pulse(exposure(1));
  let_pass(kSilence);
  EXPECT_LE(frames_.size(), 1U);  // the armed pulse's frame may have been posted before disarm()
  EXPECT_TRUE(others_.empty());
}

TEST_P(CameraContract, FrameOutlivesTheCamera) {
  ASSERT_NO_FATAL_FAILURE(arm(2));
  pulse_train(2);
  expect_frames(2);
  ASSERT_EQ(frames_.size(), 2U);
  const std::vector<std::byte> before(frames_[0].pixels.begin(), frames_[0].pixels.end());
  frames_.pop_back();
  camera_.reset();
  EXPECT_TRUE(std::equal(before.begin(), before.end(), frames_[0].pixels.begin()));
  std::jthread([frame = std::move(frames_[0])]() mutable { frame.lease.reset(); });
}

TEST_P(CameraContract, FrameHeldAcrossArmsKeepsItsPixels) {
  ASSERT_NO_FATAL_FAILURE(arm(2));
  pulse_train(1);
  expect_frames(1);
  ASSERT_EQ(frames_.size(), 1U);
  const rig::Frame held = std::move(frames_[0]);
  const std::vector<std::byte> before(held.pixels.begin(), held.pixels.end());
  frames_.clear();
  camera_->disarm();
  ASSERT_NO_FATAL_FAILURE(arm(2));
  pulse_train(2);
  expect_frames(2);
  EXPECT_TRUE(std::equal(before.begin(), before.end(), held.pixels.begin()));
}

TEST_P(CameraContract, ArmedCameraIsBusy) {
  ASSERT_NO_FATAL_FAILURE(arm(2));
  const auto again = camera_->arm(exposures_, 2);
  ASSERT_FALSE(again.has_value());
  EXPECT_EQ(again.error().fault, rig::Fault::kBusy);
  pulse_train(1);  // and still armed
  expect_frames(1);
}

TEST_P(CameraContract, ImpossibleExposureIsRefusedAndLeavesItIdle) {
  for (const std::vector<microseconds>& impossible :
       {std::vector<microseconds>{}, std::vector<microseconds>{microseconds(0)},
        std::vector<microseconds>{microseconds(1000), std::chrono::hours(1)}}) {
    const auto armed = camera_->arm(impossible, 2);
    ASSERT_FALSE(armed.has_value());
    EXPECT_EQ(armed.error().fault, rig::Fault::kOutOfRange);
    EXPECT_FALSE(armed.error().detail.empty());
  }
  ASSERT_NO_FATAL_FAILURE(arm(2));
  pulse_train(2);
  expect_frames(2);
}

TEST_P(CameraContract, OpensAgainAfterClosing) {
  camera_.reset();
  ASSERT_NO_FATAL_FAILURE(open());
  EXPECT_FALSE(camera_->identity().serial.empty());
  ASSERT_NO_FATAL_FAILURE(arm(1));
  pulse_train(1);
  expect_frames(1);
}
