// ssrig calibrate live, over all the wires of ssrig-sim: a window, GigE packets, a USB device.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <regex>
#include <string>

#include "tests/temporary_folder.h"

namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

std::string text_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

class CalibrateLive : public ::testing::Test {
 protected:
  CalibrateLive() {
    // The virtual rig at an address of this program's own, with one short exposure; ssrig has not
    // been told its calibration.
    std::string toml = text_of(fs::path(CONFIG) / "simulated.toml");
    const auto replace = [&toml](const char* what, const std::string& with) {
      ASSERT_TRUE(std::regex_search(toml, std::regex(what))) << what;
      toml = std::regex_replace(toml, std::regex(what), with);
    };
    replace("127\\.43\\.0\\.1", "127.43.24.1");
    replace("SIM0001", "SIM0024");
    replace("exposures_us = \\[[^\\]]*\\]", "exposures_us = [16667]");
    toml += "\n[storage]\ndirectory = \"" + (folder_ / "sessions").string() + "\"\n";
    toml += "[daemon]\nport = 8664\n";
    std::ofstream(folder_ / "rig.toml")
        << std::regex_replace(toml, std::regex("simulated_calibration.json"), "calibration.json");
    replace("simulated_calibration.json",
            (fs::path(CONFIG) / "simulated_calibration.json").string());
    std::ofstream(folder_ / "sim.toml") << toml;
    std::ofstream(folder_ / "effects.toml") << "[projector]\nblur_px = 0.8\n";
  }

  // What the operator types, and to which command; both streams come back.
  std::string run(const std::string& typed, const std::string& command, int& exit_code) {
    const std::string line = "printf '" + typed + "' | " + SSRIG_SIM + " run --rig " +
                             (folder_ / "sim.toml").string() + " --scene board --effects " +
                             (folder_ / "effects.toml").string() + " -- " + SSRIG + " calibrate " +
                             command + " --rig " + (folder_ / "rig.toml").string() + " 2>&1";
    std::string text;
    std::FILE* pipe = ::popen(line.c_str(), "r");
    if (pipe == nullptr) return text;
    std::array<char, 4096> part{};
    while (std::fgets(part.data(), part.size(), pipe) != nullptr) text += part.data();
    exit_code = WEXITSTATUS(::pclose(pipe));
    return text;
  }

  const test_support::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
};

TEST_F(CalibrateLive, ThreePosesOfABoardAreCapturedFittedAndFoundTooFew) {
  int exit_code = -1;
  const std::string text =
      run("\\n\\n\\nq\\n", "geometry --board checkerboard 10x13 15", exit_code);
  EXPECT_EQ(exit_code, 1) << text;
  EXPECT_THAT(text, HasSubstr("pose 1: hold the board facing the camera"));
  EXPECT_THAT(text, HasSubstr("not a calibration: 3 poses are too few"));
  std::smatch found;
  ASSERT_TRUE(std::regex_search(
      text, found, std::regex("poses: 3, camera ([0-9.]+) px rms, projector ([0-9.]+) px rms")))
      << text;
  EXPECT_LT(std::stod(found[1]), 0.02);
  EXPECT_LT(std::stod(found[2]), 0.03);
  EXPECT_TRUE(std::regex_search(text, std::regex("calibration-pose +108 +108 "))) << text;
  EXPECT_FALSE(fs::exists(folder_ / "calibration.json"));  // nothing is called calibrated
  ASSERT_TRUE(std::regex_search(text, found, std::regex("report: (.+)\n")));
  const std::string page = text_of(fs::path(found[1].str()) / "report.html");
  EXPECT_THAT(page, HasSubstr("pose_errors.png"));
  EXPECT_THAT(page, HasSubstr("too few"));
}

}  // namespace
