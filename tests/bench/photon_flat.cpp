#include "tests/bench/photon_flat.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <numbers>
#include <sstream>
#include <string>
#include <vector>

#include "tests/hw_sim/photons/flat_harmonics.h"
#include "tests/hw_sim/photons/half_space.h"

namespace bench {

namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr std::size_t kFreqs = std::size(hw_sim::kTruthFreqs_per_mm);

// Asked: R within 0.5%, harmonics within 1% or three of the file's standard errors. Own noise is
// no excuse where it is small, and none of the file's where that is: both count.
bool is_within(double found, double expected, double asked_frac, double file_se, double own_se) {
  return std::abs(found - expected) <= std::max(asked_frac * expected, 3 * file_se) + 2 * own_se;
}

void say_paths(Report& report, const char* of_what, int paths) {
  report.text(std::string("### Photons in flat phantoms: ").append(of_what));
  report.text(digits(paths).append(" paths a phantom."));
}

}  // namespace

void show_flat_harmonics(Report& report, int paths) {
  say_paths(report, "harmonics", paths);
  Table table{
      .name = "photons_flat",
      .title =
          "Photons against mc_truth_rf.csv: difference % (own and the file's standard error %)",
      .columns = {"medium", "R_d", "f 0.08", "0.17", "0.25", "0.33", "0.5 /mm"}};
  for (const hw_sim::TruthMedium& medium : hw_sim::read_truth(SSRIG_TEST_DATA "/mc_truth_rf.csv")) {
    const auto found =
        hw_sim::flat_harmonics(hw_sim::volume_optics(medium.scattering), {},
                               hw_sim::kTruthFreqs_per_mm, paths, 40 + table.rows.size());
    table.rows.push_back({medium.name});
    for (std::size_t i = 0; i < kFreqs; ++i) {
      // The file's are per flux that enters.
      const double entering = 1 - hw_sim::fresnel_reflectance(1, 1, hw_sim::kSkinIndex);
      const double value = found[i].value.real() / entering, expected = medium.reflectance[i];
      const double se = found[i].standard_error / entering;
      table.rows.back().push_back(percent(value / expected - 1)
                                      .append(" (")
                                      .append(percent(se / expected))
                                      .append(", ")
                                      .append(percent(medium.standard_error[i] / expected))
                                      .append(")"));
      if (!is_within(value, expected, i == 0 ? 0.005 : 0.01, medium.standard_error[i], se))
        report.fail(std::string(medium.name)
                        .append(" at ")
                        .append(digits(hw_sim::kTruthFreqs_per_mm[i]))
                        .append("/mm"));
    }
  }
  report.table(table);
}

void show_flat_shift(Report& report, int paths) {
  say_paths(report, "the shift by oblique light", paths);
  Table table{.name = "photons_shift",
              .title = "Shift of the first harmonic (12 mm), cheek red, all exit angles, mm",
              .columns = {"incidence, degrees", "published", "photons", "standard error"}};
  const double freq_per_mm[] = {1 / 12.0};
  const hw_sim::VolumeOptics cheek_red = hw_sim::volume_optics({0.0525, 1.2814});
  for (const auto& [degrees, published_mm] : kPublishedShifts) {
    const auto first = hw_sim::flat_harmonics(
        cheek_red,
        {.towards_lamp = hw_sim::outward(degrees * kDegree, std::numbers::pi), .towards_eye = {}},
        freq_per_mm, paths, 60 + table.rows.size())[0];
    const double mm_per_rad = 12 / (2 * std::numbers::pi);
    const double shift_mm = -std::arg(first.value) * mm_per_rad;
    const double se_mm = first.standard_error / std::abs(first.value) * mm_per_rad;
    table.rows.push_back(
        {digits(degrees), digits(published_mm), digits(shift_mm), digits(se_mm, 2)});
    // Published to a hundredth.
    if (std::abs(shift_mm - published_mm) > 0.005 + 3 * se_mm)
      report.fail(std::string("the shift at ").append(digits(degrees)).append(" degrees"));
  }
  report.table(table);
}

void show_flat_directions(Report& report, int paths) {
  say_paths(report, "one direction of exit", paths);
  Table table{.name = "photons_tilted",
              .title =
                  "Photons against mc_tilted.csv, one exit direction: difference % of harmonic "
                  "0, of 1 to 4 (root mean square, in brackets what noise explains)",
              .columns = {"medium", "cos incidence", "cos exit", "harmonic 0", "1", "2", "3", "4"}};
  std::ifstream file(SSRIG_TEST_DATA "/mc_tilted.csv");
  std::vector<std::vector<std::string>> lines;  // of one phantom
  const auto compare = [&] {
    if (lines.empty()) return;
    const auto number = [&](std::size_t line, std::size_t cell) {
      return std::stod(lines[line][cell]);
    };
    const auto direction = [&](std::size_t cosine, std::size_t azimuth) {
      return hw_sim::outward(std::acos(number(0, cosine)), number(0, azimuth));
    };
    std::vector<double> freqs_per_mm;
    for (std::size_t n = 0; n < 5; ++n) freqs_per_mm.push_back(number(n, 8));
    const auto found =
        hw_sim::flat_harmonics(hw_sim::volume_optics({number(0, 1), number(0, 2)}),
                               {.towards_lamp = direction(3, 4), .towards_eye = direction(5, 6)},
                               freqs_per_mm, paths, 10 + table.rows.size());
    table.rows.push_back({lines[0][0], digits(number(0, 3)), digits(number(0, 5))});
    for (std::size_t n = 0; n < 5; ++n) {
      const std::complex<double> expected(number(n, 9), number(n, 10));
      const double off = std::abs(found[n].value - expected) / std::abs(expected);
      const double noise = std::hypot(found[n].standard_error, number(n, 11)) / std::abs(expected) *
                           (n == 0 ? 1 : std::numbers::sqrt2);
      table.rows.back().push_back(
          percent(n == 0 ? found[n].value.real() / expected.real() - 1 : off)
              .append(" (")
              .append(percent(noise))
              .append(")"));
      if (off > 0.005 + 3 * noise)
        report.fail(std::string("the tilted phantom ")
                        .append(lines[0][0])
                        .append(" at cos ")
                        .append(lines[0][3]));
    }
    lines.clear();
  };
  for (std::string line; std::getline(file, line);) {
    if (line.empty() || line[0] == '#' || line.starts_with("medium")) continue;
    std::stringstream cells(line);
    std::vector<std::string> row;
    for (std::string cell; std::getline(cells, cell, ',');) row.push_back(cell);
    if (row[7] == "0") compare();
    lines.push_back(row);
  }
  compare();
  report.table(table);
}

}  // namespace bench
