// ssrig-sim as a user starts it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "hw_sim/display/child_process.h"
#include "tests/temporary_folder.h"

namespace {

constexpr auto kPatience = std::chrono::seconds(150);

// A folder for TMPDIR, so that what is left behind is seen.
class SsrigSim : public testing::Test {
 public:
  SsrigSim() { std::filesystem::create_directory(folder_ / "tmp"); }

 protected:
  // Exit code of `ssrig-sim run --rig small.toml ... -- command`.
  int run(const std::vector<std::string>& command, const std::vector<std::string>& options = {}) {
    std::vector<std::string> argv = {SSRIG_SIM,      "run",          "--rig",      SMALL_RIG,
                                     "--scene",      "flat_phantom", "--indirect", "off",
                                     "--scattering", "dipole"};
    argv.insert(argv.end(), options.begin(), options.end());
    argv.emplace_back("--");
    argv.insert(argv.end(), command.begin(), command.end());
    auto child =
        hw_sim::ChildProcess::start({.argv = argv,
                                     .environment = {{"TMPDIR", (folder_ / "tmp").string()},
                                                     {"XDG_CACHE_HOME", TRANSPORT_CACHE}},
                                     .output = folder_ / "output"});
    EXPECT_TRUE(child) << child.error().detail;
    if (!child) return -1;
    const std::optional<int> code = child->wait(rig::HostClock::now() + kPatience);
    EXPECT_TRUE(code) << "still running";
    return code.value_or(-1);
  }

  std::string output() const {
    std::ifstream file(folder_ / "output");
    return {std::istreambuf_iterator<char>(file), {}};
  }
  const std::filesystem::path& folder() const { return folder_; }

 private:
  const test_support::TemporaryFolder temporary_;
  const std::filesystem::path folder_ = temporary_.path();
};

TEST_F(SsrigSim, ProductionDriversSeeEveryPictureOverAllThreeWires) {
  EXPECT_EQ(run({RIG_PROBE, SMALL_RIG}), 0) << output();
  EXPECT_THAT(output(), testing::HasSubstr("20 pictures, 40 frames"));
  EXPECT_TRUE(std::filesystem::is_empty(folder() / "tmp")) << "left behind";
}

TEST_F(SsrigSim, EndsWithTheCodeOfItsCommand) {
  EXPECT_EQ(run({"sh", "-c", "exit 7"}), 7) << output();
}

TEST_F(SsrigSim, PassesTerminationOnAndCleansUp) {
  EXPECT_EQ(run({"sh", "-c", "trap 'exit 9' TERM; kill -TERM $PPID; while :; do sleep 0.1; done"}),
            9)
      << output();
  EXPECT_TRUE(std::filesystem::is_empty(folder() / "tmp")) << "left behind";
}

TEST_F(SsrigSim, WritesTheTruthBesideNewSessionsOnly) {
  const std::filesystem::path out = folder() / "sessions";
  std::filesystem::create_directories(out / "old");
  std::ofstream(out / "old" / "session.json") << "{}";
  EXPECT_EQ(run({"sh", "-c", "mkdir -p $2/new $2/other && echo {} > $2/new/session.json", "sh",
                 "--out", out.string()}),
            0)
      << output();
  EXPECT_TRUE(std::filesystem::exists(out / "new" / "truth" / "scene.exr")) << output();
  EXPECT_FALSE(std::filesystem::exists(out / "old" / "truth"));
  EXPECT_FALSE(std::filesystem::exists(out / "other" / "truth"));
}

TEST_F(SsrigSim, MissingCommandAndUnknownSceneAreUsageErrors) {
  EXPECT_EQ(run({"/nonexistent/command"}), 2);
  EXPECT_THAT(output(), testing::HasSubstr("cannot start /nonexistent/command"));
  EXPECT_EQ(run({"true"}, {"--scene", "teapot"}), 2);
}

TEST_F(SsrigSim, JudgeSaysWhatIsMissing) {
  auto child = hw_sim::ChildProcess::start(
      {.argv = {SSRIG_SIM, "judge", folder().string()}, .output = folder() / "output"});
  ASSERT_TRUE(child);
  EXPECT_EQ(child->wait(rig::HostClock::now() + kPatience), 1);
  EXPECT_THAT(output(), testing::HasSubstr((folder() / "maps").string()));
}

}  // namespace
