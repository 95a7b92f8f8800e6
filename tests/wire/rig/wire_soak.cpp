// Captures without end over all the wires: one ssrig serve, the virtual rig's devices, and faults
// at random. Fails if a frame is in a wrong slot, if a session is not what its state says, or if
// the daemon's memory, descriptors or threads grow.
// usage: wire_soak COUNT [SEED [SYNC [PACE]]] (a rig file's words)
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <optional>
#include <regex>
#include <string>
#include <thread>

#include "hw_sim/display/child_process.h"
#include "hw_sim/faults/fault_plan.h"
#include "tests/process_health.h"
#include "tests/wire/rig/ledger_session.h"
#include "tests/wire/rig/wire_capture.h"

namespace {

namespace fs = std::filesystem;

constexpr auto kStartPatience = std::chrono::seconds(60);
constexpr auto kCapturePatience = std::chrono::seconds(300);
constexpr auto kPollPeriod = std::chrono::milliseconds(50);

std::string read_text(const fs::path& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

// Every kind of fault now and then: some five a capture, every other one with a lost device.
std::string plan_of(std::uint64_t seed, const WireMode& mode) {
  std::string plan = "seed = " + std::to_string(seed) + "\nfaults = [\n";
  for (int kind = 0; kind < hw_sim::kFaultKindCount; ++kind) {
    const auto fault = static_cast<hw_sim::FaultKind>(kind);
    if (!mode.has_part_for(fault)) continue;
    const bool is_device = fault >= hw_sim::FaultKind::kUsbUnplugged;
    plan.append("{fault = \"").append(to_string(fault)).append("\", rate_frac = ");
    plan.append(is_device ? "0.001" : "0.002").append("},\n");
  }
  return plan + "]\n";
}

class Soak {
 public:
  Soak(fs::path folder, WireMode mode) : folder_(std::move(folder)), mode_(std::move(mode)) {
    std::string rig = read_text(LEDGER_RIG);
    rig = std::regex_replace(rig, std::regex("127\\.43\\.10\\.1"), "127.43.11.1");
    rig = std::regex_replace(
        rig, std::regex("ledger_calibration.json"),
        (fs::path(LEDGER_RIG).parent_path() / "ledger_calibration.json").string());
    std::ofstream(rig_file()) << mode_.rig_text(rig) << "\n[daemon]\nport = 8651\n";
  }

  int run(int capture_count, std::uint64_t seed) {
    std::ofstream(folder_ / "plan.toml") << plan_of(seed, mode_);
    auto daemon = start({SSRIG_SIM, "run", "--rig", rig_file(), "--scene", "ledger", "--faults",
                         folder_ / "plan.toml", "--", "sh", "-c", "echo $$ > \"$0\"; exec \"$@\"",
                         folder_ / "pid", SSRIG, "serve", "--rig", rig_file()},
                        "daemon.log");
    if (!daemon || !wait_for_daemon()) {
      std::printf("the daemon did not start:\n%s\n", read_text(folder_ / "daemon.log").c_str());
      return 1;
    }
    const std::string pid = std::to_string(std::stol(read_text(folder_ / "pid")));
    for (int i = 0; i < capture_count; ++i) {
      if (!capture_when_ready(i)) return 1;
      health_.add(health_of(pid));
    }
    daemon->send(SIGTERM);
    const auto code = daemon->wait(rig::HostClock::now() + kStartPatience);
    return report(capture_count, code.value_or(-1));
  }

 private:
  fs::path rig_file() const { return folder_ / "rig.toml"; }

  std::unique_ptr<hw_sim::ChildProcess> start(const std::vector<std::string>& command,
                                              const std::string& log) {
    // Its allocator gives big blocks back at once, instead of when it sees fit: a set of pictures
    // is 69 MB, and what is measured is what the daemon holds.
    auto child = hw_sim::ChildProcess::start({.argv = command,
                                              .environment = {{"MALLOC_MMAP_THRESHOLD_", "131072"}},
                                              .output = folder_ / log});
    if (!child) return nullptr;
    return std::make_unique<hw_sim::ChildProcess>(std::move(*child));
  }

  bool wait_for_daemon() const {
    const auto deadline = rig::HostClock::now() + kStartPatience;
    while (rig::HostClock::now() < deadline) {
      if (read_text(folder_ / "daemon.log").find("open http://") != std::string::npos) return true;
      std::this_thread::sleep_for(kPollPeriod);
    }
    return false;
  }

  // The daemon may have to open a device anew first. False if something hangs.
  bool capture_when_ready(int number) {
    const int before = complete_count_ + failed_count_;
    const auto deadline = rig::HostClock::now() + kStartPatience;
    while (complete_count_ + failed_count_ == before) {
      if (!capture_and_judge(number)) return false;
      if (rig::HostClock::now() > deadline) {
        std::printf("capture %d: the daemon never got ready; %s\n", number, folder_.c_str());
        return false;
      }
      std::this_thread::sleep_for(kPollPeriod);
    }
    return true;
  }

  // False if it hangs.
  bool capture_and_judge(int number) {
    const fs::path out = folder_ / ("out" + std::to_string(number));
    const std::string log = "capture" + std::to_string(number) + ".log";
    auto child = start({SSRIG, "capture", "--rig", rig_file(), "--out", out}, log);
    const auto code = child ? child->wait(rig::HostClock::now() + kCapturePatience) : std::nullopt;
    if (!code) {
      std::printf("capture %d hangs; %s\n", number, folder_.c_str());
      return false;
    }
    std::error_code none;
    for (const auto& entry : fs::directory_iterator(out, none)) {
      const LedgerSession session = read_ledger_session(entry.path(), rig_file());
      const bool is_complete = session.state == "complete";
      ++(is_complete ? complete_count_ : failed_count_);
      frame_count_ += session.frame_count;
      if (is_complete != (*code == 0) || (is_complete && session.frame_count != 176))
        ++false_state_count_;
      wrong_frame_count_ += static_cast<int>(session.wrong_frames.size());
      for (const std::string& wrong : session.wrong_frames)
        std::printf("capture %d: %s\n", number, wrong.c_str());
      if (!is_complete) std::printf("capture %d: %s\n", number, read_text(folder_ / log).c_str());
      if (!is_complete || !session.wrong_frames.empty())
        fs::copy(entry.path() / "journal.jsonl", folder_ / ("journal" + std::to_string(number)),
                 none);
    }
    std::fflush(stdout);
    fs::remove_all(out, none);
    return true;
  }

  int report(int capture_count, int daemon_code) const {
    const std::string log = read_text(folder_ / "daemon.log");
    const std::regex happened("ssrig-sim: fault: ");
    const auto fault_count =
        std::distance(std::sregex_iterator(log.begin(), log.end(), happened), {});
    std::printf(
        "sync mode %s, %s: %d captures over the wires with %d faults: %d complete, %d failed with "
        "their cause, %d "
        "frames\nframes in a wrong slot: %d; sessions that are not what their state says: %d; the "
        "daemon ended with %d\n",
        mode_.sync.c_str(), mode_.pace.c_str(), capture_count, static_cast<int>(fault_count),
        complete_count_, failed_count_, frame_count_, wrong_frame_count_, false_state_count_,
        daemon_code);
    health_.print();
    std::printf("%s\n", health_.is_flat() ? "flat" : "NOT FLAT");
    return health_.is_flat() && wrong_frame_count_ == 0 && false_state_count_ == 0 &&
                   daemon_code == 0
               ? 0
               : 1;
  }

  const fs::path folder_;
  const WireMode mode_;
  HealthLog health_;
  int complete_count_ = 0, failed_count_ = 0, frame_count_ = 0;
  int wrong_frame_count_ = 0, false_state_count_ = 0;
};

}  // namespace

int main(int argc, char** argv) {
  const int capture_count = argc > 1 ? std::atoi(argv[1]) : 50;
  const std::uint64_t seed = argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1;
  std::string name = "/tmp/wsoak.XXXXXX";  // short, for sockets
  if (mkdtemp(name.data()) == nullptr) return 1;
  const WireMode mode = WireMode::of(argc - 3, argv + 3);
  const int exit_code = Soak(name, mode).run(capture_count, seed);
  if (exit_code == 0)
    fs::remove_all(name);
  else
    std::printf("logs and journals: %s\n", name.c_str());
  return exit_code;
}
