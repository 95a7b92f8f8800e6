// The production camera class over loopback against the simulated GigE Vision device.
#include "tests/contract/camera_contract.h"

#include "tests/wire/gige/wire_bench.h"

namespace {

CameraBenchMaker bench(std::string name, rig::Bracketing bracketing, bool has_64_bit_block_ids) {
  return {std::move(name),
          [=] { return std::make_unique<WireBench>(bracketing, has_64_bit_block_ids); }};
}

INSTANTIATE_TEST_SUITE_P(
    Wire, CameraContract,
    testing::Values(bench("Sequencer16BitIds", rig::Bracketing::kSequencer, false),
                    bench("Sequencer64BitIds", rig::Bracketing::kSequencer, true),
                    bench("TriggerWidth16BitIds", rig::Bracketing::kTriggerWidth, false),
                    bench("TriggerWidth64BitIds", rig::Bracketing::kTriggerWidth, true)),
    camera_bench_name);

}  // namespace
