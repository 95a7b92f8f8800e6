// Names that stay in the session, and files that are whole or absent.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>

#include "estimation/session/frame_io.h"
#include "estimation/session/manifest.h"
#include "session_folder.h"

namespace estimation {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

TEST(ResolveInSession, ANameInsideIsJoined) {
  const TemporaryFolder session;
  fs::create_directory(session.path() / "frames");
  for (const char* name :
       {"frames/a.tiff", "a.tiff", "./frames//a.tiff", "new/folder/a.tiff", "a..b/..c"}) {
    const auto path = resolve_in_session(session.path(), name, "/frames/0/file");
    ASSERT_TRUE(path) << path.error().text();
    EXPECT_EQ(*path, session.path() / name);
  }
}

TEST(ResolveInSession, ANameThatLeadsOutIsRefusedWithItsPlace) {
  const TemporaryFolder session;
  for (const char* name : {"", "/etc/passwd", "..", "../a", "frames/../../a", "a/.."}) {
    const auto path = resolve_in_session(session.path(), name, "/frames/0/file");
    ASSERT_FALSE(path) << name;
    EXPECT_EQ(path.error().fault, InputFault::kInvalid);
    EXPECT_EQ(path.error().place, "/frames/0/file");
    EXPECT_EQ(path.error().file, (session.path() / "session.json").string());
    EXPECT_THAT(path.error().text(), HasSubstr(testing::PrintToString(std::string(name))));
  }
}

TEST(ResolveInSession, ALinkInsideIsFollowedAndALinkOutIsRefused) {
  const TemporaryFolder session;
  const TemporaryFolder elsewhere;
  write_text(elsewhere.path() / "secret", "x");
  fs::create_directory(session.path() / "frames");
  fs::create_symlink("frames", session.path() / "inside");
  fs::create_directory_symlink(elsewhere.path(), session.path() / "folder_out");
  fs::create_symlink(elsewhere.path() / "secret", session.path() / "file_out");
  fs::create_symlink(elsewhere.path() / "absent", session.path() / "nothing");
  fs::create_symlink("loop", session.path() / "loop");

  EXPECT_TRUE(resolve_in_session(session.path(), "inside/a", ""));
  for (const char* name : {"folder_out/secret", "folder_out/new", "file_out", "nothing", "loop"}) {
    EXPECT_FALSE(resolve_in_session(session.path(), name, "/frames/0/file")) << name;
  }
}

TEST(ResolveInSession, TheSessionItselfMayBeBehindALink) {
  const TemporaryFolder folder;
  fs::create_directory(folder.path() / "real");
  fs::create_symlink("real", folder.path() / "link");
  EXPECT_TRUE(resolve_in_session(folder.path() / "link", "a.tiff", ""));
}

TEST(ResolveInSession, AFolderBesideWithTheSameBeginningIsOutside) {
  const TemporaryFolder folder;
  fs::create_directory(folder.path() / "s");
  fs::create_directory(folder.path() / "s2");
  fs::create_symlink("../s2", folder.path() / "s" / "link");
  EXPECT_FALSE(resolve_in_session(folder.path() / "s", "link/a", ""));
}

TEST(Sha256, MatchesTheStandardsExamples) {
  // FIPS 180-4 example values.
  EXPECT_EQ(sha256_hex({}), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(sha256_hex(bytes_of("abc")),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

std::size_t file_count(const fs::path& folder) {
  return static_cast<std::size_t>(
      std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
}

TEST(WriteFileAtomically, WritesAndReplaces) {
  const TemporaryFolder folder;
  const fs::path path = folder.path() / "a.bin";
  for (const std::string& content :
       {std::string("first, longer"), std::string("second"), std::string()}) {
    ASSERT_TRUE(write_file_atomically(path, bytes_of(content)));
    EXPECT_EQ(text_of(path), content);
    EXPECT_EQ(file_count(folder.path()), 1U);
  }
}

TEST(WriteFileAtomically, AMissingFolderIsUnwritableWithTheRemedy) {
  const TemporaryFolder folder;
  const auto written = write_file_atomically(folder.path() / "no" / "a.bin", {});
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().fault, InputFault::kUnwritable);
  EXPECT_THAT(written.error().text(), HasSubstr("check the name and that the folder exists"));
  EXPECT_THAT(written.error().file, HasSubstr("no/a.bin"));
}

TEST(WriteFileAtomically, AFolderUnderTheNameIsUnwritableAndLeavesNothing) {
  const TemporaryFolder folder;
  fs::create_directory(folder.path() / "a.bin");
  EXPECT_FALSE(write_file_atomically(folder.path() / "a.bin", bytes_of("x")));
  EXPECT_EQ(file_count(folder.path()), 1U);
}

TEST(WriteFileAtomically, ALinkUnderTheTemporaryNameIsNotWrittenThrough) {
  const TemporaryFolder folder;
  write_text(folder.path() / "precious", "p");
  fs::create_symlink("precious", folder.path() / "a.bin.tmp");
  EXPECT_FALSE(write_file_atomically(folder.path() / "a.bin", bytes_of("x")));
  EXPECT_EQ(text_of(folder.path() / "precious"), "p");
}

// A limit on file sizes makes write() fail half-way, as a full disk does.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t byte_count) {
    previous_handler_ = std::signal(SIGXFSZ, SIG_IGN);
    ::getrlimit(RLIMIT_FSIZE, &previous_);
    const rlimit limit{byte_count, previous_.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &limit);
  }
  FileSizeLimit(const FileSizeLimit&) = delete;
  FileSizeLimit& operator=(const FileSizeLimit&) = delete;
  ~FileSizeLimit() {
    ::setrlimit(RLIMIT_FSIZE, &previous_);
    std::signal(SIGXFSZ, previous_handler_);
  }

 private:
  rlimit previous_{};
  void (*previous_handler_)(int) = nullptr;
};

TEST(WriteFileAtomically, AWriteThatFailsHalfWayLeavesTheOldFileAndNothingElse) {
  const TemporaryFolder folder;
  const fs::path path = folder.path() / "a.bin";
  ASSERT_TRUE(write_file_atomically(path, bytes_of("old")));
  {
    const FileSizeLimit limit(1000);
    const auto written = write_file_atomically(path, std::vector<std::byte>(5000));
    ASSERT_FALSE(written);
    EXPECT_EQ(written.error().fault, InputFault::kUnwritable);
    EXPECT_EQ(written.error().file, path.string());
  }
  EXPECT_EQ(text_of(path), "old");
  EXPECT_EQ(file_count(folder.path()), 1U);
}

}  // namespace
}  // namespace estimation
