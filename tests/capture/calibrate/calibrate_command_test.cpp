// ssrig calibrate as the operator calls it: exit codes, what is written, what is kept.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <array>
#include <cstdio>
#include <fstream>

#include "estimation/calibration/calibration_file.h"
#include "tests/capture/calibrate/rendered_session.h"
#include "tests/temporary_folder.h"

namespace capture {
namespace {

using ::testing::HasSubstr;
namespace synthetic = estimation::testing;
namespace fs = std::filesystem;

struct Ran {
  int exit_code = -1;
  std::string text;  // both streams
};

Ran run(const std::string& arguments) {
  Ran ran;
  std::FILE* pipe = ::popen((std::string(SSRIG) + " " + arguments + " 2>&1").c_str(), "r");
  if (pipe == nullptr) return ran;
  std::array<char, 4096> part{};
  while (std::fgets(part.data(), part.size(), pipe) != nullptr) ran.text += part.data();
  ran.exit_code = WEXITSTATUS(::pclose(pipe));
  return ran;
}

class CalibrateCommand : public ::testing::Test {
 protected:
  CalibrateCommand() {
    std::ifstream example(RIG_FILE);
    std::string toml(std::istreambuf_iterator<char>(example), {});
    // Where no other test's camera is.
    const std::string address = "127.43.7.1";
    toml.replace(toml.find(address), address.size(), "127.43.107.1");
    std::ofstream(folder_ / "rig.toml") << toml;  // its calibration: small_calibration.json
  }
  std::string rig() const { return "--rig " + (folder_ / "rig.toml").string() + " "; }
  fs::path calibration() const { return folder_ / "small_calibration.json"; }

  const test_support::TemporaryFolder scratch_;
  const fs::path& folder_ = scratch_.path();
};

TEST_F(CalibrateCommand, WithoutSessionsTheRigIsOpened) {
  const auto text = estimation::format_calibration(
      "", synthetic::make_rig(196, 144, false).calibration,
      {estimation::CalibrationPart::kGeometry, R"({"date": "monday"})"});
  ASSERT_TRUE(text);
  ASSERT_TRUE(estimation::save_text(calibration(), *text));
  for (const char* part : {"radiometry ", "geometry --board checkerboard 8x10 18 "}) {
    const Ran ran = run(std::string("calibrate ") + part + rig() + " < /dev/null");
    EXPECT_EQ(ran.exit_code, 3) << ran.text;  // nothing answers here
    EXPECT_THAT(ran.text, HasSubstr("no camera answers"));
  }
}

TEST_F(CalibrateCommand, ABoardThatIsNoneIsAMistakeOfUsage) {
  const Ran ran = run("calibrate geometry " + rig() + "--board checkerboard 8by10 18 --sessions x");
  EXPECT_EQ(ran.exit_code, 2) << ran.text;
  EXPECT_THAT(ran.text, HasSubstr("ROWSxCOLS"));
}

TEST_F(CalibrateCommand, SessionsWithoutTheBoardLeaveTheCalibrationAsItWas) {
  std::ofstream(calibration()) << "{\"old\": true}";
  const Ran ran = run("calibrate geometry " + rig() + "--board checkerboard 8x10 18 --sessions " +
                      (folder_ / "none").string());
  EXPECT_EQ(ran.exit_code, 1) << ran.text;
  EXPECT_THAT(ran.text, HasSubstr("left out"));
  EXPECT_THAT(ran.text, HasSubstr("no session shows the board"));
  std::ifstream file(calibration());
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(file), {}), "{\"old\": true}");
}

TEST_F(CalibrateCommand, RadiometryWantsAGeometryFirst) {
  const Ran ran = run("calibrate radiometry " + rig() + "--standard " + folder_.string());
  EXPECT_EQ(ran.exit_code, 2) << ran.text;
  EXPECT_THAT(ran.text, HasSubstr("calibrate the geometry first"));
}

TEST_F(CalibrateCommand, AChartGivesTheColourMatrixAndKeepsTheOlderFile) {
  const auto text = estimation::format_calibration(
      "", synthetic::make_rig(196, 144, false).calibration,
      {estimation::CalibrationPart::kGeometry, R"({"date": "monday"})"});
  ASSERT_TRUE(text);
  ASSERT_TRUE(estimation::save_text(calibration(), *text));
  std::ofstream(folder_ / "chart.json")
      << R"([{"camera": [0.4, 0.1, 0.1], "display": [0.5, 0.05, 0.05]},
             {"camera": [0.1, 0.4, 0.1], "display": [0.05, 0.5, 0.05]},
             {"camera": [0.1, 0.1, 0.4], "display": [0.05, 0.05, 0.5]},
             {"camera": [0.5, 0.5, 0.5], "display": [0.5, 0.5, 0.5]}])";
  const Ran ran =
      run("calibrate radiometry " + rig() + "--chart " + (folder_ / "chart.json").string());
  EXPECT_EQ(ran.exit_code, 0) << ran.text;
  EXPECT_THAT(ran.text, HasSubstr("the older calibration is kept as"));
  std::ifstream file(calibration());
  const std::string now(std::istreambuf_iterator<char>(file), {});
  const auto read = estimation::parse_calibration(now, "file");
  ASSERT_TRUE(read) << read.error().text();
  ASSERT_TRUE(read->color_matrix);
  EXPECT_THAT(now, HasSubstr("monday"));
}

}  // namespace
}  // namespace capture
