// ssrig calibrate radiometry: sensor, light, standard and optics, live or from sessions.
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "capture/app/calibrate_command.h"
#include "capture/app/console.h"
#include "capture/calibrate/radiometry_job.h"
#include "estimation/calibration/calibration_file.h"
#include "estimation/session/file_reading.h"
#include "estimation/session/manifest.h"

namespace capture {
namespace {

namespace fs = std::filesystem;

struct RadiometryArguments {
  std::string rig_file;
  RadiometryInputs inputs;
  std::vector<double> reflectance{0.99};
  std::string out;
};

ExitCode refuse(const estimation::InputError& error) {
  complain(error.text());
  return exit_code_of(error);
}

bool is_empty(const RadiometryInputs& inputs) {
  return inputs.series.empty() && inputs.standard.empty() && inputs.opaque.empty() &&
         inputs.chart.empty();
}

ExitCode calibrate_radiometry(RadiometryArguments arguments) {
  const auto rig_file = rig::read_rig_file(arguments.rig_file);
  if (!rig_file) {
    complain(rig_file.error().detail);
    return ExitCode::kUsage;
  }
  RadiometryInputs& inputs = arguments.inputs;
  for (std::size_t band = 0; band < 3; ++band)
    inputs.reflectance[band] =
        arguments.reflectance[std::min(band, arguments.reflectance.size() - 1)];
  const fs::path geometry_file = rig_file->calibration_file;
  const fs::path out = arguments.out.empty() ? geometry_file : fs::path(arguments.out);
  std::error_code unknown;  // then reading says why
  const fs::path before = fs::exists(out, unknown) ? out : geometry_file;
  const auto text = estimation::read_text(before);
  const auto geometry =
      text ? estimation::parse_calibration(*text, before.string()) : tl::unexpected(text.error());
  if (!geometry) {
    complain(geometry.error().text() + "; calibrate the geometry first");
    return ExitCode::kUsage;
  }
  if (is_empty(inputs)) {
    const ExitCode captured = capture_series(*rig_file, *geometry, inputs);
    if (captured != ExitCode::kDone) return captured;
    if (is_empty(inputs)) {
      complain("nothing was captured that could be measured; the calibration is as it was");
      return ExitCode::kFailed;
    }
  }
  const auto job = RadiometryJob::run(inputs, *geometry);
  if (!job) return refuse(job.error());
  const auto now = std::chrono::system_clock::now();
  std::printf("%s", job->report().c_str());
  const fs::path folder = report_folder(out, "radiometry", now);
  if (const auto written = job->write_report(folder); !written) return refuse(written.error());
  std::printf("\nreport: %s\n", folder.c_str());
  for (const std::string& warning : job->warnings())
    std::fprintf(stderr, "warning: %s\n", warning.c_str());
  if (before != out)
    if (const auto copied = estimation::save_text(out, *text); !copied)
      return refuse(copied.error());
  const auto kept = job->store(out, now);
  if (!kept) return refuse(kept.error());
  if (!kept->empty()) std::printf("the older calibration is kept as %s\n", kept->c_str());
  std::printf("%s\n", out.c_str());
  return ExitCode::kDone;
}

}  // namespace

void add_calibrate_radiometry_command(CLI::App& calibrate, const Select& select) {
  auto arguments = std::make_shared<RadiometryArguments>();  // shared: CLI11 copies callbacks
  CLI::App* command = calibrate.add_subcommand(
      "radiometry",
      "sensor, light, reflectance standard and optics: captured live step by step, or from the "
      "sessions named");
  RadiometryInputs& inputs = arguments->inputs;
  command->add_option("--rig", arguments->rig_file, "the rig file")->required();
  command->add_option("--dark", inputs.dark, "sessions whose frames are all dark (lens capped)");
  command->add_option("--series", inputs.series,
                      "sessions of white (black, grey) at several exposures, each repeated, of a "
                      "steady scene");
  command->add_option("--standard", inputs.standard,
                      "sessions of the reflectance standard under the plan's patterns");
  command->add_option("--reflectance", arguments->reflectance, "of the standard, one or by band")
      ->check(CLI::Range(0.01, 1.0))
      ->expected(1, 3)
      ->capture_default_str();
  command->add_option("--opaque", inputs.opaque,
                      "sessions of a flat, matte, opaque target under the plan's patterns, one a "
                      "distance");
  command->add_option(
      "--chart", inputs.chart,
      "a colour chart, a JSON list of {\"camera\": [r, g, b], \"display\": ...}; or "
      "{\"primaries\": [[r, g, b] under red, green, blue]}");
  command->add_option("--out", arguments->out,
                      "the calibration file (default: the rig file's; an older one is kept)");
  command->callback(
      [arguments, select] { select([arguments] { return calibrate_radiometry(*arguments); }); });
}

}  // namespace capture
