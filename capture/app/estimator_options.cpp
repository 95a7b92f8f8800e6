#include "capture/app/estimator_options.h"

namespace capture {
namespace {

// More than any stripes have, or any machine.
constexpr int kMostHarmonics = 1000;
constexpr int kMostThreads = 4096;

}  // namespace

void add_estimator_options(CLI::App& command, estimation::EstimatorOptions& options) {
  command
      .add_option("--method", options.method,
                  "how the maps are fitted; lut is the paper's, without uncertainties")
      ->check(CLI::IsMember({"likelihood", "lut"}))
      ->capture_default_str();
  command.add_option("--model", options.model, "how light scatters")
      ->check(
          CLI::IsMember({"monte_carlo", "monte_carlo_angular", "dipole", "gaussians", "burley"}))
      ->capture_default_str();
  command
      .add_option("--anisotropy", options.anisotropy,
                  "g of the medium, for the models that know it")
      ->capture_default_str();
  command.add_option("--eta", options.eta, "refractive index of the medium")->capture_default_str();
  command
      .add_option("--indirect", options.indirect,
                  "indirect light: fitted, zero, or decided by each neighbourhood")
      ->check(CLI::IsMember({"auto", "free", "zero"}))
      ->capture_default_str();
  command
      .add_option("--harmonics", options.harmonic_count,
                  "of the stripes, that the data are taken at: the first of them, at most this "
                  "many; 0: all")
      ->check(CLI::Range(0, kMostHarmonics))
      ->capture_default_str();
  command
      .add_option("--sweep-errors", options.sweep_errors,
                  "blur and drift beyond the calibration: corrected where they explain the misfit, "
                  "where significant, only reported, or not looked for")
      ->check(CLI::IsMember({"auto", "correct", "report", "off"}))
      ->capture_default_str();
  command.add_flag("--refine", options.is_refined,
                   "least squares with geometry near borders and creases; several times the work");
  command.add_option("--threads", options.thread_count, "0: as many as the machine has")
      ->check(CLI::Range(0, kMostThreads))
      ->capture_default_str();
}

}  // namespace capture
