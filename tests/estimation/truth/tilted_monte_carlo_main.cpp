// Writes tests/data/mc_tilted.csv: flat phantoms under tilts of 0 to 60 degrees, as
// DirectionalMonteCarlo sees them.
// usage: tilted_monte_carlo PHOTONS OUT.csv    (the shipped file: 4e6 photons, seed by row)
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <numbers>
#include <vector>

#include "tests/estimation/truth/directional_monte_carlo.h"

namespace {

using estimation::testing::DirectionalResult;
using estimation::testing::DirectionalRun;
using std::numbers::pi;

constexpr double kPeriod_mm = 12, kCameraAngle_deg = 14;

struct Phantom {
  const char* name;
  double sigma_a_per_mm, sigma_s_prime_per_mm;
};
constexpr Phantom kPhantoms[] = {
    {"cheek_red", 0.0525, 1.2814}, {"cheek_green", 0.1653, 1.5}, {"stubble_red", 0.4056, 0.9237}};

struct Row {
  Phantom phantom;
  double tilt_rad;
  DirectionalRun run;
  DirectionalResult result;
};

// The normal turns from the projector towards the camera and beyond, in the plane of the stripes'
// axis: the projector is then on the side where its coordinate falls.
Row make_row(const Phantom& phantom, double tilt_rad, std::int64_t photon_count) {
  const double exit_rad = kCameraAngle_deg * pi / 180 - tilt_rad;
  Row row{.phantom = phantom, .tilt_rad = tilt_rad, .run = {}, .result = {}};
  row.run.absorption = phantom.sigma_a_per_mm / phantom.sigma_s_prime_per_mm;
  row.run.directions = {.cos_incidence = std::cos(tilt_rad),
                        .cos_exit = std::cos(exit_rad),
                        .incidence_azimuth_rad = pi,
                        .exit_azimuth_rad = exit_rad > 0 ? 0 : pi};
  row.run.k_tmfp = 2 * pi / kPeriod_mm * std::cos(tilt_rad) / phantom.sigma_s_prime_per_mm;
  row.run.photon_count = photon_count;
  return row;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return std::fprintf(stderr, "usage: tilted_monte_carlo PHOTONS OUT.csv\n"), 1;
  const auto photon_count = static_cast<std::int64_t>(std::atof(argv[1]));
  std::vector<Row> rows;
  for (const Phantom& phantom : kPhantoms)
    for (const double tilt_deg : {0.0, 15.0, 30.0, 45.0, 60.0}) {
      rows.push_back(make_row(phantom, tilt_deg * pi / 180, photon_count));
      rows.back().run.seed = 1000 + rows.size();
    }
  tbb::task_arena(2).execute([&] {
    tbb::parallel_for(
        std::size_t{0}, rows.size(),
        [&](std::size_t i) { rows[i].result = estimation::testing::run_directional(rows[i].run); },
        tbb::simple_partitioner{});
  });
  std::FILE* file = std::fopen(argv[2], "w");
  if (file == nullptr) return std::fprintf(stderr, "cannot write %s\n", argv[2]), 5;
  std::fprintf(file,
               "# Flat phantoms, eta 1.4, g 0.8, tilted by arccos(cos_incidence): what a pattern "
               "exp(2 pi i f x) reflects,\n"
               "# radiance times pi over incident flux (T R~ h with its phase), f = n cos(tilt) / "
               "(40 px * 0.3 mm).\n"
               "# tests/estimation/truth/tilted_monte_carlo_main.cpp, %lld photons a row group; se "
               "of re or im (root of their mean square).\n"
               "medium,sigma_a_per_mm,sigma_s_prime_per_mm,cos_incidence,incidence_azimuth_rad,cos_"
               "exit,exit_azimuth_rad,n,f_per_mm,re,im,se\n",
               static_cast<long long>(photon_count));
  for (const Row& row : rows)
    for (std::size_t n = 0; n < row.result.value.size(); ++n)
      std::fprintf(file, "%s,%g,%g,%.8f,%.6f,%.8f,%.6f,%zu,%.6f,%.6f,%.6f,%.6f\n", row.phantom.name,
                   row.phantom.sigma_a_per_mm, row.phantom.sigma_s_prime_per_mm,
                   row.run.directions.cos_incidence, row.run.directions.incidence_azimuth_rad,
                   row.run.directions.cos_exit, row.run.directions.exit_azimuth_rad, n,
                   static_cast<double>(n) * std::cos(row.tilt_rad) / kPeriod_mm,
                   row.result.value[n].real(), row.result.value[n].imag(), row.result.se[n]);
  return std::fclose(file) == 0 ? 0 : 5;
}
