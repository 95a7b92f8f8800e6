// What ssrig does where its standard streams are not what it expects.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "tests/temporary_folder.h"

namespace {

namespace fs = std::filesystem;

// The exit code of a shell's command line.
int run(const std::string& command) {
  const int status = std::system(command.c_str());
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

std::string content_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

const std::string kVerify = std::string(SSRIG) + " verify " + SESSION;

TEST(Streams, WordsThatCannotBeWrittenAreNoSuccess) {
  const test_support::TemporaryFolder folder;
  const fs::path said = folder.path() / "said";
  EXPECT_EQ(run(kVerify + " > /dev/null"), 0);
  EXPECT_EQ(run(kVerify + " > /dev/full 2> " + said.string()), 1);
  EXPECT_NE(content_of(said).find("standard output cannot be written: No space left on device"),
            std::string::npos)
      << content_of(said);
}

TEST(Streams, AFileNeverGetsTheNumberOfAClosedStream) {
  const test_support::TemporaryFolder folder;
  const fs::path session = folder.path() / "session";
  fs::copy(SESSION, session, fs::copy_options::recursive);
  EXPECT_EQ(
      run(std::string(SSRIG) + " estimate --only geometry " + session.string() + " <&- >&- 2>&-"),
      0);
  for (const auto& map : fs::directory_iterator(session / "maps"))
    EXPECT_EQ(content_of(map.path()).find("/maps\n"), std::string::npos) << map.path();
}

TEST(Streams, AnEmptyNameOfASessionIsNotAnotherCapture) {
  for (const char* option : {"--resume", "--out"})
    EXPECT_EQ(run(std::string(SSRIG) + " capture --rig nowhere.toml " + option +
                  " '' 2>&1 | grep -q 'name a folder'"),
              0)
        << option;
}

}  // namespace
