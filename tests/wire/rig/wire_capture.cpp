#include "tests/wire/rig/wire_capture.h"

#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <optional>
#include <utility>

#include "tests/capture/fault_matrix.h"

namespace fs = std::filesystem;

namespace {

constexpr auto kPatience = std::chrono::seconds(150);

std::string read_text(const fs::path& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::string with_sequence_line(std::string toml, const std::string& line) {
  const std::string section = "[sequence]\n";
  return toml.insert(toml.find(section) + section.size(), line + "\n");
}

}  // namespace

WireMode WireMode::of(int word_count, const char* const* words) {
  WireMode mode;
  if (word_count > 0) mode.sync = words[0];
  if (word_count > 1) mode.pace = words[1];
  if (word_count > 2) mode.has_line_status = words[2] != std::string("without-line-status");
  return mode;
}

std::string WireMode::rig_text(std::string toml) const {
  if (sync != "trigger_box") {
    const std::size_t trigger = toml.find("[trigger]");
    toml.erase(trigger, toml.find("[sequence]") - trigger);
  }
  toml = with_sequence_line(std::move(toml), "sync = \"" + sync + "\"");
  return with_sequence_line(std::move(toml), "pace = \"" + pace + "\"");
}

bool WireMode::has_part_for(hw_sim::FaultKind kind) const {
  capture::MatrixRig matrix_rig;
  if (sync == "camera_line") matrix_rig.sync = rig::SyncMode::kCameraLine;
  if (sync == "software") matrix_rig.sync = rig::SyncMode::kSoftware;
  return matrix_rig.has_part_for(kind);
}

WireCapture::WireCapture() {
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

void WireCapture::set_reopen_deadline(std::chrono::milliseconds time) const {
  const std::string toml = read_text(rig_file());
  std::ofstream(rig_file()) << with_sequence_line(
      toml, "reopen_deadline_ms = " + std::to_string(time.count()));
}

void WireCapture::set_mode(const WireMode& mode) {
  has_line_status_ = mode.has_line_status;
  const std::string toml = read_text(rig_file());
  std::ofstream(rig_file()) << mode.rig_text(toml);
}

int WireCapture::run(const std::string& plan) const {
  auto child = start(plan);
  return child ? ended(*child) : kHangs;
}

rig::Result<hw_sim::ChildProcess> WireCapture::start(const std::string& plan) const {
  std::ofstream(folder_ / "plan.toml") << plan;
  std::vector<std::string> argv{SSRIG_SIM, "run",    "--rig",    rig_file(),
                                "--scene", "ledger", "--faults", folder_ / "plan.toml"};
  if (!has_line_status_) argv.emplace_back("--without-line-status");
  for (const std::string& word : std::vector<std::string>{"--", SSRIG, "capture", "--rig",
                                                          rig_file(), "--out", folder_ / "out"})
    argv.push_back(word);
  return hw_sim::ChildProcess::start({.argv = std::move(argv),
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
