// ssrig: per-pixel subsurface scattering maps of a face, live.
#include <CLI/CLI.hpp>
#include <csignal>

#include "capture/app/commands.h"
#include "capture/app/console.h"

// NOLINTNEXTLINE(bugprone-exception-escape): CLI11 would only throw about our own commands' names
int main(int argc, char** argv) {
  CLI::App program(
      "ssrig projects patterns on a face, photographs them, and returns per-pixel subsurface\n"
      "scattering maps, geometry and pictures.\n"
      "Exit codes: 0 done, 1 failed, 2 usage or configuration, 3 device, 4 incomplete capture,\n"
      "5 storage, 130 aborted.",
      "ssrig");
  program.set_version_flag("--version", "ssrig " SSRIG_VERSION);
  program.require_subcommand(0, 1);  // asked for below: an unknown word is worth more of a message
  capture::Command command;
  const capture::Select select = [&command](capture::Command chosen) {
    command = std::move(chosen);
  };
  capture::add_serve_command(program, select);
  capture::add_capture_command(program, select);
  capture::add_estimate_command(program, select);
  capture::add_verify_command(program, select);
  capture::add_calibrate_command(program, select);
  capture::add_doctor_command(program, select);
  try {  // CLI11 says everything by exceptions, help too
    program.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return program.exit(error) == 0 ? 0 : static_cast<int>(capture::ExitCode::kUsage);
  }
  if (!command) {
    capture::complain(
        "name a command: serve, capture, estimate, verify, calibrate or doctor; see ssrig --help");
    return static_cast<int>(capture::ExitCode::kUsage);
  }
  // A file larger than a limit allows, and a reader of our output that has gone, are errors of
  // write(), not reasons to end without a word.
  std::signal(SIGXFSZ, SIG_IGN);
  std::signal(SIGPIPE, SIG_IGN);
  capture::open_standard_streams();
  const capture::ExitCode exit_code = command();
  return static_cast<int>(capture::finish_output(exit_code));
}
