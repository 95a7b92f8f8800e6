// ssrig as its user meets it: a good capture over all the wires, and each way that one goes wrong:
// a sentence that says what, where and what to do, the exit code of the README, and a folder whose
// state is the truth.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <regex>
#include <string>
#include <thread>
#include <vector>

#include "hw_sim/display/child_process.h"
#include "tests/temporary_folder.h"

namespace {

namespace fs = std::filesystem;
using Command = std::vector<std::string>;
using testing::AllOf;
using testing::HasSubstr;

constexpr auto kPatience = std::chrono::seconds(150);
constexpr auto kPollPeriod = std::chrono::milliseconds(5);
constexpr int kSlotCount = 176;  // 88 patterns of two exposures
constexpr int kDone = 0, kUsage = 2, kDevice = 3, kIncomplete = 4, kStorage = 5, kAborted = 130;

std::string read_text(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// small.toml at an address and a port of this program's own.
std::string small_rig() {
  const auto replaced = [](const std::string& text, const char* what, const std::string& with) {
    return std::regex_replace(text, std::regex(what), with);
  };
  std::string toml = read_text(SMALL_RIG);
  toml = replaced(toml, "127.43.7.1", "127.43.9.1");
  toml = replaced(toml, "small_calibration.json",
                  (fs::path(SMALL_RIG).parent_path() / "small_calibration.json").string());
  return toml + "\n[daemon]\nport = 8649\n";
}

// How many processes have `word` on their command line.
int process_count_of(const std::string& word) {
  int count = 0;
  std::error_code gone;
  for (const auto& entry : fs::directory_iterator("/proc", gone))
    if (read_text(entry.path() / "cmdline").find(word) != std::string::npos) ++count;
  return count;
}

class Failures : public testing::Test {
 public:
  Failures() {
    fs::create_directory(folder_ / "tmp");
    std::ofstream(folder_ / "sim.toml") << small_rig();
    std::ofstream(folder_ / "rig.toml") << small_rig();
  }

 protected:
  // What ssrig's rig file says instead of what the virtual rig's says: {pattern, replacement}.
  void change_rig(const std::vector<std::pair<std::string, std::string>>& changes) {
    std::string toml = read_text(rig());
    for (const auto& [pattern, replacement] : changes) {
      ASSERT_TRUE(std::regex_search(toml, std::regex(pattern))) << pattern;
      toml = std::regex_replace(toml, std::regex(pattern), replacement,
                                std::regex_constants::format_first_only);
    }
    std::ofstream(rig()) << toml;
  }

  fs::path rig() const { return folder_ / "rig.toml"; }
  fs::path out() const { return folder_ / "out"; }
  fs::path folder() const { return folder_; }
  Command capture() const { return {SSRIG, "capture", "--rig", rig(), "--out", out()}; }

  // Both started programs write to output().
  hw_sim::ChildProcess start(const Command& command,
                             std::map<std::string, std::string> environment = {}) {
    environment["TMPDIR"] = folder_ / "tmp";
    environment["XDG_CACHE_HOME"] = TRANSPORT_CACHE;
    auto child = hw_sim::ChildProcess::start(
        {.argv = command, .environment = environment, .output = folder_ / "output"});
    EXPECT_TRUE(child) << child.error().detail;
    return std::move(*child);
  }
  hw_sim::ChildProcess start_on_rig(const Command& command) {
    Command argv = {SSRIG_SIM,      "run",          "--rig",      folder_ / "sim.toml",
                    "--scene",      "flat_phantom", "--indirect", "off",
                    "--scattering", "dipole",       "--"};
    argv.insert(argv.end(), command.begin(), command.end());
    return start(argv);
  }
  // Exit codes.
  int ended(hw_sim::ChildProcess& child) {
    const auto code = child.wait(rig::HostClock::now() + kPatience);
    EXPECT_TRUE(code) << "still running: " << output();
    return code.value_or(-1);
  }
  int run(const Command& command) {
    auto child = start(command, {{"DISPLAY", ""}});
    return ended(child);
  }
  int run_on_rig(const Command& command) {
    auto child = start_on_rig(command);
    return ended(child);
  }

  std::string output() const { return read_text(folder_ / "output"); }
  std::vector<fs::path> sessions() const {
    std::vector<fs::path> found;
    std::error_code none;
    for (const auto& entry : fs::directory_iterator(out(), none)) found.push_back(entry.path());
    return found;
  }
  fs::path only_session() const {
    const auto found = sessions();
    EXPECT_EQ(found.size(), 1U) << output();
    return found.empty() ? folder_ : found.front();
  }
  nlohmann::json manifest() const {
    return nlohmann::json::parse(read_text(only_session() / "session.json"), nullptr, false);
  }
  // Files of whole frames; a file being written has another name.
  int frame_count() const {
    int count = 0;
    std::error_code none;
    for (const auto& session : sessions())
      for (const auto& entry : fs::directory_iterator(session / "frames", none))
        count += entry.path().extension() == ".tiff" ? 1 : 0;
    return count;
  }
  std::map<std::string, std::string> frame_bytes() const {
    std::map<std::string, std::string> files;
    for (const auto& entry : fs::directory_iterator(only_session() / "frames"))
      if (entry.path().extension() == ".tiff")
        files[entry.path().filename()] = read_text(entry.path());
    return files;
  }
  void wait_until(const std::function<bool()>& is_so) {
    const auto deadline = rig::HostClock::now() + kPatience;
    while (!is_so() && rig::HostClock::now() < deadline) std::this_thread::sleep_for(kPollPeriod);
    ASSERT_TRUE(is_so()) << output();
  }
  // A capture that is sent `signal`, through ssrig-sim, when it has some frames.
  int run_interrupted(int signal) {
    auto child = start_on_rig(capture());
    wait_until([this] { return frame_count() >= 10; });
    child.send(signal);
    return ended(child);
  }
  // Everything in the session is whole, and it says itself how it ended.
  void expect_whole(const std::string& state) {
    EXPECT_EQ(manifest()["state"], state) << output();
    EXPECT_EQ(static_cast<int>(manifest()["frames"].size()), frame_count());
    for (const auto& entry : fs::recursive_directory_iterator(only_session()))
      EXPECT_NE(entry.path().extension(), ".tmp") << entry.path();
    const std::string journal = read_text(only_session() / "journal.jsonl");
    EXPECT_TRUE(journal.ends_with("\n"));
    EXPECT_EQ(run({SSRIG, "verify", only_session()}), state == "complete" ? kDone : kIncomplete)
        << output();
  }
  void expect_nothing_made() const { EXPECT_TRUE(sessions().empty()) << output(); }

 private:
  const test_support::TemporaryFolder temporary_;
  const fs::path folder_ = temporary_.path();
};

// ---- What goes right ----

TEST_F(Failures, NoneInAGoodCaptureWhichASecondOneCannotDisturb) {
  auto first = start_on_rig({"sh", "-c",
                             R"(ssrig=$1 rig=$2 out=$3
                                "$ssrig" capture --rig "$rig" --out "$out" & first=$!
                                until ls "$out"/*/frames/pattern_020* 2>/dev/null; do sleep 0.05; done
                                "$ssrig" capture --rig "$rig" --out "$out"; echo "second: $?"
                                wait $first)",
                             "sh", SSRIG, rig(), out()});
  EXPECT_EQ(ended(first), kDone) << output();
  EXPECT_THAT(output(),
              AllOf(HasSubstr("second: 3"), HasSubstr("controls the camera at 127.43.9.1"),
                    HasSubstr("176 of 176 slots filled")));
  EXPECT_EQ(frame_count(), kSlotCount);
  expect_whole("complete");

  const fs::path again = folder() / "again";
  EXPECT_EQ(run({SSRIG, "estimate", only_session(), "--out", again}), kDone) << output();
  int map_count = 0;
  for (const auto& entry : fs::directory_iterator(only_session() / "maps")) {
    EXPECT_EQ(read_text(entry.path()), read_text(again / entry.path().filename())) << entry.path();
    ++map_count;
  }
  EXPECT_GE(map_count, 9);  // those of the session format
}

// ---- Before a device is needed ----

TEST_F(Failures, HelpAndUsage) {
  EXPECT_EQ(run({SSRIG, "--help"}), kDone);
  EXPECT_EQ(run({SSRIG, "--version"}), kDone);
  EXPECT_EQ(run({SSRIG}), kUsage);
  EXPECT_THAT(output(), HasSubstr("name a command: "));
  EXPECT_EQ(run({SSRIG, "shoot"}), kUsage);
  EXPECT_THAT(output(), HasSubstr("not expected: shoot"));
}

TEST_F(Failures, WrongRigFileIsNamedWithItsLine) {
  change_rig({{"height_px = 144", "heigth_px = \"144\""}});
  EXPECT_EQ(run(capture()), kUsage);
  EXPECT_THAT(output(), HasSubstr(rig().string() + ":9: unknown key camera.heigth_px; the nearest "
                                                   "known key is camera.height_px"));
  change_rig({{"heigth_px", "height_px"}});
  EXPECT_EQ(run(capture()), kUsage);
  EXPECT_THAT(output(), HasSubstr(":9: camera.height_px: expected a whole number"));
  EXPECT_EQ(run({SSRIG, "capture", "--rig", folder()}), kUsage);
  EXPECT_THAT(output(),
              HasSubstr(folder().string() +
                        ": cannot be read, for it is no regular file; name an existing rig file"));
  expect_nothing_made();
}

TEST_F(Failures, WrongCalibrationIsNamed) {
  change_rig({{"file = \".*\"", "file = \"calibration.json\""}});
  EXPECT_EQ(run(capture()), kUsage);
  EXPECT_THAT(output(),
              AllOf(HasSubstr("calibration.json: the calibration cannot be read"),
                    HasSubstr("No such file"), HasSubstr("; correct [calibration] file")));
  std::ofstream(folder() / "calibration.json") << "{ \"camera\": ";
  EXPECT_EQ(run(capture()), kUsage);
  EXPECT_THAT(output(), HasSubstr("calibration.json: line 1, column 1"));
  change_rig({{"calibration.json", "."}});
  EXPECT_EQ(run(capture()), kUsage);
  expect_nothing_made();
}

TEST_F(Failures, UnwritableFolderIsStorage) {
  std::ofstream(out()) << "kept";
  EXPECT_EQ(run(capture()), kStorage);
  EXPECT_THAT(output(), HasSubstr(out().string() + ": the folder cannot be made"));
  EXPECT_EQ(read_text(out()), "kept");
  EXPECT_EQ(run({SSRIG, "capture", "--rig", rig(), "--out", "/proc/sessions"}), kStorage);
  // A folder whose file system has no room at all.
  EXPECT_EQ(run({SSRIG, "capture", "--rig", rig(), "--out", "/proc"}), kStorage);
  EXPECT_THAT(output(), HasSubstr("choose another"));
}

// ---- Devices ----

TEST_F(Failures, EverythingThatIsMissingIsSaidAtOnce) {
  EXPECT_EQ(run(capture()), kDevice);  // without ssrig-sim
  EXPECT_THAT(output(), AllOf(HasSubstr("camera: no camera answers at 127.43.9.1; check its cable"),
                              HasSubstr("trigger box: no trigger box 1209:0001 on USB: check its"),
                              HasSubstr("projector: the X server cannot be reached")));
  expect_nothing_made();
}

TEST_F(Failures, OtherDevicesThanTheRigFileSays) {
  change_rig({{"SIM-196", "SIM-999"}, {"SIM0007", "SIM0008"}, {"DUMMY1", "HDMI-7"}});
  EXPECT_EQ(run_on_rig(capture()), kDevice);
  EXPECT_THAT(output(),
              AllOf(HasSubstr("has serial number SIM-196, the rig file asks for SIM-999; correct"),
                    HasSubstr("no trigger box with serial SIM0008 on USB, but SIM0007: plug in"),
                    HasSubstr("no monitor is named \"HDMI-7\"; there are: DUMMY0 (1920 x 1080), "
                              "DUMMY1 (1024 x 768); correct")));
  expect_nothing_made();
}

TEST_F(Failures, SettingsThatTheDevicesDoNotHave) {
  change_rig({{"BayerRG12", "BayerGB12"}, {"width_px = 1024", "width_px = 1280"}});
  EXPECT_EQ(run_on_rig(capture()), kDevice);
  EXPECT_THAT(output(),
              AllOf(HasSubstr("has no pixel format BayerGB12 but BayerRG12; correct "
                              "camera.pixel_format"),
                    HasSubstr("monitor DUMMY1 shows 1024 x 768 px, the rig file says 1280 x 768")));
  change_rig({{"BayerGB12", "BayerRG12"}, {"width_px = 196", "width_px = 9000"}});
  EXPECT_EQ(run_on_rig(capture()), kDevice);
  EXPECT_THAT(output(), HasSubstr("takes Width from 1 to 196 px here, not 9000; correct "
                                  "camera.width_px in the rig file"));
  expect_nothing_made();
}

TEST_F(Failures, ExposureThatTheCameraCannotDo) {
  change_rig({{"exposures_us = \\[8333", "exposures_us = [5"}});
  EXPECT_EQ(run_on_rig(capture()), kDevice);
  EXPECT_THAT(output(), HasSubstr("exposes for 10 to 10000000 us, not for 5 us; correct "
                                  "sequence.exposures_us in the rig file"));
  EXPECT_EQ(manifest()["failure"]["code"], "device refused");
  expect_whole("failed");
}

TEST_F(Failures, GapShorterThanTheCamerasReadout) {
  change_rig({{"\"SIM0007\"", "\"SIM0007\"\ngap_us = 100"},
              {"frame_deadline_ms = 10000", "frame_deadline_ms = 1500"}});
  EXPECT_EQ(run_on_rig(capture()), kIncomplete);
  EXPECT_THAT(output(), HasSubstr("lengthen trigger.gap_us beyond its readout"));
  expect_whole("failed");
}

// ---- In the middle ----

TEST_F(Failures, InterruptKeepsTheFramesSoFar) {
  EXPECT_EQ(run_interrupted(SIGINT), kAborted);
  EXPECT_THAT(output(), HasSubstr("aborted; the frames so far are kept"));
  expect_whole("aborted");
  EXPECT_FALSE(fs::exists(only_session() / "maps"));
}

TEST_F(Failures, TheEndOfTheTerminalIsAnInterrupt) {
  EXPECT_EQ(run_interrupted(SIGHUP), kAborted);
  expect_whole("aborted");
  EXPECT_TRUE(fs::is_empty(folder() / "tmp")) << "left behind";
}

// A limit on a file's size is the disk that fills up: the journal meets it after some frames.
TEST_F(Failures, FullDiskKeepsTheFramesSoFar) {
  Command limited = {"prlimit", "--fsize=62000"};
  for (const std::string& word : capture()) limited.push_back(word);
  EXPECT_EQ(run_on_rig(limited), kStorage);
  EXPECT_THAT(output(), HasSubstr("journal.jsonl: File too large"));
  EXPECT_GT(frame_count(), 10);
  EXPECT_EQ(manifest()["failure"]["code"], "storage");
  expect_whole("failed");
}

TEST_F(Failures, KilledProgramLeavesWholeFramesWhichTheNextStartNamesAndResumingFinishes) {
  auto child = start_on_rig({"sh", "-c", "\"$@\" & echo $! > \"$0\"; wait $!", folder() / "pid",
                             SSRIG, "capture", "--rig", rig(), "--out", out()});
  wait_until([this] { return frame_count() >= kSlotCount / 2; });
  kill(std::stoi(read_text(folder() / "pid")), SIGKILL);
  EXPECT_EQ(ended(child), 128 + SIGKILL);
  EXPECT_EQ(manifest()["state"], "capturing");
  EXPECT_TRUE(fs::is_empty(folder() / "tmp")) << "left behind";
  const auto frames = frame_bytes();
  EXPECT_LT(frames.size(), static_cast<std::size_t>(kSlotCount));
  EXPECT_EQ(run({SSRIG, "verify", only_session()}), kIncomplete) << output();

  EXPECT_EQ(run(capture()), kDevice) << "there is no rig";
  EXPECT_THAT(output(),
              AllOf(HasSubstr(only_session().string() + " was interrupted: "),
                    HasSubstr(" of " + std::to_string(kSlotCount) + " slots are good on the disk"),
                    HasSubstr("--resume " + only_session().string())));

  EXPECT_EQ(run_on_rig({SSRIG, "capture", "--rig", rig(), "--resume", only_session()}), kDone)
      << output();
  expect_whole("complete");
  const auto finished = frame_bytes();
  EXPECT_EQ(finished.size(), static_cast<std::size_t>(kSlotCount));
  for (const auto& [name, bytes] : frames)
    EXPECT_TRUE(finished.at(name) == bytes) << name << " was taken or written again";
}

TEST_F(Failures, KilledRigTakesEverythingWithIt) {
  auto child = start_on_rig(capture());
  wait_until([this] { return frame_count() >= 10; });
  EXPECT_FALSE(fs::is_empty(folder() / "tmp"));
  child.send(SIGKILL);
  EXPECT_EQ(ended(child), 128 + SIGKILL);
  wait_until([this] { return fs::is_empty(folder() / "tmp"); });
  wait_until([this] { return process_count_of(folder().string()) == 0; });  // ssrig, Xorg
}

// ---- The daemon ----

TEST_F(Failures, DaemonEndsWithZeroOnSigterm) {
  auto child = start_on_rig({SSRIG, "serve", "--rig", rig()});
  wait_until([this] { return output().find("open http://127.0.0.1:8649") != std::string::npos; });
  child.send(SIGTERM);
  EXPECT_EQ(ended(child), kDone) << output();
  EXPECT_TRUE(fs::is_empty(folder() / "tmp")) << "left behind";
}

TEST_F(Failures, DaemonNamesATakenPort) {
  const int taken = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  ASSERT_EQ(bind(taken, reinterpret_cast<sockaddr*>(&address), size), 0);
  ASSERT_EQ(listen(taken, 1), 0);
  getsockname(taken, reinterpret_cast<sockaddr*>(&address), &size);
  const std::string port = std::to_string(ntohs(address.sin_port));
  EXPECT_EQ(run_on_rig({SSRIG, "serve", "--rig", rig(), "--port", port}), kUsage);
  EXPECT_THAT(output(), HasSubstr("port " + port + " on 127.0.0.1 is taken"));
  close(taken);
}

}  // namespace
