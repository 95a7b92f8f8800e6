// What a power cut may find: no file gets its name in a session before its bytes are on the disk,
// and every name is on the disk in the end. Looked at where a program asks the system for it.
#include <dlfcn.h>
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <map>
#include <mutex>
#include <set>
#include <string>

#include "capture/capture_job.h"
#include "tests/capture/striped_world.h"
#include "tests/temporary_folder.h"

namespace {

namespace fs = std::filesystem;

// What was asked for, of any thread.
class DiskLog {
 public:
  void synced(int descriptor) {
    struct stat status {};
    if (::fstat(descriptor, &status) != 0) return;
    const std::lock_guard lock(mutex_);
    if (S_ISDIR(status.st_mode))
      lasting_folders_.insert(status.st_ino);
    else
      synced_files_.insert(status.st_ino);
  }
  void renamed(const std::string& from, const std::string& to) {
    struct stat file {
    }, folder{};
    if (::stat(from.c_str(), &file) != 0 || S_ISDIR(file.st_mode)) return;
    ::stat(fs::path(to).parent_path().c_str(), &folder);
    const std::lock_guard lock(mutex_);
    if (synced_files_.count(file.st_ino) == 0) unsynced_.insert(fs::path(to).filename());
    lasting_folders_.erase(folder.st_ino);
    folders_[fs::path(to).parent_path().filename()] = folder.st_ino;
    ++rename_count_;
  }
  // Files that got their name too early.
  std::set<std::string> unsynced() const { return unsynced_; }
  // Folders with a name in them that a power cut would undo.
  std::set<std::string> forgetful_folders() const {
    std::set<std::string> names;
    for (const auto& [name, inode] : folders_)
      if (lasting_folders_.count(inode) == 0) names.insert(name);
    return names;
  }
  std::set<std::string> folders() const {
    std::set<std::string> names;
    for (const auto& [name, inode] : folders_) names.insert(name);
    return names;
  }
  int rename_count() const { return rename_count_; }

 private:
  mutable std::mutex mutex_;
  std::set<ino_t> synced_files_, lasting_folders_;  // guarded by mutex_, as all
  std::set<std::string> unsynced_;
  std::map<std::string, ino_t> folders_;  // by name: those that something was renamed into
  int rename_count_ = 0;
};

DiskLog& disk_log() {
  static DiskLog log;
  return log;
}

template <typename Function>
Function* of_the_system(const char* name) {
  return reinterpret_cast<Function*>(::dlsym(RTLD_NEXT, name));
}

}  // namespace

// In place of the system's, for this program and the libraries it uses.
extern "C" int rename(const char* from, const char* to) noexcept {
  disk_log().renamed(from, to);
  return of_the_system<int(const char*, const char*)>("rename")(from, to);
}
extern "C" int fdatasync(int descriptor) {
  disk_log().synced(descriptor);
  return of_the_system<int(int)>("fdatasync")(descriptor);
}
extern "C" int fsync(int descriptor) {
  disk_log().synced(descriptor);
  return of_the_system<int(int)>("fsync")(descriptor);
}

namespace capture {
namespace {

TEST(Durability, EveryFileOfACaptureIsOnTheDiskBeforeItHasItsName) {
  const test_support::TemporaryFolder folder;
  ASSERT_FALSE(folder.path().empty());
  const rig::RigFile rig_file = striped_rig_file(folder.path());
  CaptureOptions options;
  options.directory = rig_file.storage.directory;
  options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
  options.estimator.thread_count = 2;
  options.estimator.is_geometry_only = true;
  const auto job = CaptureJob::prepare(rig_file, options);
  ASSERT_TRUE(job) << job.error().message;
  const StripedWorld world;
  hw_sim::InProcessRig rig(world, in_process(rig_file));
  const CaptureResult result =
      job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, {}, {});
  EXPECT_EQ(result.state, estimation::SessionState::kComplete) << result.message;
  EXPECT_GT(disk_log().rename_count(), 160 + 5) << "frames, manifest, report and maps";
  EXPECT_THAT(disk_log().folders(), testing::IsSupersetOf({"frames", "maps", "report"}));
  EXPECT_THAT(disk_log().unsynced(), testing::IsEmpty());
  EXPECT_THAT(disk_log().forgetful_folders(), testing::IsEmpty());
}

}  // namespace
}  // namespace capture
