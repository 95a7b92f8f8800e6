// ssrig verify SESSION: is a session whole, from its files alone?
#include <cstdio>
#include <map>
#include <memory>
#include <set>
#include <string>

#include "capture/app/commands.h"
#include "capture/app/console.h"
#include "capture/interrupted_takes.h"
#include "capture/stored_pictures.h"
#include "estimation/session/verify.h"
#include "nlohmann/json.hpp"

namespace capture {
namespace {

struct VerifyArguments {
  std::string session;
  bool is_json = false;
};

void print_json(const estimation::VerifyReport& report) {
  nlohmann::json json{{"state", report.state},
                      {"frame_count", report.frame_count},
                      {"checked_hash_count", report.checked_hash_count},
                      {"problems", nlohmann::json::array()},
                      {"notes", report.notes}};
  for (const auto& problem : report.problems) json["problems"].push_back(problem.text());
  // File names may hold any bytes: replace what is not UTF-8 rather than throw.
  std::printf("%s\n", json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace).c_str());
}

void print_text(const estimation::VerifyReport& report) {
  std::printf("state %s, %d frames read, %d of them with a matching hash\n", report.state.c_str(),
              report.frame_count, report.checked_hash_count);
  for (const auto& note : report.notes) std::printf("note: %s\n", note.c_str());
}

// Behind the structure: frames that are whole may yet show another picture than their pattern.
void check_pictures_of(const std::string& session, estimation::VerifyReport& report) {
  if (!report.problems.empty() || report.frame_count == 0) return;
  const auto check = check_stored_pictures(session);
  if (!check) {
    report.problems.push_back(check.error());
    return;
  }
  for (const auto& wrong : check->wrong) {
    estimation::PictureCheck alone;
    alone.wrong = {wrong};
    report.problems.push_back({estimation::InputFault::kInvalid, session, "", alone.text()});
  }
  report.notes.push_back(check->text());
  std::map<std::string, std::set<int>> patterns;  // by why
  for (const auto& each : check->unchecked) patterns[each.why].insert(each.pattern);
  for (const auto& [why, numbers] : patterns) {
    std::string text = "not checked for what they show:";
    for (const int number : numbers) text.append(" ").append(std::to_string(number));
    report.notes.push_back(text.append(" (").append(why).append(")"));
  }
}

ExitCode verify(const VerifyArguments& arguments) {
  auto report = estimation::verify_session(arguments.session);
  if (!report) {
    complain(report.error().text());
    return ExitCode::kFailed;
  }
  check_pictures_of(arguments.session, *report);
  if (const auto take = find_interruption(arguments.session))
    report->notes.push_back(
        take->text() + (take->is_resumable() ? "; finish it with: " : "; maps of its frames: ") +
        take->remedy("RIG_FILE"));
  if (arguments.is_json)
    print_json(*report);
  else
    print_text(*report);
  for (const auto& problem : report->problems) complain(problem.text());
  if (!report->problems.empty()) return ExitCode::kFailed;
  return report->state == "complete" ? ExitCode::kDone : ExitCode::kIncomplete;
}

}  // namespace

void add_verify_command(CLI::App& program, const Select& select) {
  auto arguments = std::make_shared<VerifyArguments>();  // shared: CLI11 copies callbacks
  CLI::App* command = program.add_subcommand("verify", "checks a session from its files alone");
  command->add_option("session", arguments->session, "the session folder")->required();
  command->add_flag("--json", arguments->is_json, "the report as JSON");
  command->callback([arguments, select] { select([arguments] { return verify(*arguments); }); });
}

}  // namespace capture
