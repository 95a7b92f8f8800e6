#include "hw_sim/app/scratch_folder.h"

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <system_error>

namespace hw_sim {
namespace {

// The keeper's whole life.
[[noreturn]] void keep(const std::filesystem::path& folder, int lifeline) {
  setsid();  // what is sent to our group is not for it
  char byte = 0;
  while (read(lifeline, &byte, 1) < 0 && errno == EINTR) continue;
  std::error_code ignored;  // nobody is left to be told
  std::filesystem::remove_all(folder, ignored);
  _exit(0);
}

}  // namespace

rig::Result<std::unique_ptr<ScratchFolder>> ScratchFolder::make() {
  std::unique_ptr<ScratchFolder> scratch(new ScratchFolder);
  if (const char* outer = std::getenv("TMPDIR"); outer != nullptr) scratch->outer_tmpdir_ = outer;
  std::error_code error;
  std::string folder = (std::filesystem::temp_directory_path(error) / "ssrig-sim.XXXXXX").string();
  std::array<int, 2> lifeline{};
  if (error || mkdtemp(folder.data()) == nullptr || pipe2(lifeline.data(), O_CLOEXEC) != 0)
    return rig::failure(rig::Fault::kNotFound, "cannot make the temporary folder " + folder + " (" +
                                                   std::strerror(errno) +
                                                   "); set TMPDIR to a folder that can be written");
  scratch->keeper_ = fork();
  if (scratch->keeper_ == 0) {
    close(lifeline[1]);
    keep(folder, lifeline[0]);
  }
  close(lifeline[0]);
  scratch->lifeline_ = lifeline[1];
  setenv("TMPDIR", folder.c_str(), 1);
  return scratch;
}

ScratchFolder::~ScratchFolder() {
  if (lifeline_ >= 0) close(lifeline_);
  if (keeper_ > 0) waitpid(keeper_, nullptr, 0);
}

}  // namespace hw_sim
