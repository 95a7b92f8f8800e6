// The production projector on a virtual screen.
#include "rig/devices/glfw_projector.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <optional>
#include <string>
#include <vector>

#include "tests/contract/projector_contract.h"
#include "tests/wire/display/display_fixture.h"
#include "tests/wire/display/screen_reader.h"

namespace {

using display_test::kHeight_px;
using display_test::kWidth_px;
using display_test::projector_settings;
using display_test::run_projector;
using display_test::screen;
using estimation::Image;
using rig::contract::wait_for_shown;
using testing::HasSubstr;

constexpr int kMonitorX_px = 1920;  // right of the operator's

struct WireFixture {
  static rig::ProjectorSettings settings() { return projector_settings(); }
  static void run(const std::function<void(rig::Projector&, rig::EventSource&)>& body) {
    run_projector(settings(), body);
  }
};

Image<unsigned char> make_picture(int (*level)(int row, int col)) {
  Image<unsigned char> picture(kHeight_px, kWidth_px);
  for (int row = 0; row < kHeight_px; ++row)
    for (int col = 0; col < kWidth_px; ++col)
      picture.at(row, col) = static_cast<unsigned char>(level(row, col));
  return picture;
}

// Asymmetric in both axes, every level, one-pixel detail.
std::vector<Image<unsigned char>> exacting_pictures() {
  return {make_picture([](int, int col) { return col % 2 == 0 ? 255 : 0; }),
          make_picture([](int row, int) { return row % 2 == 0 ? 255 : 0; }),
          make_picture([](int row, int col) { return (7 * row + 13 * col) % 256; })};
}

// Pixels of the monitor that are not `picture` with a square of `square_level` over it.
int count_wrong_pixels(const Image<unsigned char>& picture, const rig::SyncSquareSettings& square,
                       int square_level) {
  const Image<unsigned char> seen =
      display_test::read_screen(screen().display(), kMonitorX_px, 0, kWidth_px, kHeight_px);
  const bool is_right =
      square.corner == rig::Corner::kTopRight || square.corner == rig::Corner::kBottomRight;
  const bool is_bottom =
      square.corner == rig::Corner::kBottomLeft || square.corner == rig::Corner::kBottomRight;
  int wrong_count = 0;
  for (int row = 0; row < kHeight_px; ++row)
    for (int col = 0; col < kWidth_px; ++col) {
      const int from_side_px = is_right ? kWidth_px - 1 - col : col;
      const int from_edge_px = is_bottom ? kHeight_px - 1 - row : row;
      const bool is_square = from_side_px < square.size_px && from_edge_px < square.size_px;
      const int expected = is_square ? square_level : picture.at(row, col);
      for (int channel = 0; channel < 3; ++channel)
        wrong_count += seen.at(row, col, channel) != expected ? 1 : 0;
    }
  return wrong_count;
}

TEST(GlfwProjector, PixelsOnTheScreenAreThoseOfThePictures) {
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource& events) {
    const std::vector<Image<unsigned char>> pictures = exacting_pictures();
    ASSERT_TRUE(projector.load(pictures));
    for (int i = 0; i < 3; ++i) {
      const bool is_square_light = i % 2 == 0;
      ASSERT_TRUE(projector.show({.show_id = 1, .picture = i, .is_square_light = is_square_light}));
      ASSERT_TRUE(wait_for_shown(events));
      EXPECT_EQ(count_wrong_pixels(pictures[static_cast<std::size_t>(i)],
                                   projector_settings().sync_square, is_square_light ? 255 : 0),
                0);
    }
  });
}

class SquareIn : public testing::TestWithParam<rig::Corner> {};

TEST_P(SquareIn, ItsCornerAndInverted) {
  rig::ProjectorSettings settings = projector_settings();
  settings.sync_square = {.size_px = 19, .corner = GetParam(), .is_inverted = true};
  run_projector(settings, [&](rig::Projector& projector, rig::EventSource& events) {
    const Image<unsigned char> picture =
        make_picture([](int row, int col) { return (row + 3 * col) % 256; });
    ASSERT_TRUE(projector.load({picture}));
    for (const bool is_square_light : {true, false}) {
      ASSERT_TRUE(projector.show({.show_id = 1, .picture = 0, .is_square_light = is_square_light}));
      ASSERT_TRUE(wait_for_shown(events));
      EXPECT_EQ(count_wrong_pixels(picture, settings.sync_square, is_square_light ? 0 : 255), 0);
    }
  });
}

INSTANTIATE_TEST_SUITE_P(EachCorner, SquareIn,
                         testing::Values(rig::Corner::kTopLeft, rig::Corner::kTopRight,
                                         rig::Corner::kBottomLeft, rig::Corner::kBottomRight));

TEST(GlfwProjector, IsBlackBeforeTheFirstShowAndAfterALoad) {
  const Image<unsigned char> black(kHeight_px, kWidth_px);
  rig::ProjectorSettings settings = projector_settings();
  settings.sync_square.is_inverted = true;  // the square, too, stays black
  run_projector(settings, [&](rig::Projector& projector, rig::EventSource& events) {
    EXPECT_EQ(count_wrong_pixels(black, settings.sync_square, 0), 0);
    ASSERT_TRUE(projector.load(exacting_pictures()));
    ASSERT_TRUE(projector.show({.show_id = 1, .picture = 0}));
    ASSERT_TRUE(wait_for_shown(events));
    ASSERT_TRUE(projector.load(exacting_pictures()));
    const rig::HostTime deadline = events.now() + rig::contract::kEventPatience;
    while (count_wrong_pixels(black, settings.sync_square, 0) != 0 && events.now() < deadline)
      continue;
    EXPECT_EQ(count_wrong_pixels(black, settings.sync_square, 0), 0);
  });
}

// The next event, which must be a fault of the projector.
std::string wait_for_fault(rig::EventSource& events) {
  const std::optional<rig::Event> event =
      events.wait(events.now() + rig::contract::kEventPatience, {});
  if (!event) return "no event came";
  const auto* fault = std::get_if<rig::DeviceFault>(&*event);
  if (fault == nullptr) return "another event came";
  EXPECT_EQ(fault->device, rig::Device::kProjector);
  EXPECT_EQ(fault->error.fault, rig::Fault::kDisplayChanged);
  return fault->error.detail;
}

// Until it accepts requests again after a fault.
bool wait_until_ready(rig::Projector& projector, rig::EventSource& events) {
  const rig::HostTime deadline = events.now() + rig::contract::kEventPatience;
  while (events.now() < deadline)
    if (projector.load(exacting_pictures())) return true;
  return false;
}

TEST(GlfwProjector, UnpluggedMonitorIsAFaultAndPluggedInAgainItWorks) {
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource& events) {
    ASSERT_TRUE(projector.load(exacting_pictures()));
    ASSERT_TRUE(projector.show({.show_id = 1, .picture = 0}));
    ASSERT_TRUE(wait_for_shown(events));

    ASSERT_TRUE(screen().unplug_projector());
    EXPECT_THAT(wait_for_fault(events), HasSubstr("monitor DUMMY1 is gone"));
    const rig::Result<void> refused = projector.show({.show_id = 2, .picture = 0});
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().fault, rig::Fault::kDisplayChanged);

    ASSERT_TRUE(screen().plug_projector_in());
    ASSERT_TRUE(wait_until_ready(projector, events));
    ASSERT_TRUE(projector.show({.show_id = 3, .picture = 2, .is_square_light = true}));
    ASSERT_TRUE(wait_for_shown(events));
    EXPECT_EQ(count_wrong_pixels(exacting_pictures()[2], projector_settings().sync_square, 255), 0);
  });
}

TEST(GlfwProjector, ChangedGammaIsAFaultAndIsMadeIdentityAgain) {
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource& events) {
    ASSERT_TRUE(screen().set_projector_gamma(2.2));
    EXPECT_THAT(wait_for_fault(events), HasSubstr("gamma ramp of monitor DUMMY1"));
    ASSERT_TRUE(wait_until_ready(projector, events));
    EXPECT_NEAR(display_test::read_gamma(screen().display(), "DUMMY1", 128), 257 * 128, 256);
  });
}

TEST(GlfwProjector, ChangedModeIsAFaultUntilItIsRestored) {
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource& events) {
    ASSERT_TRUE(screen().halve_projector_rate());
    EXPECT_THAT(wait_for_fault(events),
                HasSubstr("mode of monitor DUMMY1 changed to 320 x 240 px at 30 Hz"));
    EXPECT_FALSE(projector.show({.show_id = 1}));
    ASSERT_TRUE(screen().restore_projector_rate());
    EXPECT_TRUE(wait_until_ready(projector, events));
  });
}

TEST(GlfwProjector, GammaIsIdentityWhileOpenAndRestoredAfterwards) {
  ASSERT_TRUE(screen().set_projector_gamma(2.2));
  const int before = display_test::read_gamma(screen().display(), "DUMMY1", 128);
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource&) {
    EXPECT_TRUE(projector.report().is_gamma_identity);
    EXPECT_NEAR(display_test::read_gamma(screen().display(), "DUMMY1", 128), 257 * 128, 256);
  });
  EXPECT_EQ(display_test::read_gamma(screen().display(), "DUMMY1", 128), before);
  ASSERT_TRUE(screen().set_projector_gamma(1));
}

TEST(GlfwProjector, AfterTheRunRequestsAreRefused) {
  rig::EventQueue events;
  auto projector = rig::GlfwProjector::open(projector_settings(), events);
  ASSERT_TRUE(projector) << projector.error().detail;
  std::stop_source stop;
  stop.request_stop();
  ASSERT_TRUE((*projector)->run(stop.get_token()));
  const rig::Result<void> shown = (*projector)->show({.show_id = 1});
  ASSERT_FALSE(shown);
  EXPECT_EQ(shown.error().fault, rig::Fault::kDisplayChanged);
}

TEST(GlfwProjector, MeasuresTheRefreshRate) {
  run_projector(projector_settings(), [](rig::Projector& projector, rig::EventSource&) {
    const rig::DisplayReport report = projector.report();
    EXPECT_DOUBLE_EQ(report.nominal_refresh_hz, 60);
    EXPECT_NEAR(report.measured_refresh_hz, 60, 6);
    EXPECT_TRUE(report.is_vsynced);
    EXPECT_THAT(report.text, HasSubstr("synchronised at"));
    EXPECT_THAT(report.text, testing::Not(HasSubstr("not synchronised")));
  });
}

rig::Error open_error(const rig::ProjectorSettings& settings) {
  rig::EventQueue events;
  const auto projector = rig::GlfwProjector::open(settings, events);
  EXPECT_FALSE(projector);
  return projector ? rig::Error{} : projector.error();
}

TEST(GlfwProjector, MissingMonitorIsNamedWithThoseThereAre) {
  rig::ProjectorSettings settings = projector_settings();
  settings.monitor = "HDMI-7";
  const rig::Error error = open_error(settings);
  EXPECT_EQ(error.fault, rig::Fault::kNotFound);
  EXPECT_THAT(error.detail, testing::AllOf(HasSubstr("HDMI-7"), HasSubstr("DUMMY0 (1920 x 1080)"),
                                           HasSubstr("DUMMY1 (320 x 240)")));
}

TEST(GlfwProjector, WrongSizeIsNamedWithBothSizes) {
  rig::ProjectorSettings settings = projector_settings();
  settings.width_px = 1024;
  settings.height_px = 768;
  const rig::Error error = open_error(settings);
  EXPECT_EQ(error.fault, rig::Fault::kConfiguration);
  EXPECT_THAT(error.detail, testing::AllOf(HasSubstr("1024 x 768"), HasSubstr("320 x 240")));
}

TEST(GlfwProjector, MissingXServerIsNamedWithTheRemedy) {
  const char* present = std::getenv("DISPLAY");
  ASSERT_NE(present, nullptr);
  const std::string display = present;
  unsetenv("DISPLAY");
  const rig::Error error = open_error(projector_settings());
  setenv("DISPLAY", display.c_str(), 1);
  EXPECT_EQ(error.fault, rig::Fault::kNotFound);
  EXPECT_THAT(error.detail, HasSubstr("set DISPLAY"));
}

}  // namespace

namespace rig::contract {
INSTANTIATE_TYPED_TEST_SUITE_P(Wire, ProjectorContract, WireFixture);
}
