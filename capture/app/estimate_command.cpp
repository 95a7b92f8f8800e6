// ssrig estimate SESSION: maps from a session folder.
#include <cstdio>
#include <memory>
#include <string>

#include "capture/app/commands.h"
#include "capture/app/console.h"
#include "capture/app/estimator_options.h"
#include "capture/results.h"
#include "estimation/estimator.h"

namespace capture {
namespace {

struct EstimateArguments {
  std::string session;
  std::string maps_folder;  // empty: SESSION/maps
  std::string only;
  estimation::EstimatorOptions options;
};

ExitCode refuse(const estimation::InputError& error) {
  complain(error.text());
  return exit_code_of(error);
}

ExitCode estimate(const EstimateArguments& arguments) {
  if (const auto valid = arguments.options.validate(); !valid) {
    complain(valid.error().text());
    return ExitCode::kUsage;
  }
  const std::filesystem::path session = arguments.session;
  const auto manifest = estimation::read_manifest(session);
  if (!manifest) return refuse(manifest.error());
  ProgressLine line;
  const auto estimated = estimation::estimate_session(
      session, arguments.options, [&line](const estimation::EstimateProgress& progress) {
        line.show(progress.stage + " " + std::to_string(progress.done) + " of " +
                  std::to_string(progress.total));
      });
  if (!estimated) return refuse(estimated.error());
  // The pictures belong beside the maps of the session, not beside somebody's experiment.
  const bool is_default = arguments.maps_folder.empty();
  const std::filesystem::path maps_folder =
      is_default ? session / "maps" : std::filesystem::path(arguments.maps_folder);
  const auto written = write_results(*estimated, *manifest, session, maps_folder,
                                     is_default ? session / "report" : std::filesystem::path());
  if (!written) return refuse(written.error());
  for (const std::string& note : estimated->notes) std::fprintf(stderr, "note: %s\n", note.c_str());
  std::printf("%s\n", maps_folder.c_str());
  return ExitCode::kDone;
}

}  // namespace

void add_estimate_command(CLI::App& program, const Select& select) {
  auto arguments = std::make_shared<EstimateArguments>();  // shared: CLI11 copies callbacks
  CLI::App* command = program.add_subcommand("estimate", "maps from a session folder");
  command->add_option("session", arguments->session, "the session folder")->required();
  command->add_option("--out", arguments->maps_folder, "the maps' folder (default SESSION/maps)");
  command->add_option("--only", arguments->only, "compute only the geometry")
      ->check(CLI::IsMember({"geometry"}));
  add_estimator_options(*command, arguments->options);
  command->callback([arguments, select] {
    arguments->options.is_geometry_only = arguments->only == "geometry";
    select([arguments] { return estimate(*arguments); });
  });
}

}  // namespace capture
