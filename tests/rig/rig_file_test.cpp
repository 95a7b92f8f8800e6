#include "rig/rig_file.h"

#include <gmock/gmock.h>

#include <filesystem>
#include <string>
#include <vector>

namespace rig {
namespace {

using testing::AllOf;
using testing::HasSubstr;

const std::filesystem::path kConfig = std::filesystem::path(SSRIG_SOURCE_DIR) / "config";

// A complete rig file; tests replace or add lines.
constexpr const char* kMinimal = R"(
[camera]
address = "10.0.0.2"
pixel_format = "Mono8"
width_px = 64
height_px = 48
black_level_dn = 4
saturation_level_dn = 250
[projector]
monitor = "HDMI-1"
width_px = 1024
height_px = 768
[sequence]
exposures_us = [1000]
)";

std::string with(const std::string& from, const std::string& to) {
  std::string text = kMinimal;
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

TEST(RigFile, EveryShippedFileIsValid) {
  for (const char* name : {"rig.example.toml", "simulated.toml", "simulated_full.toml"}) {
    const auto rig = read_rig_file(kConfig / name);
    ASSERT_TRUE(rig.has_value()) << rig.error().detail;
    EXPECT_EQ(rig->sequence.exposures.size(), 2u);
  }
}

TEST(RigFile, TheExampleShowsTheDefaults) {
  const auto example = read_rig_file(kConfig / "rig.example.toml");
  const auto minimal = parse_rig_file(kMinimal, "rig.toml");
  ASSERT_TRUE(example && minimal);
  EXPECT_EQ(example->trigger.gap, minimal->trigger.gap);
  EXPECT_EQ(example->trigger.debounce, minimal->trigger.debounce);
  EXPECT_EQ(example->trigger.threshold_high, minimal->trigger.threshold_high);
  EXPECT_EQ(example->trigger.threshold_low, minimal->trigger.threshold_low);
  EXPECT_EQ(example->trigger.vendor_id, minimal->trigger.vendor_id);
  EXPECT_EQ(example->projector.sync_square.size_px, minimal->projector.sync_square.size_px);
  EXPECT_EQ(example->sequence.edge_deadline, minimal->sequence.edge_deadline);
  EXPECT_EQ(example->sequence.frame_deadline, minimal->sequence.frame_deadline);
  EXPECT_EQ(example->sequence.retake_limit, minimal->sequence.retake_limit);
  EXPECT_EQ(example->sequence.reopen_deadline, minimal->sequence.reopen_deadline);
  EXPECT_EQ(example->camera.line_debounce, minimal->camera.line_debounce);
  EXPECT_EQ(example->daemon.port, minimal->daemon.port);
  EXPECT_EQ(example->storage.directory, minimal->storage.directory);
}

TEST(RigFile, WithoutATriggerBoxTheCameraIsTheTrigger) {
  const auto line = parse_rig_file(
      with("[sequence]", "[sequence]\nsync = \"camera_line\"\npace = \"paced\""), "rig.toml");
  ASSERT_TRUE(line.has_value()) << line.error().detail;
  EXPECT_EQ(line->sequence.sync, SyncMode::kCameraLine);
  EXPECT_EQ(line->sequence.pace, Pace::kPaced);
  EXPECT_EQ(line->camera.trigger_edge, TriggerEdge::kAny);
  EXPECT_EQ(line->camera.trigger_line, "Line1");
  const auto software =
      parse_rig_file(with("[sequence]", "[sequence]\nsync = \"software\""), "rig.toml");
  ASSERT_TRUE(software.has_value()) << software.error().detail;
  EXPECT_EQ(software->camera.trigger_line, kSoftwareTrigger);
}

TEST(RigFile, WhatNeedsATriggerBoxIsNamedWithItsRemedy) {
  std::string text = with("[sequence]",
                          "[trigger]\ngap_us = 1000\n[sequence]\nsync = \"software\"\n"
                          "pace = \"paced\"");
  text.insert(text.find("[projector]"),
              "bracketing = \"trigger_width\"\ntrigger_line = \"Line3\"\n");
  const auto rig = parse_rig_file(text, "rig.toml");
  ASSERT_FALSE(rig.has_value());
  EXPECT_THAT(
      rig.error().detail,
      AllOf(HasSubstr("trigger: a rig with sequence.sync = \"software\" has no trigger box; "
                      "delete the section [trigger]"),
            HasSubstr("camera.bracketing: \"trigger_width\" needs a trigger box"),
            HasSubstr("camera.trigger_line: sequence.sync = \"software\" uses no line; "
                      "delete the key"),
            HasSubstr("sequence.pace: \"paced\" needs a photodiode")));
}

TEST(RigFile, NamesAreRelativeToTheFile) {
  const auto rig = parse_rig_file(std::string(kMinimal) + "[calibration]\nfile = \"a.json\"\n",
                                  "some/where/rig.toml");
  ASSERT_TRUE(rig.has_value()) << rig.error().detail;
  EXPECT_EQ(rig->calibration_file, "some/where/a.json");
}

TEST(RigFile, UnknownKeyNamesFileLineAndNearestKey) {
  const auto rig = parse_rig_file(with("address =", "serial = \"1\"\nadress ="), "rig.toml");
  ASSERT_FALSE(rig.has_value());
  EXPECT_EQ(rig.error().fault, Fault::kConfiguration);
  EXPECT_THAT(
      rig.error().detail,
      HasSubstr("rig.toml:4: unknown key camera.adress; the nearest known key is camera.address"));
}

TEST(RigFile, UnknownSectionNamesTheNearestSection) {
  const auto rig = parse_rig_file(std::string(kMinimal) + "[storrage]\n", "rig.toml");
  ASSERT_FALSE(rig.has_value());
  EXPECT_THAT(rig.error().detail,
              HasSubstr("unknown key storrage; the nearest known key is storage"));
}

TEST(RigFile, EverythingWrongIsSaidAtOnce) {
  const auto rig = parse_rig_file(
      "[camera]\nwidth_px = \"wide\"\n[projector]\nsync_corner = \"middle\"\n", "rig.toml");
  ASSERT_FALSE(rig.has_value());
  EXPECT_THAT(rig.error().detail,
              AllOf(HasSubstr("rig.toml:2: camera.width_px: expected a whole number"),
                    HasSubstr("rig.toml:4: projector.sync_corner: expected one of \"top_left\""),
                    HasSubstr("missing key camera.address"),
                    HasSubstr("missing key sequence.exposures_us")));
}

TEST(RigFile, EachRequiredKeyIsMissed) {
  for (const std::string key :
       {"address", "pixel_format", "width_px", "height_px", "black_level_dn", "saturation_level_dn",
        "monitor", "exposures_us"}) {
    SCOPED_TRACE(key);
    std::string text = kMinimal;
    const auto start = text.find("\n" + key);
    text.erase(start, text.find('\n', start + 1) - start);
    const auto rig = parse_rig_file(text, "rig.toml");
    ASSERT_FALSE(rig.has_value());
    EXPECT_THAT(rig.error().detail, AllOf(HasSubstr("missing key"), HasSubstr(key)));
  }
}

TEST(RigFile, ANameThatWouldEndAtAZeroByteIsRefused) {
  const auto rig = parse_rig_file(with("HDMI-1", "HDMI-1\\u0000 other"), "rig.toml");
  ASSERT_FALSE(rig.has_value());
  EXPECT_THAT(rig.error().detail, HasSubstr("rig.toml:10: projector.monitor: expected text"));
}

TEST(RigFile, ValuesOutOfRangeAreRefused) {
  const std::vector<std::pair<std::string, std::string>> changes{
      {"width_px = 64", "width_px = 0"},
      {"width_px = 64", "width_px = 64.5"},
      {"width_px = 64", "width_px = true"},
      {"black_level_dn = 4", "black_level_dn = nan"},
      {"black_level_dn = 4", "black_level_dn = 255"},
      {"exposures_us = [1000]", "exposures_us = []"},
      {"exposures_us = [1000]", "exposures_us = [2000, 1000]"},
      {"exposures_us = [1000]", "exposures_us = [1000, 1000]"},
      {"exposures_us = [1000]", "exposures_us = [1000, \"long\"]"},
      {"exposures_us = [1000]", "exposures_us = 1000"},
      {"[sequence]", "[trigger]\nthreshold_low_adc = 700\n[sequence]"},
      {"[sequence]", "[trigger]\nvendor_id = 70000\n[sequence]"},
      {"[sequence]", "[daemon]\nport = 0\n[sequence]"},
      {"height_px = 768", "height_px = 768\nsync_square_px = 900"}};
  for (const auto& [from, to] : changes) {
    SCOPED_TRACE(to);
    const auto rig = parse_rig_file(with(from, to), "rig.toml");
    ASSERT_FALSE(rig.has_value());
    EXPECT_THAT(rig.error().detail, HasSubstr("rig.toml"));
  }
}

TEST(RigFile, BadTomlNamesTheLine) {
  const auto rig = parse_rig_file("name = \"x\"\nwidth = = 3\n", "rig.toml");
  ASSERT_FALSE(rig.has_value());
  EXPECT_THAT(rig.error().detail, HasSubstr("rig.toml:2: not TOML"));
}

TEST(RigFile, MissingFileSaysWhatToDo) {
  const auto rig = read_rig_file("/nowhere/rig.toml");
  ASSERT_FALSE(rig.has_value());
  EXPECT_THAT(rig.error().detail, AllOf(HasSubstr("/nowhere/rig.toml"), HasSubstr("--rig")));
}

}  // namespace
}  // namespace rig
