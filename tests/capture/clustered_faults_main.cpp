// Captures under clusters of faults, seed after seed, in every rig or one of them; prints those
// that break the promise, and a line a rig. Fails if there are any. usage: capture_clusters COUNT
// [FIRST_SEED] [RIG_NUMBER]
#include <cstdio>
#include <cstdlib>

#include "tests/capture/clustered_faults.h"

int main(int argc, char** argv) {
  const std::uint64_t count = argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 1000;
  const std::uint64_t first = argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1;
  const int only = argc > 3 ? std::atoi(argv[3]) : -1;
  bool is_kept = true;
  for (std::size_t number = 0; number < capture::cluster_rigs().size(); ++number) {
    if (only >= 0 && static_cast<std::size_t>(only) != number) continue;
    const capture::MatrixRig& rig = capture::cluster_rigs()[number];
    int complete_count = 0, wrong_count = 0, false_count = 0, hung_count = 0, causeless_count = 0;
    for (std::uint64_t seed = first; seed < first + count; ++seed) {
      const capture::Cluster cluster = capture::draw_cluster(rig, seed);
      const capture::Trial trial = capture::try_cluster(cluster);
      const bool is_causeless = trial.outcome == capture::Outcome::kFailed && trial.text.empty();
      if (trial.outcome == capture::Outcome::kComplete) ++complete_count;
      if (trial.wrong_frame_count > 0) ++wrong_count;
      if (trial.is_falsely_complete) ++false_count;
      if (trial.is_hung) ++hung_count;
      if (is_causeless) ++causeless_count;
      if (trial.wrong_frame_count == 0 && !trial.is_falsely_complete && !trial.is_hung &&
          !is_causeless)
        continue;
      is_kept = false;
      std::printf("rig %zu seed %llu: %d frames wrong; %s\n", number,
                  static_cast<unsigned long long>(seed), trial.wrong_frame_count,
                  cluster.text().c_str());
    }
    std::printf(
        "%s: %llu captures from seed %llu: %d complete, %d with a frame in a wrong slot, "
        "%d falsely complete, %d hung, %d failed without a cause\n",
        rig.name.c_str(), static_cast<unsigned long long>(count),
        static_cast<unsigned long long>(first), complete_count, wrong_count, false_count,
        hung_count, causeless_count);
    std::fflush(stdout);
  }
  return is_kept ? 0 : 1;
}
