// The simulated box in this process, the production driver in another: how ssrig-sim runs ssrig.

#include <fcntl.h>
#include <gtest/gtest.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "hw_sim/usb/usb_testbed.h"
#include "hw_sim/usb/usb_trigger_box.h"

namespace {

using namespace std::chrono_literals;

// trigger_probe with its standard output on a pipe.
class Probe {
 public:
  Probe(const hw_sim::UsbTestbed& testbed, const std::string& pulse_count) {
    int pipe_ends[2] = {-1, -1};
    EXPECT_EQ(::pipe2(pipe_ends, O_CLOEXEC), 0);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, pipe_ends[1], STDOUT_FILENO);

    std::string program = SSRIG_TRIGGER_PROBE;
    std::string argument = pulse_count;
    std::vector<char*> arguments = {program.data(), argument.data(), nullptr};
    std::vector<std::string> variables = environment(testbed);
    std::vector<char*> pointers;
    pointers.reserve(variables.size() + 1);
    for (std::string& variable : variables) pointers.push_back(variable.data());
    pointers.push_back(nullptr);
    EXPECT_EQ(
        posix_spawn(&pid_, program.c_str(), &actions, nullptr, arguments.data(), pointers.data()),
        0);
    posix_spawn_file_actions_destroy(&actions);
    ::close(pipe_ends[1]);
    output_ = ::fdopen(pipe_ends[0], "r");
  }
  ~Probe() {
    if (!is_over_) kill();
    std::fclose(output_);
  }
  Probe(const Probe&) = delete;
  Probe& operator=(const Probe&) = delete;

  // The next line without its end; empty when the probe has closed its output.
  std::string line() {
    std::string text;
    for (int letter = std::fgetc(output_); letter != EOF && letter != '\n';
         letter = std::fgetc(output_)) {
      text += static_cast<char>(letter);
    }
    return text;
  }
  // Exit code, or minus the signal that ended it.
  int wait() {
    int status = 0;
    ::waitpid(pid_, &status, 0);
    is_over_ = true;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  void kill() {
    ::kill(pid_, SIGKILL);
    wait();
  }

 private:
  static std::vector<std::string> environment(const hw_sim::UsbTestbed& testbed) {
    std::vector<std::string> variables;
    for (const auto& [name, value] : testbed.child_environment()) {
      variables.push_back(name);
      variables.back().append("=").append(value);
    }
    // The first of a name counts.
    for (char** variable = environ; *variable != nullptr; ++variable) {
      variables.emplace_back(*variable);
    }
    return variables;
  }

  pid_t pid_ = -1;
  std::FILE* output_ = nullptr;
  bool is_over_ = false;
};

class OutOfProcess : public testing::Test {
 protected:
  void SetUp() override {
    auto opened = hw_sim::UsbTestbed::open();
    ASSERT_TRUE(opened) << opened.error().detail;
    testbed = *std::move(opened);
    box = std::make_unique<hw_sim::UsbTriggerBox>(*testbed, hw_sim::UsbTriggerBoxOptions{},
                                                  [](hw_sim::LinePulse) {});
  }
  void light(int level_adc) { box->light(rig::HostClock::now() + 5ms, level_adc); }

  std::unique_ptr<hw_sim::UsbTestbed> testbed;
  std::unique_ptr<hw_sim::UsbTriggerBox> box;
};

TEST_F(OutOfProcess, AnotherProgramSeesEdgesAndPulses) {
  Probe probe(*testbed, "4");
  ASSERT_EQ(probe.line(), "armed TB-SIM-0001");
  for (int i = 1; i <= 4; ++i) {
    light(i % 2 == 1 ? 900 : 100);
    ASSERT_EQ(probe.line(), "pulse " + std::to_string(i) + " of edge " + std::to_string(i));
  }
  EXPECT_EQ(probe.wait(), 0);
}

TEST_F(OutOfProcess, UnplugEndsAnotherProgramWithAFaultNotACrash) {
  Probe probe(*testbed, "1");
  ASSERT_EQ(probe.line(), "armed TB-SIM-0001");
  box->unplug();
  EXPECT_EQ(probe.line(), "fault device lost");
  EXPECT_EQ(probe.wait(), 3);

  box->replug();
  Probe again(*testbed, "1");
  ASSERT_EQ(again.line(), "armed TB-SIM-0001");
  light(900);
  EXPECT_EQ(again.line(), "pulse 1 of edge 1");
  EXPECT_EQ(again.wait(), 0);
}

TEST_F(OutOfProcess, ProgramKilledWhileArmedLeavesABoxThatTheNextOneCanUse) {
  Probe killed(*testbed, "1");
  ASSERT_EQ(killed.line(), "armed TB-SIM-0001");
  killed.kill();
  light(900);  // pulses nobody hears of
  Probe next(*testbed, "1");
  ASSERT_EQ(next.line(), "armed TB-SIM-0001");
  light(100);
  EXPECT_EQ(next.line(), "pulse 1 of edge 1");
  EXPECT_EQ(next.wait(), 0);
}

TEST_F(OutOfProcess, MissingBoxIsNotFound) {
  box->unplug();
  Probe probe(*testbed, "1");
  EXPECT_EQ(probe.line(), "fault not found");
  EXPECT_EQ(probe.wait(), 3);
}

}  // namespace
