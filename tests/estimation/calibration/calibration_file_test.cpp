#include "estimation/calibration/calibration_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

#include "tests/estimation/geometry/synthetic_rig.h"
#include "tests/temporary_folder.h"

namespace estimation {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

std::string contents(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

Calibration geometry() { return testing::make_rig(2352, 1726, true).calibration; }

Calibration radiometry() {
  Calibration calibration = geometry();
  calibration.irradiance = {.signal_per_us = {0.2, 0.19, 0.17},
                            .reference_distance_mm = 1030,
                            .vignetting_file = "vignetting.exr"};
  calibration.projector_black_dn_per_us = {1e-4, 1e-4, 1e-4};
  return calibration;
}

TEST(CalibrationFile, IsReadBackByTheSessionFormatToTheLastBit) {
  const auto text = format_calibration(
      "", geometry(), {CalibrationPart::kGeometry, R"({"date": "today", "camera_rms_px": 0.1})"});
  ASSERT_TRUE(text);
  const auto read = parse_calibration(*text, "file");
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(read->camera.K, geometry().camera.K);
  EXPECT_EQ(read->projector.distortion, geometry().projector.distortion);
  EXPECT_EQ(read->projector_from_camera, geometry().projector_from_camera);
  EXPECT_EQ(read->projector_from_camera_mm, geometry().projector_from_camera_mm);
  EXPECT_FALSE(read->irradiance);
}

// Found by tests/fuzz.
TEST(CalibrationFile, AnOlderFileWhoseRecordsAreNoObjectIsRefused) {
  const auto text = format_calibration(R"({"calibrated": 5})", geometry(),
                                       {CalibrationPart::kGeometry, R"({"date": "monday"})"});
  ASSERT_FALSE(text);
  EXPECT_THAT(text.error().text(), HasSubstr("/calibrated"));
}

TEST(CalibrationFile, ValuesNestedBeyondAllMeasureAreNoCalibration) {
  const std::string deep = R"({"x": )" + std::string(100000, '[') + std::string(100000, ']') + "}";
  EXPECT_THAT(extra_calibration_keys(deep), IsEmpty());
  EXPECT_FALSE(
      format_calibration(deep, geometry(), {CalibrationPart::kGeometry, R"({"date": "monday"})"}));
}

TEST(CalibrationFile, OnePartLeavesTheOtherAndForeignKeysAlone) {
  const auto first = format_calibration(R"({"lens": "80 mm"})", geometry(),
                                        {CalibrationPart::kGeometry, R"({"date": "monday"})"});
  ASSERT_TRUE(first);
  Calibration elsewhere = radiometry();
  elsewhere.camera.K(0, 0) = 1;  // is not this part's to change
  const auto second = format_calibration(*first, elsewhere,
                                         {CalibrationPart::kRadiometry, R"({"date": "tuesday"})"});
  ASSERT_TRUE(second);
  const auto read = parse_calibration(*second, "file");
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(read->camera.K, geometry().camera.K);
  EXPECT_EQ(read->irradiance->signal_per_us, radiometry().irradiance->signal_per_us);
  const auto json = nlohmann::json::parse(*second);
  EXPECT_EQ(json["lens"], "80 mm");
  EXPECT_EQ(json["calibrated"]["geometry"]["date"], "monday");
  EXPECT_EQ(json["calibrated"]["radiometry"]["date"], "tuesday");
}

TEST(CalibrationFile, AnOlderOneIsKeptUnderItsDate) {
  const test_support::TemporaryFolder folder;
  const auto path = folder.path() / "new" / "calibration.json";  // whose folder is made
  ASSERT_TRUE(write_calibration(path, "{\"a\": 1}\n"));
  const auto second = write_calibration(path, "{\"a\": 2}\n");
  const auto third = write_calibration(path, "{\"a\": 3}\n");
  ASSERT_TRUE(second && third);
  EXPECT_EQ(contents(path), "{\"a\": 3}\n");
  EXPECT_EQ(contents(*second), "{\"a\": 1}\n");
  EXPECT_EQ(contents(*third), "{\"a\": 2}\n");
  EXPECT_THAT(second->filename().string(), HasSubstr("calibration.20"));
}

TEST(CalibrationFile, WhatCannotBeWrittenLeavesTheOldOne) {
  const test_support::TemporaryFolder folder;
  std::ofstream(folder.path() / "file") << "in the way";
  const auto written = write_calibration(folder.path() / "file" / "calibration.json", "{}");
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().fault, InputFault::kUnwritable);
}

TEST(CalibrationFile, ASessionCarriesTheRecordsAlong) {
  const auto text =
      format_calibration("", geometry(), {CalibrationPart::kGeometry, R"({"date": "monday"})"});
  const std::string extra = extra_calibration_keys(*text);
  EXPECT_THAT(extra, HasSubstr("monday"));
  EXPECT_THAT(extra, Not(HasSubstr("distortion")));
  Manifest manifest;
  manifest.calibration = geometry();
  manifest.other_keys = extra;
  const auto json = nlohmann::json::parse(format_manifest(manifest));
  EXPECT_EQ(json["calibration"]["calibrated"]["geometry"]["date"], "monday");
  EXPECT_THAT(extra_calibration_keys("{}"), IsEmpty());
  EXPECT_THAT(extra_calibration_keys("no json"), IsEmpty());
}

}  // namespace
}  // namespace estimation
