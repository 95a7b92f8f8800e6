// The promise, fault by fault: complete and right, or failed with its cause; and the table of it.
#include "tests/capture/fault_matrix.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <random>

#include "tests/capture/expect_promise.h"
#include "tests/capture/random_faults.h"

namespace capture {
namespace {

TEST(FaultMatrix, KeepsThePromiseAndIsTheTableOfTheReadme) {
  const std::vector<MatrixCell> cells = run_fault_matrix();
  for (const MatrixCell& cell : cells) {
    SCOPED_TRACE(matrix_rigs()[cell.rig].name + ": " + matrix_faults()[cell.fault].name + " at " +
                 matrix_places()[cell.place].name);
    for (const Trial& trial : cell.trials) expect_promise(trial);
  }
  std::ifstream in(TESTS_README);
  const std::string readme{std::istreambuf_iterator<char>(in), {}};
  EXPECT_TRUE(with_fault_matrix(readme, fault_matrix_table(cells)) == readme)
      << "run fault_matrix_table tests/README.md";
}

TEST(FaultMatrix, RandomFaultsEndCompleteOrFailedButNeverWrong) {
  int complete_count = 0;
  const char* const asked = std::getenv("SSRIG_CAPTURES");
  const int capture_count = asked == nullptr ? 1000 : std::atoi(asked);
  for (int seed = 0; seed < capture_count; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937_64 random(static_cast<std::uint64_t>(seed));
    const MatrixRig& tried = matrix_rigs()[random() % matrix_rigs().size()];
    const rig::RigFile rig_file = tried.rig_file();
    hw_sim::CameraTiming timing;
    timing.has_line_status = tried.has_line_status;
    if (rig_file.camera.bracketing == rig::Bracketing::kTriggerWidth)
      timing.has_chunks = random() % 2 == 0;
    hw_sim::FaultPlan plan = random_plan(random);
    std::erase_if(plan.faults, [&](const auto& fault) { return !tried.has_part_for(fault.kind); });
    const Trial trial = try_faults(plan, rig_file, timing);
    expect_promise(trial);
    if (HasFailure()) return;
    if (trial.outcome == Outcome::kComplete) ++complete_count;
  }
  EXPECT_GT(complete_count, capture_count * 9 / 10);
}

TEST(FaultMatrix, SamePlanSameCapture) {
  for (std::uint64_t seed = 1; seed < 6; ++seed) {
    std::mt19937_64 first(seed), second(seed);
    const Trial a = try_faults(random_plan(first), ledger_rig_file());
    const Trial b = try_faults(random_plan(second), ledger_rig_file());
    EXPECT_EQ(a.duration, b.duration);
    EXPECT_EQ(a.detected, b.detected);
    EXPECT_EQ(a.done, b.done);
    EXPECT_EQ(a.outcome, b.outcome);
  }
}

}  // namespace
}  // namespace capture
