// A capture's process is killed at random moments (SIGKILL: nothing of ours runs any more). What
// lies on the disk under its final name is whole, earlier sessions are as they were, and the take
// is listed and can be finished. The process is this program started anew with --capture FOLDER: a
// fork of the test's would lack the threads that OpenEXR has started in it.
// SSRIG_KILLS says how often; a few in the default run, 200 in the soak.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <random>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "capture/capture_job.h"
#include "capture/interrupted_takes.h"
#include "capture/stored_take.h"
#include "estimation/session/frame_io.h"
#include "estimation/session/maps.h"
#include "estimation/session/verify.h"
#include "tests/capture/folder_files.h"
#include "tests/capture/striped_world.h"
#include "tests/temporary_folder.h"

namespace capture {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

int kill_count() {
  const char* asked = std::getenv("SSRIG_KILLS");
  return asked == nullptr ? 8 : std::atoi(asked);
}

// By its name: of a single file, or of the folder that maps are written to first.
bool is_temporary(const std::string& name) {
  return name.ends_with(".tmp") || name.find("being_written") != std::string::npos;
}

// What of a killed take is not whole although its name says so; each a line.
std::vector<std::string> incomplete_files(const fs::path& session) {
  std::vector<std::string> lines;
  const auto manifest = estimation::read_manifest(session);
  for (const auto& [name, bytes] : files_of(session)) {
    if (is_temporary(name)) continue;
    if (name == "session.json") {
      if (!manifest) lines.push_back(manifest.error().text());
    } else if (name == "journal.jsonl") {
      if (!bytes.empty() && bytes.back() != '\n') lines.push_back(name + " ends within a line");
      std::istringstream journal(bytes);
      for (std::string line; std::getline(journal, line);)
        if (!nlohmann::json::accept(line))
          lines.push_back(std::string(name).append(" holds ").append(line));
    } else if (name.ends_with(".tiff")) {
      if (!manifest || !estimation::read_frame(session, *manifest, name))
        lines.push_back(name + " is no whole frame");
    } else if (name.ends_with(".exr")) {
      const auto image = estimation::read_exr(session / name);
      if (!image) lines.push_back(image.error().text());
    } else if (name.ends_with(".png")) {
      const bool is_whole = bytes.size() > 12 && bytes.substr(bytes.size() - 8, 4) == "IEND";
      if (!is_whole) lines.push_back(name + " has no end");
    } else if (name.ends_with(".json")) {
      if (!nlohmann::json::accept(bytes)) lines.push_back(name + " is no JSON");
    } else if (!name.ends_with(".ply") && !name.ends_with(".html") && !name.ends_with(".csv")) {
      lines.push_back(name + " is of a kind that this test does not know");
    }
  }
  const auto report = estimation::verify_session(session);
  if (report && report->state == "complete")
    for (const auto& problem : report->problems) lines.push_back(problem.text());
  return lines;
}

fs::path sessions_in(const fs::path& root) { return root / "sessions"; }

// What the process to be killed does, and what finishes its take after it.
CaptureResult capture_in(const fs::path& root, const fs::path& resume) {
  const rig::RigFile rig_file = striped_rig_file(root);
  CaptureOptions options;
  options.directory = sessions_in(root);
  options.resume = resume;
  options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
  options.estimator.thread_count = 1;
  options.estimator.is_geometry_only = true;  // so that half of the time is that of the frames
  const auto job = CaptureJob::prepare(rig_file, options);
  if (!job) return job.error();
  const StripedWorld world;
  hw_sim::InProcessRig rig(world, in_process(rig_file));
  return job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, {}, {});
}

// Leaves it to be waited for.
bool has_ended(pid_t child) {
  siginfo_t info{};
  return ::waitid(P_PID, static_cast<id_t>(child), &info, WEXITED | WNOHANG | WNOWAIT) == 0 &&
         info.si_pid == child;
}

milliseconds age_of(pid_t child) {
  clockid_t clock = 0;
  timespec age{};
  if (::clock_getcpuclockid(child, &clock) != 0 || ::clock_gettime(clock, &age) != 0)
    return milliseconds::max();
  return milliseconds(age.tv_sec * 1000 + age.tv_nsec / 1'000'000);
}

class KilledCapture : public testing::Test {
 protected:
  void SetUp() override {
    ASSERT_FALSE(root_.empty());
    striped_rig_file(root_);
  }

  fs::path sessions() const { return sessions_in(root_); }

  pid_t start_capture() const {
    std::string self = "/proc/self/exe", flag = "--capture", root = root_;
    char* const arguments[] = {self.data(), flag.data(), root.data(), nullptr};
    pid_t child = 0;
    return ::posix_spawn(&child, self.c_str(), nullptr, nullptr, arguments, environ) == 0 ? child
                                                                                          : -1;
  }

  struct Life {
    int status = -1;  // as waitpid() has it
    milliseconds age{0};
  };

  // A capture that is killed at that age. Its age is the processor time that it has had: what else
  // the machine does moves the clock on the wall, but not where in the capture that is.
  Life capture_for(milliseconds age) const {
    const pid_t child = start_capture();
    if (child < 0) return {};
    while (!has_ended(child) && age_of(child) < age) std::this_thread::sleep_for(milliseconds(1));
    ::kill(child, SIGKILL);
    Life life;
    rusage used{};
    ::wait4(child, &life.status, 0, &used);
    life.age = milliseconds((used.ru_utime.tv_sec + used.ru_stime.tv_sec) * 1000 +
                            (used.ru_utime.tv_usec + used.ru_stime.tv_usec) / 1000);
    return life;
  }

  // True where there was something to finish: a process killed among its maps has its frames.
  bool expect_resumable(const fs::path& session) const {
    const auto manifest = estimation::read_manifest(session);
    if (!manifest || manifest->state == estimation::SessionState::kComplete) return false;
    const auto frames = files_of(session / "frames");
    const auto take = find_interruption(session);
    EXPECT_TRUE(take) << "an interrupted take is not listed";
    const CaptureResult result = capture_in(root_, session);
    EXPECT_EQ(result.exit_code, ExitCode::kDone) << result.message;
    const auto report = estimation::verify_session(session);
    EXPECT_TRUE(report && report->problems.empty() && report->state == "complete");
    const auto after = files_of(session / "frames");
    for (const auto& [name, bytes] : frames) {
      if (is_temporary(name)) continue;
      EXPECT_TRUE(after.at(name) == bytes) << name << " was overwritten";
    }
    return true;
  }

  std::set<fs::path> folders() const {
    std::set<fs::path> all;
    for (const auto& entry : fs::directory_iterator(sessions())) all.insert(entry.path());
    return all;
  }

  const test_support::TemporaryFolder folder_;
  const fs::path root_ = folder_.path();
};

TEST_F(KilledCapture, LeavesOnlyWholeFilesAndNoEarlierSessionIsTouched) {
  const Life whole = capture_for(std::chrono::minutes(5));
  ASSERT_EQ(whole.status, 0) << "the capture that is not killed";
  milliseconds duration = whole.age;
  const fs::path first = *folders().begin();
  const auto first_files = files_of(first);
  ASSERT_FALSE(first_files.empty());
  std::mt19937_64 random(20260131);
  int killed_count = 0, with_frames_count = 0, resumed_count = 0;
  std::map<std::string, std::string> before;  // of the take killed last, and its folder
  fs::path before_folder;
  // A take may be over before it is killed: then there is one more, with less time to live.
  const int take_limit = 10 * kill_count();
  for (int take = 0; take < take_limit && killed_count < kill_count(); ++take) {
    const auto earlier = folders();
    const milliseconds life(static_cast<std::int64_t>(
        random() % static_cast<std::uint64_t>(std::max<std::int64_t>(duration.count(), 2))));
    SCOPED_TRACE("take " + std::to_string(take) + " killed after " + std::to_string(life.count()) +
                 " of " + std::to_string(duration.count()) + " ms");
    const bool is_killed = WIFSIGNALED(capture_for(life).status);
    killed_count += is_killed ? 1 : 0;
    if (!is_killed) duration = std::min(duration, life);
    EXPECT_THAT(differing_files(files_of(first), first_files), testing::IsEmpty())
        << "an earlier session has changed";
    if (!before_folder.empty()) {
      EXPECT_THAT(differing_files(files_of(before_folder), before), testing::IsEmpty())
          << "the take before has changed";
      fs::remove_all(before_folder);  // or the disk fills
      before_folder.clear();
    }
    for (const fs::path& folder : folders()) {
      if (earlier.contains(folder)) continue;
      for (const std::string& line : incomplete_files(folder)) ADD_FAILURE() << line;
      before_folder = folder;
      // The next start lists it, and finishes it.
      resumed_count += expect_resumable(folder) ? 1 : 0;
      before = files_of(folder);
      const bool has_frames = std::ranges::any_of(
          before, [](const auto& file) { return file.first.ends_with(".tiff"); });
      with_frames_count += has_frames ? 1 : 0;
    }
  }
  std::printf("%d of %d takes killed, %d of them with frames on the disk, %d finished\n",
              killed_count, kill_count(), with_frames_count, resumed_count);
  EXPECT_GT(resumed_count, 0);
  EXPECT_EQ(killed_count, kill_count()) << "captures were over before they were killed";
}

// A session's first milliseconds: its folder, its journal, its manifest.
TEST_F(KilledCapture, ASessionSaysHowItWasBegunFromItsFirstMoment) {
  ASSERT_EQ(capture_for(std::chrono::minutes(5)).status, 0);
  int session_count = 0;
  // On a busy machine it takes longer before any has its manifest.
  for (int take = 0; take < 24 || (session_count == 0 && take < 400); ++take) {
    SCOPED_TRACE("take " + std::to_string(take));
    const std::set<fs::path> earlier = folders();
    const pid_t child = start_capture();
    ASSERT_GT(child, 0);
    while (folders().size() == earlier.size() && ::waitpid(child, nullptr, WNOHANG) == 0) {
    }
    std::this_thread::sleep_for(std::chrono::microseconds(150 * take));
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);
    for (const fs::path& folder : folders()) {
      if (earlier.contains(folder)) continue;
      for (const std::string& line : incomplete_files(folder)) ADD_FAILURE() << line;
      if (!estimation::read_manifest(folder)) continue;
      ++session_count;
      EXPECT_TRUE(read_journal(folder).beginning) << folder;
    }
  }
  EXPECT_GT(session_count, 0);
}

TEST_F(KilledCapture, ATornFileWouldBeNoticed) {
  ASSERT_EQ(capture_for(std::chrono::minutes(5)).status, 0);
  const fs::path session = *folders().begin();
  EXPECT_THAT(incomplete_files(session), testing::IsEmpty());
  std::size_t torn_count = 0;
  for (const char* name : {"journal.jsonl", "maps/validity.exr"}) {
    fs::resize_file(session / name, fs::file_size(session / name) - 3);
    EXPECT_GE(incomplete_files(session).size(), ++torn_count) << name;
  }
  const auto manifest = estimation::read_manifest(session);
  ASSERT_TRUE(manifest);
  const fs::path frame = session / manifest->frames.front().file;
  fs::resize_file(frame, fs::file_size(frame) - 3);
  EXPECT_GE(incomplete_files(session).size(), ++torn_count);
}

}  // namespace
}  // namespace capture

int main(int argc, char** argv) {
  if (argc == 3 && std::string(argv[1]) == "--capture")
    return static_cast<int>(capture::capture_in(argv[2], {}).exit_code);
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
