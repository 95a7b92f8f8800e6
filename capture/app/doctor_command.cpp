// ssrig doctor --rig FILE: does this host hold what the rig needs, and which command puts it right?
#include <chrono>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "capture/app/commands.h"
#include "capture/app/console.h"
#include "capture/doctor/doctor.h"
#include "capture/doctor/needs.h"
#include "capture/interrupted_takes.h"
#include "capture/plan.h"
#include "capture/session_plan.h"
#include "nlohmann/json.hpp"
#include "rig/devices/monitor_list.h"
#include "rig/rig_file.h"

namespace capture {
namespace {

struct DoctorArguments {
  std::string rig_file;
  bool is_json = false;
};

// As a capture reads it before anything else.
HostFinding check_calibration(const rig::RigFile& rig_file) {
  const auto plan = make_plan("paper", rig_file.projector, rig_file.sequence);
  const auto manifest =
      plan_manifest(rig_file, *plan, {.subject = "", .created = std::chrono::system_clock::now()});
  if (manifest)
    return {Health::kOk, "calibration", rig_file.calibration_file.string() + " can be used", ""};
  return {Health::kFailure, "calibration", manifest.error().text(),
          "ssrig calibrate geometry --rig " + rig_file.path.string()};
}

rig::Result<std::vector<MonitorFacts>> monitors() {
  const auto listed = rig::list_monitors();
  if (!listed) return tl::unexpected(listed.error());
  std::vector<MonitorFacts> facts;
  for (const rig::Monitor& monitor : *listed)
    facts.push_back({monitor.name, monitor.width_px, monitor.height_px, monitor.refresh_hz});
  return facts;
}

void print_json(const std::string& rig_file, const std::vector<HostFinding>& findings) {
  nlohmann::ordered_json json{{"rig", rig_file},
                              {"health", to_string(worst_of(findings))},
                              {"findings", nlohmann::ordered_json::array()}};
  for (const HostFinding& finding : findings)
    json["findings"].push_back({{"subject", finding.subject},
                                {"health", to_string(finding.health)},
                                {"text", finding.text},
                                {"remedy", finding.remedy}});
  // Names of devices may hold any bytes: replace what is not UTF-8 rather than throw.
  std::printf("%s\n",
              json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace).c_str());
}

void print_text(const std::vector<HostFinding>& findings) {
  for (const HostFinding& finding : findings) {
    std::printf("%-8s %-15s %s\n", to_string(finding.health).c_str(), finding.subject.c_str(),
                finding.text.c_str());
    if (!finding.remedy.empty()) std::printf("%24s -> %s\n", "", finding.remedy.c_str());
  }
}

ExitCode diagnose(const DoctorArguments& arguments) {
  const auto rig_file = rig::read_rig_file(arguments.rig_file);
  if (!rig_file) {
    complain(rig_file.error().detail);
    return ExitCode::kUsage;
  }
  const auto needs = needs_of(*rig_file);
  if (!needs) {
    complain(needs.error().detail);
    return ExitCode::kUsage;
  }
  std::vector<HostFinding> findings = examine(*rig_file, read_host(*rig_file), monitors(), *needs);
  findings.push_back(check_calibration(*rig_file));
  for (const InterruptedTake& take : list_interrupted_takes(rig_file->storage.directory))
    findings.push_back({Health::kWarning, "session", take.text(), take.remedy(rig_file->path)});
  if (arguments.is_json)
    print_json(arguments.rig_file, findings);
  else
    print_text(findings);
  return worst_of(findings) == Health::kFailure ? ExitCode::kFailed : ExitCode::kDone;
}

}  // namespace

void add_doctor_command(CLI::App& program, const Select& select) {
  auto arguments = std::make_shared<DoctorArguments>();  // shared: CLI11 copies callbacks
  CLI::App* command = program.add_subcommand(
      "doctor", "does this computer hold what the rig needs; opens no device");
  command->add_option("--rig", arguments->rig_file, "the rig file")->required();
  command->add_flag("--json", arguments->is_json, "the findings as JSON");
  command->callback([arguments, select] { select([arguments] { return diagnose(*arguments); }); });
}

}  // namespace capture
