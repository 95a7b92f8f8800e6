#include "tests/wire/rig/wire_capture.h"

#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <optional>
#include <system_error>

namespace fs = std::filesystem;

namespace {

constexpr auto kPatience = std::chrono::seconds(150);

std::string read_text(const fs::path& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

}  // namespace

WireCapture::WireCapture() {
  std::string name = "/tmp/wfault.XXXXXX";  // short, for sockets
  folder_ = mkdtemp(name.data());
  fs::create_directory(folder_ / "tmp");
  // An address of this process's own: others may capture beside it.
  std::string rig = read_text(LEDGER_RIG);
  const std::string address = "127.43.10.1";
  rig.replace(rig.find(address), address.size(),
              "127.43." + std::to_string(20 + getpid() / 250 % 200) + "." +
                  std::to_string(1 + getpid() % 250));
  std::ofstream(rig_file()) << rig;
  fs::copy(fs::path(LEDGER_RIG).parent_path() / "ledger_calibration.json", folder_);
}

WireCapture::~WireCapture() {
  std::error_code ignored;
  fs::remove_all(folder_, ignored);
}

void WireCapture::set_reopen_deadline(std::chrono::milliseconds time) const {
  add_to_sequence("reopen_deadline_ms = " + std::to_string(time.count()));
}

void WireCapture::set_sync(const std::string& sync) const {
  std::string rig = read_text(rig_file());
  const std::size_t trigger = rig.find("[trigger]");
  rig.erase(trigger, rig.find("[sequence]") - trigger);
  std::ofstream(rig_file()) << rig;
  add_to_sequence("sync = \"" + sync + "\"");
}

void WireCapture::set_pace(const std::string& pace) const {
  add_to_sequence("pace = \"" + pace + "\"");
}

void WireCapture::add_to_sequence(const std::string& line) const {
  std::string rig = read_text(rig_file());
  const std::string section = "[sequence]\n";
  rig.insert(rig.find(section) + section.size(), line + "\n");
  std::ofstream(rig_file()) << rig;
}

int WireCapture::run(const std::string& plan) const {
  auto child = start(plan);
  return child ? ended(*child) : kHangs;
}

rig::Result<hw_sim::ChildProcess> WireCapture::start(const std::string& plan) const {
  std::ofstream(folder_ / "plan.toml") << plan;
  return hw_sim::ChildProcess::start(
      {.argv = {SSRIG_SIM, "run", "--rig", rig_file(), "--scene", "ledger", "--faults",
                folder_ / "plan.toml", "--", SSRIG, "capture", "--rig", rig_file(), "--out",
                folder_ / "out"},
       .environment = {{"TMPDIR", (folder_ / "tmp").string()}},
       .output = folder_ / "output"});
}

rig::Result<hw_sim::ChildProcess> WireCapture::start_without_rig() const {
  return hw_sim::ChildProcess::start(
      {.argv = {SSRIG, "capture", "--rig", rig_file(), "--out", folder_ / "out"},
       .environment = {{"DISPLAY", ""}},
       .output = folder_ / "output"});
}

int WireCapture::ended(hw_sim::ChildProcess& child) {
  return child.wait(rig::HostClock::now() + kPatience).value_or(kHangs);
}

std::string WireCapture::output() const { return read_text(folder_ / "output"); }

std::vector<fs::path> WireCapture::sessions() const {
  std::vector<fs::path> found;
  std::error_code none;
  for (const auto& entry : fs::directory_iterator(folder_ / "out", none))
    found.push_back(entry.path());
  return found;
}

LedgerSession WireCapture::judge(const fs::path& session) const {
  return read_ledger_session(session, rig_file());
}
