// What the product draws, as light and as a photodiode's reading.
#include "hw_sim/display/screen_grabber.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <condition_variable>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include "tests/contract/projector_events.h"
#include "tests/wire/display/display_fixture.h"
#include "tests/wire/display/screen_reader.h"

namespace {

using display_test::kHeight_px;
using display_test::kWidth_px;
using display_test::projector_settings;
using display_test::run_projector;
using display_test::screen;
using estimation::Image;
using hw_sim::LightSegment;
using rig::contract::wait_for_shown;

constexpr int kDark_adc = 100;
constexpr int kLight_adc = 900;

// The photodiode's readings, and the pictures that were lit, as they come.
class Watcher {
 public:
  // `work` keeps the grabber's thread from looking at the screen, at every picture.
  explicit Watcher(hw_sim::GrabberSettings settings = {},
                   std::chrono::milliseconds work = std::chrono::milliseconds(0)) {
    if (settings.display.empty()) settings.display = screen().display();
    settings.sync_square = projector_settings().sync_square;
    auto grabber = hw_sim::ScreenGrabber::start(
        settings, light_,
        [this, work](const auto& picture) {
          add([&] { pictures_.push_back(picture); });
          std::this_thread::sleep_for(work);
        },
        [this](rig::HostTime time, int level_adc) {
          add([&] { levels_.push_back({time, level_adc}); });
        });
    EXPECT_TRUE(grabber) << grabber.error().detail;
    if (grabber) grabber_ = std::move(*grabber);
  }

  // Until level number `count` has come: it.
  std::optional<hw_sim::LevelSample> wait_for_level(std::size_t count) {
    std::unique_lock lock(mutex_);
    if (!changed_.wait_for(lock, rig::contract::kEventPatience,
                           [&] { return levels_.size() >= count; }))
      return std::nullopt;
    return levels_[count - 1];
  }
  std::shared_ptr<const hw_sim::Picture> wait_for_picture(std::size_t count) {
    std::unique_lock lock(mutex_);
    if (!changed_.wait_for(lock, rig::contract::kEventPatience,
                           [&] { return pictures_.size() >= count; }))
      return nullptr;
    return pictures_[count - 1];
  }
  std::size_t level_count() {
    const std::lock_guard lock(mutex_);
    return levels_.size();
  }
  std::size_t picture_count() {
    const std::lock_guard lock(mutex_);
    return pictures_.size();
  }
  // What is lit at an instant.
  std::shared_ptr<const hw_sim::Picture> lit_at(rig::HostTime time) const {
    const std::vector<LightSegment> segments =
        light_.between(time, time + std::chrono::nanoseconds(1));
    return segments.empty() ? nullptr : segments.front().picture;
  }

 private:
  template <typename Change>
  void add(Change change) {
    {
      const std::lock_guard lock(mutex_);
      change();
    }
    changed_.notify_all();
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<hw_sim::LevelSample> levels_;                       // guarded by mutex_
  std::vector<std::shared_ptr<const hw_sim::Picture>> pictures_;  // guarded by mutex_
  hw_sim::LightTimeline light_;
  std::unique_ptr<hw_sim::ScreenGrabber> grabber_;
};

TEST(ScreenGrabber, EveryAlternationIsOneEdgeWithItsPictureAlreadyLit) {
  constexpr int kPatternCount = 88;
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource& events) {
    ASSERT_TRUE(projector.load(rig::contract::plain_pictures(projector_settings(), 25)));
    Watcher watcher;
    ASSERT_TRUE(watcher.wait_for_level(1));  // dark, as found
    for (int i = 0; i < kPatternCount; ++i) {
      const bool is_square_light = i % 2 == 0;
      ASSERT_TRUE(projector.show({.show_id = static_cast<std::uint64_t>(i),
                                  .picture = i % 25,
                                  .is_square_light = is_square_light}));
      const std::optional<rig::PictureShown> shown = wait_for_shown(events);
      ASSERT_TRUE(shown);
      const auto level = watcher.wait_for_level(static_cast<std::size_t>(i) + 2);
      ASSERT_TRUE(level) << "pattern " << i;
      EXPECT_EQ(level->level_adc, is_square_light ? kLight_adc : kDark_adc);
      EXPECT_GE(level->time, shown->swapped);
      const std::shared_ptr<const hw_sim::Picture> lit = watcher.lit_at(level->time);
      ASSERT_TRUE(lit);
      EXPECT_EQ(lit->brightness.at(0, 0), 10 * (i % 25 + 1)) << "pattern " << i;
    }
    EXPECT_EQ(watcher.level_count(), static_cast<std::size_t>(kPatternCount) + 1);
  });
}

// What a busy computer does to the simulation's threads happens to no lamp.
TEST(ScreenGrabber, LightIsDatedByTheBlankHoweverLateItIsSeen) {
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource& events) {
    ASSERT_TRUE(projector.load(rig::contract::plain_pictures(projector_settings(), 2)));
    Watcher watcher({}, std::chrono::milliseconds(120));
    ASSERT_TRUE(watcher.wait_for_level(1));
    const auto show = [&](int picture) {
      EXPECT_TRUE(projector.show({.show_id = 1, .picture = picture, .is_square_light = true}));
      return wait_for_shown(events);
    };
    ASSERT_TRUE(show(0));
    ASSERT_TRUE(watcher.wait_for_picture(2));  // and the grabber is busy with it for a while
    const std::optional<rig::PictureShown> shown = show(1);
    ASSERT_TRUE(shown);
    const auto two_refreshes = std::chrono::microseconds(33'400);
    std::this_thread::sleep_until(shown->swapped + two_refreshes);
    const std::shared_ptr<const hw_sim::Picture> lit =
        watcher.lit_at(shown->swapped + two_refreshes);
    ASSERT_TRUE(lit);
    EXPECT_EQ(lit->brightness.at(0, 0), 20);
  });
}

TEST(ScreenGrabber, SamePatternIsTheSamePictureWhateverItsSquare) {
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource&) {
    ASSERT_TRUE(projector.load(rig::contract::plain_pictures(projector_settings(), 2)));
    Watcher watcher;
    std::vector<std::shared_ptr<const hw_sim::Picture>> lit;
    std::size_t level_count = 1;
    ASSERT_TRUE(watcher.wait_for_level(level_count));
    for (const int picture : {0, 1, 0, 0}) {
      ASSERT_TRUE(projector.show(
          {.show_id = 1, .picture = picture, .is_square_light = level_count % 2 == 1}));
      const auto level = watcher.wait_for_level(++level_count);
      ASSERT_TRUE(level);
      lit.push_back(watcher.lit_at(level->time));
    }
    EXPECT_EQ(lit[0], lit[2]);
    EXPECT_EQ(lit[0], lit[3]);
    EXPECT_NE(lit[0]->id, lit[1]->id);
    EXPECT_EQ(lit[0]->brightness.at(kHeight_px - 1, kWidth_px - 1), 0)
        << "the photodiode keeps the square's light";
  });
}

TEST(ScreenGrabber, GammaRampBendsTheLight) {
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource& events) {
    ASSERT_TRUE(projector.load(rig::contract::plain_pictures(projector_settings(), 13)));
    Watcher watcher;
    ASSERT_TRUE(projector.show({.show_id = 1, .picture = 12}));  // level 130
    ASSERT_TRUE(wait_for_shown(events));
    ASSERT_TRUE(watcher.wait_for_picture(2));
    EXPECT_EQ(watcher.wait_for_picture(2)->brightness.at(0, 0), 130);
    ASSERT_TRUE(screen().set_projector_gamma(2));
    const auto bent = watcher.wait_for_picture(3);
    ASSERT_TRUE(bent);
    EXPECT_NEAR(bent->brightness.at(0, 0), 130.0 * 130.0 / 255.0, 1);
  });
  ASSERT_TRUE(screen().set_projector_gamma(1));
}

TEST(ScreenGrabber, UnpluggedProjectorIsDark) {
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource& events) {
    ASSERT_TRUE(projector.load(rig::contract::plain_pictures(projector_settings(), 1)));
    Watcher watcher;
    ASSERT_TRUE(watcher.wait_for_level(1));
    ASSERT_TRUE(projector.show({.show_id = 1, .picture = 0, .is_square_light = true}));
    ASSERT_TRUE(wait_for_shown(events));
    ASSERT_TRUE(watcher.wait_for_level(2));
    ASSERT_TRUE(screen().unplug_projector());
    const auto level = watcher.wait_for_level(3);
    ASSERT_TRUE(level);
    EXPECT_EQ(level->level_adc, kDark_adc);
    EXPECT_EQ(watcher.lit_at(level->time)->brightness.at(0, 0), 0);
    ASSERT_TRUE(screen().plug_projector_in());
  });
}

TEST(ScreenGrabber, InputLagDelaysLightAndReadingAlike) {
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource& events) {
    ASSERT_TRUE(projector.load(rig::contract::plain_pictures(projector_settings(), 1)));
    Watcher watcher({.input_lag_frames = 4});
    ASSERT_TRUE(watcher.wait_for_level(1));
    ASSERT_TRUE(projector.show({.show_id = 1, .picture = 0, .is_square_light = true}));
    const auto shown = wait_for_shown(events);
    const auto level = watcher.wait_for_level(2);
    ASSERT_TRUE(shown && level);
    EXPECT_GE(level->time - shown->swapped, std::chrono::milliseconds(4 * 16));
    EXPECT_EQ(watcher.lit_at(level->time)->brightness.at(0, 0), 10);
    EXPECT_EQ(watcher.lit_at(level->time - std::chrono::nanoseconds(1))->brightness.at(0, 0), 0);
  });
}

TEST(ScreenGrabber, DeadServerIsADarkProjector) {
  auto other = hw_sim::VirtualScreen::start(display_test::screen_settings());
  ASSERT_TRUE(other) << other.error().detail;
  Watcher watcher({.display = (*other)->display()});
  ASSERT_TRUE(watcher.wait_for_level(1));
  display_test::paint_screen_white((*other)->display());
  const auto light = watcher.wait_for_level(2);
  ASSERT_TRUE(light);
  EXPECT_EQ(light->level_adc, kLight_adc);
  (*other)->crash();
  const auto dark = watcher.wait_for_level(3);
  ASSERT_TRUE(dark);
  EXPECT_EQ(dark->level_adc, kDark_adc);
}

TEST(ScreenGrabber, MissingServerAndOutputAreErrors) {
  hw_sim::LightTimeline light;
  const auto start = [&light](const std::string& display, const std::string& output) {
    const auto grabber = hw_sim::ScreenGrabber::start(
        {.display = display, .output = output}, light, [](const auto&) {},
        [](rig::HostTime, int) {});
    return grabber ? std::string() : grabber.error().detail;
  };
  EXPECT_THAT(start(":5999", "DUMMY1"), testing::HasSubstr("no X server at :5999"));
  EXPECT_THAT(start(screen().display(), "HDMI-7"), testing::HasSubstr("HDMI-7"));
}

}  // namespace
