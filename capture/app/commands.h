// The commands of `ssrig`: each adds its options to the program, and says what to run.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>

#include "capture/exit_code.h"

namespace capture {

using Command = std::function<ExitCode()>;

// Each calls `select` with what to run when its subcommand is on the command line.
using Select = std::function<void(Command)>;
void add_calibrate_command(CLI::App& program, const Select& select);
void add_capture_command(CLI::App& program, const Select& select);
void add_doctor_command(CLI::App& program, const Select& select);
void add_estimate_command(CLI::App& program, const Select& select);
void add_serve_command(CLI::App& program, const Select& select);
void add_verify_command(CLI::App& program, const Select& select);

}  // namespace capture
