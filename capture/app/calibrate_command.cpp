// ssrig calibrate geometry|radiometry: a rig's calibration from sessions, or, for geometry, live
// with guidance from pose to pose.
#include "capture/app/calibrate_command.h"

#include <charconv>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "capture/app/commands.h"
#include "capture/app/console.h"
#include "capture/calibrate/geometry_job.h"
#include "estimation/calibration/calibration_file.h"
#include "rig/rig_file.h"

namespace capture {
namespace {

namespace fs = std::filesystem;

estimation::Result<estimation::Board> board_of(const std::vector<std::string>& words) {
  double square_mm = 0;
  const char* end = words[2].data() + words[2].size();
  if (std::from_chars(words[2].data(), end, square_mm).ptr != end) square_mm = 0;
  return estimation::parse_board(words[0], words[1], square_mm);
}

// Observes the sessions given; those that are no pose are told and left out.
void add_sessions(const std::vector<std::string>& sessions, GeometryJob& job) {
  ProgressLine line;
  for (std::size_t i = 0; i < sessions.size(); ++i) {
    line.show("pose " + std::to_string(i + 1) + " of " + std::to_string(sessions.size()), true);
    if (const auto added = job.add_session(sessions[i]); !added)
      complain("left out: " + added.error().text());
  }
}

ExitCode conclude(const GeometryJob& job, const fs::path& out) {
  const auto now = std::chrono::system_clock::now();
  std::printf("%s", job.report().c_str());
  const fs::path folder = report_folder(out, "geometry", now);
  if (const auto written = job.write_report(folder); !written) {
    complain(written.error().text());
    return exit_code_of(written.error());
  }
  std::printf("\nreport: %s\n", folder.c_str());
  if (!job.refusals().empty()) {
    for (const std::string& refusal : job.refusals()) complain("not a calibration: " + refusal);
    return ExitCode::kFailed;
  }
  const auto kept = job.store(out, now);
  if (!kept) {
    complain(kept.error().text());
    return exit_code_of(kept.error());
  }
  if (!kept->empty()) std::printf("the older calibration is kept as %s\n", kept->c_str());
  std::printf("%s\n", out.c_str());
  return ExitCode::kDone;
}

ExitCode calibrate_geometry(const GeometryArguments& arguments) {
  const auto rig_file = rig::read_rig_file(arguments.rig_file);
  if (!rig_file) {
    complain(rig_file.error().detail);
    return ExitCode::kUsage;
  }
  const auto board = board_of(arguments.board);
  if (!board) {
    complain(board.error().text());
    return ExitCode::kUsage;
  }
  const fs::path out = arguments.out.empty() ? rig_file->calibration_file : fs::path(arguments.out);
  if (out.empty()) {
    complain("the rig file names no calibration file; name one under [calibration] file, or --out");
    return ExitCode::kUsage;
  }
  GeometryJob job(*board);
  add_sessions(arguments.sessions, job);
  job.update();
  if (arguments.sessions.empty()) {
    const ExitCode captured = capture_poses(*rig_file, job);
    if (captured != ExitCode::kDone) return captured;
  }
  return conclude(job, out);
}

}  // namespace

fs::path report_folder(const fs::path& calibration, const char* part,
                       std::chrono::system_clock::time_point now) {
  std::string name = calibration.stem().string();
  name.append(".").append(part).append(".").append(estimation::date_stamp(now));
  return calibration.parent_path() / name;
}

void add_calibrate_command(CLI::App& program, const Select& select) {
  CLI::App* command = program.add_subcommand("calibrate", "a rig's calibration");
  command->require_subcommand(1);
  auto geometry = std::make_shared<GeometryArguments>();  // shared: CLI11 copies callbacks
  CLI::App* own = command->add_subcommand(
      "geometry",
      "lenses of camera and projector and how they stand, from a board in several poses");
  own->add_option("--rig", geometry->rig_file, "the rig file")->required();
  own->add_option("--board", geometry->board,
                  "the board: checkerboard or charuco, ROWSxCOLS squares (not inner corners), edge "
                  "of a square in mm: checkerboard 9x12 20")
      ->required()
      ->expected(3);
  own->add_option("--sessions", geometry->sessions,
                  "session folders, one a pose (default: captures poses live, with guidance)");
  own->add_option("--out", geometry->out,
                  "the calibration file (default: the rig file's; an older one is kept)");
  own->callback(
      [geometry, select] { select([geometry] { return calibrate_geometry(*geometry); }); });
  add_calibrate_radiometry_command(*command, select);
}

}  // namespace capture
