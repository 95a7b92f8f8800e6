// What every rig::Projector promises, run over the wire and in process. A fixture type F has
//   static rig::ProjectorSettings settings();   // at least 16 x 16 px, monitor as opened
//   void run(const std::function<void(rig::Projector&, rig::EventSource&)>& body);
// run() opens a projector, calls `body` while its window is served (on whichever thread), and
// closes it.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <stop_token>
#include <utility>
#include <variant>
#include <vector>

#include "estimation/base/image.h"
#include "rig/event.h"
#include "rig/projector.h"
#include "tests/contract/projector_events.h"

namespace rig::contract {

template <typename Fixture>
class ProjectorContract : public testing::Test {
 protected:
  using Body = std::function<void(Projector&, EventSource&)>;
  void run(const Body& body) { fixture_.run(body); }
  static ProjectorSettings settings() { return Fixture::settings(); }
  static std::vector<estimation::Image<unsigned char>> pictures(int count) {
    return plain_pictures(settings(), count);
  }

 private:
  Fixture fixture_;
};

TYPED_TEST_SUITE_P(ProjectorContract);

TYPED_TEST_P(ProjectorContract, EveryShowIsAnsweredOnceAndInOrder) {
  this->run([this](Projector& projector, EventSource& events) {
    constexpr int kPictureCount = 5;
    ASSERT_TRUE(projector.load(this->pictures(kPictureCount)));
    constexpr std::uint64_t kShowCount = 12;
    for (std::uint64_t id = 1; id <= kShowCount; ++id)
      ASSERT_TRUE(projector.show({.show_id = id,
                                  .picture = static_cast<int>(id) % kPictureCount,
                                  .is_square_light = id % 2 == 1}));
    HostTime last{};
    for (std::uint64_t id = 1; id <= kShowCount; ++id) {
      const std::optional<PictureShown> shown = wait_for_shown(events);
      ASSERT_TRUE(shown);
      EXPECT_EQ(shown->show_id, id);
      EXPECT_GE(shown->swapped, last);
      last = shown->swapped;
    }
    // Nothing is left but the answer to one more.
    ASSERT_TRUE(projector.show({.show_id = 100}));
    const std::optional<PictureShown> shown = wait_for_shown(events);
    ASSERT_TRUE(shown);
    EXPECT_EQ(shown->show_id, 100U);
  });
}

TYPED_TEST_P(ProjectorContract, ShowIsAnsweredAfterItWasAsked) {
  this->run([this](Projector& projector, EventSource& events) {
    ASSERT_TRUE(projector.load(this->pictures(1)));
    for (std::uint64_t id = 1; id <= 4; ++id) {
      const HostTime asked = events.now();
      ASSERT_TRUE(projector.show({.show_id = id, .picture = 0, .is_square_light = true}));
      const std::optional<PictureShown> shown = wait_for_shown(events);
      ASSERT_TRUE(shown);
      EXPECT_GE(shown->swapped, asked);
      EXPECT_LE(shown->swapped, events.now());
    }
  });
}

TYPED_TEST_P(ProjectorContract, PictureThatIsNotLoadedIsRefused) {
  this->run([this](Projector& projector, EventSource& events) {
    const auto refusal = [&projector](int picture) {
      const Result<void> shown = projector.show({.show_id = 1, .picture = picture});
      return shown ? std::optional<Fault>() : shown.error().fault;
    };
    EXPECT_EQ(refusal(0), Fault::kOutOfRange) << "before any load";
    ASSERT_TRUE(projector.load(this->pictures(3)));
    EXPECT_EQ(refusal(3), Fault::kOutOfRange);
    EXPECT_EQ(refusal(-2), Fault::kOutOfRange);
    ASSERT_TRUE(projector.show({.show_id = 2, .picture = 2}));
    const std::optional<PictureShown> shown = wait_for_shown(events);
    ASSERT_TRUE(shown);
    EXPECT_EQ(shown->show_id, 2U) << "a refused show is not answered";
  });
}

TYPED_TEST_P(ProjectorContract, PictureOfAnotherSizeIsRefusedAndTheOldOnesStay) {
  this->run([this](Projector& projector, EventSource& events) {
    ASSERT_TRUE(projector.load(this->pictures(2)));
    const ProjectorSettings size = this->settings();
    for (const auto& [height_px, width_px, channel_count] :
         {std::array{size.height_px + 1, size.width_px, 1},
          std::array{size.height_px, size.width_px - 1, 1},
          std::array{size.height_px, size.width_px, 3}, std::array{0, 0, 1}}) {
      SCOPED_TRACE(testing::Message() << height_px << " x " << width_px);
      std::vector<estimation::Image<unsigned char>> pictures = this->pictures(3);
      pictures[1] = estimation::Image<unsigned char>(height_px, width_px, channel_count);
      const Result<void> loaded = projector.load(std::move(pictures));
      ASSERT_FALSE(loaded);
      EXPECT_EQ(loaded.error().fault, Fault::kOutOfRange);
    }
    EXPECT_FALSE(projector.show({.show_id = 1, .picture = 2}));
    ASSERT_TRUE(projector.show({.show_id = 2, .picture = 1}));
    EXPECT_TRUE(wait_for_shown(events));
  });
}

TYPED_TEST_P(ProjectorContract, BlackNeedsNoPictures) {
  this->run([](Projector& projector, EventSource& events) {
    ASSERT_TRUE(projector.show({.show_id = 7, .picture = kBlackPicture, .is_square_light = true}));
    const std::optional<PictureShown> shown = wait_for_shown(events);
    ASSERT_TRUE(shown);
    EXPECT_EQ(shown->show_id, 7U);
  });
}

TYPED_TEST_P(ProjectorContract, LoadReplacesThePictures) {
  this->run([this](Projector& projector, EventSource& events) {
    ASSERT_TRUE(projector.load(this->pictures(4)));
    ASSERT_TRUE(projector.show({.show_id = 1, .picture = 3}));
    ASSERT_TRUE(wait_for_shown(events));
    ASSERT_TRUE(projector.load(this->pictures(2)));
    EXPECT_FALSE(projector.show({.show_id = 2, .picture = 3}));
    ASSERT_TRUE(projector.show({.show_id = 3, .picture = 1}));
    const std::optional<PictureShown> shown = wait_for_shown(events);
    ASSERT_TRUE(shown);
    EXPECT_EQ(shown->show_id, 3U);
  });
}

TYPED_TEST_P(ProjectorContract, LoadingNothingLeavesBlack) {
  this->run([this](Projector& projector, EventSource& events) {
    ASSERT_TRUE(projector.load(this->pictures(1)));
    ASSERT_TRUE(projector.load({}));
    EXPECT_FALSE(projector.show({.show_id = 1, .picture = 0}));
    ASSERT_TRUE(projector.show({.show_id = 2}));
    EXPECT_TRUE(wait_for_shown(events));
  });
}

TYPED_TEST_P(ProjectorContract, ReportNamesTheMonitorAndItsSize) {
  this->run([this](Projector& projector, EventSource&) {
    const DisplayReport report = projector.report();
    const ProjectorSettings settings = this->settings();
    EXPECT_EQ(report.monitor, settings.monitor);
    EXPECT_EQ(report.width_px, settings.width_px);
    EXPECT_EQ(report.height_px, settings.height_px);
    EXPECT_GT(report.measured_refresh_hz, 0);
    EXPECT_TRUE(report.is_gamma_identity);
    EXPECT_FALSE(report.text.empty());
  });
}

TYPED_TEST_P(ProjectorContract, StartsAgainAfterItWasClosed) {
  for (int round = 0; round < 2; ++round)
    this->run([this](Projector& projector, EventSource& events) {
      EXPECT_FALSE(projector.show({.show_id = 1, .picture = 0})) << "pictures of the last one";
      ASSERT_TRUE(projector.load(this->pictures(1)));
      ASSERT_TRUE(projector.show({.show_id = 2, .picture = 0}));
      EXPECT_TRUE(wait_for_shown(events));
    });
}

REGISTER_TYPED_TEST_SUITE_P(ProjectorContract, EveryShowIsAnsweredOnceAndInOrder,
                            ShowIsAnsweredAfterItWasAsked, PictureThatIsNotLoadedIsRefused,
                            PictureOfAnotherSizeIsRefusedAndTheOldOnesStay, BlackNeedsNoPictures,
                            LoadReplacesThePictures, LoadingNothingLeavesBlack,
                            ReportNamesTheMonitorAndItsSize, StartsAgainAfterItWasClosed);

}  // namespace rig::contract
