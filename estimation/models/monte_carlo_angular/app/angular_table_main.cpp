// ssrig-angular-table: makes the shipped table of one medium for the model monte_carlo_angular,
// with a white Monte Carlo run over all directions of incidence.
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>

#include "estimation/models/monte_carlo_angular/angular_score.h"

namespace {

constexpr std::size_t kBatchCount = 32;
constexpr const char* kProgram = "ssrig-angular-table 1";
// Where roulette starts: 1 to 4 make no difference to the error at given time (measured).
constexpr double kRoulettePath_tmfp = 2;

std::vector<estimation::AngularScore> run_batches(const estimation::PhotonWalk& walk,
                                                  std::uint64_t seed, std::int64_t photons_each,
                                                  int thread_count) {
  std::vector<estimation::AngularScore> batches(kBatchCount);
  tbb::task_arena arena(thread_count);
  arena.execute([&] {
    tbb::parallel_for(
        std::size_t{0}, batches.size(),
        [&](std::size_t i) { batches[i].run(walk, seed, i, photons_each); },
        tbb::simple_partitioner{});
  });
  return batches;
}

int fail(const char* what, const std::string& path) {
  std::fprintf(stderr, "ssrig-angular-table: cannot %s %s\n", what, path.c_str());
  return 5;
}

}  // namespace

int main(int argc, char** argv) {
  estimation::WalkMedium medium;
  double photon_count = 1e6;
  std::uint64_t seed = 1;
  int thread_count = 1;
  std::string out_path;
  CLI::App app("Makes the table of one medium for the model monte_carlo_angular.");
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

  const estimation::PhotonWalk walk(
      medium, {estimation::AngularScore::kLongestPath_tmfp, kRoulettePath_tmfp});
  const auto photons_each = static_cast<std::int64_t>(photon_count / kBatchCount);
  const auto batches = run_batches(walk, seed, photons_each, thread_count);
  estimation::AngularTable table = estimation::make_angular_table(medium, batches);
  table.program = kProgram;
  table.seed = seed;
  std::ofstream file(out_path, std::ios::binary);
  file << estimation::to_text(table) << std::flush;
  if (!file) return fail("write", out_path);
  std::printf("%s: %lld photons\n", out_path.c_str(), static_cast<long long>(table.photon_count));
  return 0;
}
