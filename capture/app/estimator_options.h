// The options that `ssrig capture` and `ssrig estimate` share.
#pragma once

#include <CLI/CLI.hpp>

#include "estimation/estimator.h"

namespace capture {

// Adds --method, --model, --anisotropy, --eta, --indirect, --harmonics, --sweep-errors, --refine
// and --threads to `command`, kept in `options`.
void add_estimator_options(CLI::App& command, estimation::EstimatorOptions& options);

}  // namespace capture
