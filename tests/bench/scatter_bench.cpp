#include "tests/bench/scatter_bench.h"

#include <cmath>
#include <complex>
#include <memory>
#include <numbers>
#include <string>

#include "estimation/models/scattering_model.h"
#include "tests/bench/photon_flat.h"
#include "tests/hw_sim/photons/half_space.h"
#include "tests/hw_sim/world/kernel_spectrum.h"

namespace bench {

namespace {

constexpr std::uint64_t kWorldsSeed = 20260;  // of hw_sim/world/head_light.cpp

std::string with_noise(double off_frac, double noise_frac) {
  return percent(off_frac).append(" (").append(percent(noise_frac)).append(")");
}

// All exits, normal incidence.
void show_flat(Report& report, const hw_sim::ScatterTable& table, int photons) {
  Table rows{.name = "table_flat",
             .title =
                 "The simulator's table against mc_truth_rf.csv: difference % (the file's "
                 "standard error %)",
             .columns = {"medium", "R_d", "f 0.08", "0.17", "0.25", "0.33", "0.5 /mm"}};
  for (const hw_sim::TruthMedium& medium : hw_sim::read_truth(SSRIG_TEST_DATA "/mc_truth_rf.csv")) {
    const auto rings = hw_sim::over_all_exits(table.material(medium.scattering), 0, 60, 4);
    rows.rows.push_back({medium.name});
    for (std::size_t i = 0; i < medium.reflectance.size(); ++i) {
      const double found = hw_sim::transform(rings, hw_sim::kTruthFreqs_per_mm[i]).real();
      const double expected = medium.reflectance[i], se = medium.standard_error[i];
      rows.rows.back().push_back(with_noise(found / expected - 1, se / expected));
      const double own_se = i == 0 ? 0 : se * std::sqrt(medium.photons / photons);
      if (std::abs(found - expected) >
          std::max((i == 0 ? 0.005 : 0.01) * expected, 3 * se) + 2 * own_se)
        report.fail(std::string("the table: ")
                        .append(medium.name)
                        .append(" at ")
                        .append(digits(hw_sim::kTruthFreqs_per_mm[i]))
                        .append("/mm"));
    }
  }
  report.table(rows);
}

void show_shift(Report& report, const hw_sim::ScatterTable& table) {
  Table rows{.name = "table_shift",
             .title = "Shift of the first harmonic (12 mm), cheek red, all exit angles, mm",
             .columns = {"incidence, degrees", "published", "the table"}};
  const auto cheek_red = table.material({0.0525, 1.2814});
  for (const auto& [degrees, published_mm] : kPublishedShifts) {
    const auto rings = hw_sim::over_all_exits(cheek_red, degrees * std::numbers::pi / 180, 60, 16);
    const double shift_mm =
        std::arg(hw_sim::transform(rings, 1 / 12.0)) * 12 / (2 * std::numbers::pi);
    rows.rows.push_back({digits(degrees), digits(published_mm), digits(shift_mm)});
    // Published to a hundredth; the table's noise is a few thousandths.
    if (std::abs(shift_mm - published_mm) > 0.005 + 0.005)
      report.fail(
          std::string("the table: the shift at ").append(digits(degrees)).append(" degrees"));
  }
  report.table(rows);
}

void show_tilted(Report& report, const hw_sim::ScatterTable& table) {
  Table rows{
      .name = "table_tilted",
      .title =
          "The simulator's table against mc_tilted.csv, one exit direction: difference "
          "% of harmonic 0, of 1 to 4 and 6 (root mean square; in brackets the file's "
          "noise)",
      .columns = {"medium", "cos incidence", "cos exit", "harmonic 0", "1", "2", "3", "4", "6"}};
  double squares = 0, noise_squares = 0;
  int count = 0;
  for (const hw_sim::TiltedPhantom& phantom :
       hw_sim::read_tilted(SSRIG_TEST_DATA "/mc_tilted.csv")) {
    const auto found = hw_sim::harmonics_of(table, phantom);
    rows.rows.push_back({phantom.medium, digits(phantom.cos_incidence), digits(phantom.cos_exit)});
    for (const std::size_t n : {0U, 1U, 2U, 3U, 4U, 6U}) {
      const double size = std::abs(phantom.values[n]);
      const double off = std::abs(found[n] - phantom.values[n]) / size;
      const double noise = phantom.standard_errors[n] / size * (n == 0 ? 1 : std::numbers::sqrt2);
      rows.rows.back().push_back(
          with_noise(n == 0 ? found[n].real() / phantom.values[n].real() - 1 : off, noise));
      squares += off * off;
      noise_squares += noise * noise;
      ++count;
      if (off > 0.01 + 3 * noise)
        report.fail(std::string("the table: tilted ")
                        .append(phantom.medium)
                        .append(" at cos ")
                        .append(digits(phantom.cos_incidence)));
    }
  }
  report.table(rows);
  report.text(std::string("Root mean square of all: ")
                  .append(percent(std::sqrt(squares / count)))
                  .append("%, of which the file's noise explains ")
                  .append(percent(std::sqrt(noise_squares / count)))
                  .append("%."));
}

// Totals by direction against the estimator's own table: two programs, two photon counts.
void show_estimators(Report& report, const hw_sim::ScatterTable& table) {
  const auto model = estimation::make_scattering_model("monte_carlo_angular", {});
  if (!model) return report.fail(model.error().expectation);
  Table rows{
      .name = "table_estimator",
      .title = "Total by direction, the simulator's table over the estimator's: difference %",
      .columns = {"sigma_a / sigma_s'", "incidence, rad", "exit azimuth, rad", "R_d", "exit 0",
                  "0.2", "0.35", "0.5", "0.7", "0.9", "1.05 rad"}};
  constexpr double kPi = std::numbers::pi;
  for (const double ratio : {0.003, 0.02, 0.05, 0.2, 0.5}) {
    const hw_sim::SkinMaterial material = table.material({ratio, 1});
    const double reflectance = table.total_reflectance({ratio, 1});
    for (const double incidence_rad : {0.0, 0.35, 0.7, 1.0})
      for (const double azimuth_rad : {0.0, kPi / 2, kPi}) {
        rows.rows.push_back(
            {digits(ratio), digits(incidence_rad), digits(azimuth_rad), digits(reflectance, 4)});
        for (const double exit_rad : {0.0, 0.2, 0.35, 0.5, 0.7, 0.9, 1.05}) {
          const double k = 0;
          double total = 0;
          std::complex<double> factor;
          (*model)->transform(reflectance, {&k, 1}, {&total, 1});
          (*model)->direction_factors(
              reflectance, {&k, 1}, {std::cos(incidence_rad), std::cos(exit_rad), kPi, azimuth_rad},
              {&factor, 1});
          const double entering =
              1 - hw_sim::fresnel_reflectance(std::cos(incidence_rad), 1, hw_sim::kSkinIndex);
          const double found =
              entering * material.kernel({incidence_rad, exit_rad, azimuth_rad}).total();
          rows.rows.back().push_back(percent(found / (total * factor.real()) - 1));
        }
      }
  }
  report.table(rows);
}

}  // namespace

void show_scatter_table(Report& report, const std::filesystem::path& cache, int photons_per_angle) {
  report.text("### The simulator's table");
  const auto table = hw_sim::ScatterTable::cached(cache, photons_per_angle, kWorldsSeed, {});
  show_flat(report, table, photons_per_angle);
  show_shift(report, table);
  show_tilted(report, table);
  show_estimators(report, table);
}

}  // namespace bench
