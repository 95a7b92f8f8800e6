#include "capture/app/estimator_options.h"

namespace capture {

void add_estimator_options(CLI::App& command, estimation::EstimatorOptions& options) {
  command.add_option("--method", options.method, "how the maps are fitted")
      ->check(CLI::IsMember({"lut"}))
      ->capture_default_str();
  command.add_option("--model", options.model, "how light scatters")
      ->check(CLI::IsMember({"dipole"}))
      ->capture_default_str();
  command.add_option("--eta", options.eta, "refractive index of the medium")->capture_default_str();
  command.add_option("--threads", options.thread_count, "0: as many as the machine has")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
}

}  // namespace capture
