// ssrig-scatter-table: makes the shipped table of one medium with a white Monte Carlo run.
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>

#include "estimation/models/monte_carlo/white_table.h"

namespace {

constexpr int kBatchCount = 32;
constexpr const char* kProgram = "ssrig-scatter-table 1";
// Where roulette starts. Against none, 4 gives a 1.3 to 4 times smaller standard error in the same
// time; 1 and 16 are worse (measured at s and k from 0 to 7, g 0.8).
constexpr double kRoulettePath_tmfp = 4;

std::vector<estimation::WhiteScore> run_batches(const estimation::PhotonWalk& walk,
                                                std::uint64_t seed, std::int64_t photons_each,
                                                int thread_count) {
  std::vector<estimation::WhiteScore> batches(kBatchCount);
  tbb::task_arena arena(thread_count);
  arena.execute([&] {
    tbb::parallel_for(
        std::size_t{0}, batches.size(),
        [&](std::size_t i) { batches[i].run(walk, seed, i, photons_each); },
        tbb::simple_partitioner{});
  });
  return batches;
}

}  // namespace

// NOLINTNEXTLINE(bugprone-exception-escape): CLI11 would only throw about our own options' names
int main(int argc, char** argv) {
  estimation::WalkMedium medium;
  double photon_count = 1e6;
  std::uint64_t seed = 1;
  int thread_count = 1;
  std::string out_path;
  CLI::App app("Makes the scattering table of one medium with a white Monte Carlo run.",
               "ssrig-scatter-table");
  app.add_option("--eta", medium.eta, "Refractive index relative to air")
      ->check(CLI::Range(1.0, 2.0));
  app.add_option("--anisotropy", medium.anisotropy, "g of Henyey and Greenstein")
      ->check(CLI::Range(-0.99, 0.99));
  app.add_option("--photons", photon_count, "How many photons, such as 1e8")
      ->check(CLI::Range(1e3, 1e12));
  app.add_option("--seed", seed, "Of the random numbers");
  app.add_option("--threads", thread_count, "The result does not depend on it")
      ->check(CLI::Range(1, 256));
  app.add_option("--out", out_path, "The file to write")->required();
  CLI11_PARSE(app, argc, argv);

  const estimation::PhotonWalk walk(medium,
                                    {estimation::ScoreGrid::kLongestPath_tmfp, kRoulettePath_tmfp});
  const auto photons_each = static_cast<std::int64_t>(photon_count / kBatchCount);
  const std::vector<estimation::WhiteScore> batches =
      run_batches(walk, seed, photons_each, thread_count);
  estimation::ScatteringTable table = estimation::make_scattering_table(medium, batches);
  table.program = kProgram;
  table.seed = seed;
  std::ofstream file(out_path, std::ios::binary);
  file << estimation::to_text(table) << std::flush;
  if (!file) {
    std::fprintf(stderr, "ssrig-scatter-table: cannot write %s\n", out_path.c_str());
    return 5;
  }
  std::printf("%s: %lld photons, energy residual %.2g +- %.2g\n", out_path.c_str(),
              static_cast<long long>(table.photon_count), table.energy_residual,
              table.energy_residual_se);
  return 0;
}
