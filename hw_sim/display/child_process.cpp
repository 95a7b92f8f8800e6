#include "hw_sim/display/child_process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

extern "C" {  // glibc 2.36 forgets it in this header
#include <sys/pidfd.h>
}

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

namespace hw_sim {
namespace {

using std::chrono::ceil;
using std::chrono::milliseconds;

constexpr auto kPatience = std::chrono::seconds(5);  // from SIGTERM to SIGKILL

std::vector<std::string> child_environment(const std::map<std::string, std::string>& changes) {
  std::vector<std::string> environment;
  for (char** entry = environ; *entry != nullptr; ++entry) {
    const std::string text = *entry;
    if (!changes.contains(text.substr(0, text.find('=')))) environment.push_back(text);
  }
  for (const auto& [name, value] : changes)
    if (!value.empty()) environment.emplace_back(name).append("=").append(value);
  return environment;
}

std::vector<char*> c_strings(std::vector<std::string>& texts) {
  std::vector<char*> pointers;
  pointers.reserve(texts.size() + 1);
  for (std::string& text : texts) pointers.push_back(text.data());
  pointers.push_back(nullptr);
  return pointers;
}

// After fork(): only what is safe there. Never returns.
[[noreturn]] void become(const ChildSettings& settings, const std::vector<char*>& argv,
                         const std::vector<char*>& environment, const char* output, int error_pipe,
                         pid_t parent) {
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (getppid() != parent) _exit(127);  // it died before we asked to be told
  if (settings.is_own_session) setsid();
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  if (settings.inherited_descriptor >= 0) fcntl(settings.inherited_descriptor, F_SETFD, 0);
  if (output != nullptr) {
    const int file = open(output, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    dup2(file, STDOUT_FILENO);
    dup2(file, STDERR_FILENO);
  }
  execvpe(argv[0], argv.data(), environment.data());
  const int reason = errno;
  [[maybe_unused]] const auto written = write(error_pipe, &reason, sizeof reason);
  _exit(127);
}

}  // namespace

rig::Result<ChildProcess> ChildProcess::start(const ChildSettings& settings) {
  std::vector<std::string> arguments = settings.argv;
  std::vector<std::string> variables = child_environment(settings.environment);
  const std::vector<char*> argv = c_strings(arguments);
  const std::vector<char*> environment = c_strings(variables);
  const std::string output = settings.output.string();
  std::array<int, 2> error_pipe{};
  if (pipe2(error_pipe.data(), O_CLOEXEC) != 0)
    return rig::failure(rig::Fault::kNotFound, "no pipe: " + std::string(std::strerror(errno)));

  ChildProcess child;
  const pid_t parent = getpid();
  child.pid_ = fork();
  if (child.pid_ == 0)
    become(settings, argv, environment, output.empty() ? nullptr : output.c_str(), error_pipe[1],
           parent);
  close(error_pipe[1]);
  int reason = child.pid_ < 0 ? errno : 0;
  if (child.pid_ > 0 && read(error_pipe[0], &reason, sizeof reason) < 0) reason = errno;
  close(error_pipe[0]);
  if (child.pid_ > 0) child.descriptor_ = pidfd_open(child.pid_, 0);
  if (reason == 0) return child;
  return rig::failure(rig::Fault::kNotFound,
                      "cannot start " + settings.argv.front() + ": " + std::strerror(reason));
}

ChildProcess::ChildProcess(ChildProcess&& other) noexcept
    : pid_(std::exchange(other.pid_, -1)),
      descriptor_(std::exchange(other.descriptor_, -1)),
      exit_code_(other.exit_code_) {}

ChildProcess& ChildProcess::operator=(ChildProcess&& other) noexcept {
  if (this == &other) return *this;
  end();
  pid_ = std::exchange(other.pid_, -1);
  descriptor_ = std::exchange(other.descriptor_, -1);
  exit_code_ = other.exit_code_;
  return *this;
}

ChildProcess::~ChildProcess() { end(); }

std::optional<int> ChildProcess::wait(rig::HostTime deadline) {
  while (!exit_code_) {
    const auto left = ceil<milliseconds>(deadline - rig::HostClock::now());
    pollfd ended{descriptor_, POLLIN, 0};
    const int count =
        poll(&ended, 1, static_cast<int>(std::max(left.count(), milliseconds::rep{0})));
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) return std::nullopt;
    int status = 0;
    waitpid(pid_, &status, 0);
    exit_code_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }
  return exit_code_;
}

void ChildProcess::send(int signal) {
  if (!exit_code_) kill(pid_, signal);
}

void ChildProcess::end() noexcept {
  if (pid_ < 0) return;
  send(SIGTERM);
  if (!wait(rig::HostClock::now() + kPatience)) {
    send(SIGKILL);
    wait(rig::HostClock::now() + kPatience);
  }
  close(descriptor_);
  pid_ = -1;
}

}  // namespace hw_sim
