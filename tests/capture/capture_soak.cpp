// Captures without end: whole jobs (plan, session folder, frames, maps) on the in-process rig in
// one process, in sync modes and paces by turns, with random faults. Fails if a frame is in a wrong
// slot, if a session is not what its state says, or if memory, descriptors or threads grow.
// usage: capture_soak COUNT [SEED]
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "capture/capture_job.h"
#include "estimation/session/frame_io.h"
#include "estimation/session/manifest.h"
#include "estimation/session/verify.h"
#include "tests/capture/fault_matrix.h"
#include "tests/capture/ledger_rig.h"
#include "tests/capture/random_faults.h"
#include "tests/process_health.h"
#include "tests/temporary_folder.h"

namespace {

namespace fs = std::filesystem;

constexpr char kCalibration[] = R"({
  "camera": {"K": [[80, 0, 31.5], [0, 80, 23.5], [0, 0, 1]]},
  "projector": {"K": [[1280, 0, 511.5], [0, 1280, 383.5], [0, 0, 1]],
                "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [-250, 0, 0]},
  "irradiance": {"signal_per_us": [0.1, 0.1, 0.1], "reference_distance_mm": 1000}
})";

struct Tally {
  int complete_count = 0, failed_count = 0, frame_count = 0, fault_count = 0;
  int wrong_frame_count = 0, false_state_count = 0;
  std::vector<int> captures_of_rig = std::vector<int>(capture::matrix_rigs().size());
};

// `load` counts from 1 how often pictures were loaded: without a photodiode the latency's come
// before the take's.
bool is_its_own(const fs::path& session, const estimation::Manifest& manifest,
                const estimation::FrameRecord& record, std::uint64_t load) {
  const auto samples = estimation::read_frame(session, manifest, record.file);
  if (!samples) return false;
  const auto identity = hw_sim::decode_identity(samples->view());
  if (!identity || identity->light.size() != 1) return false;
  // The id of a picture behind a bent gamma ramp is another one.
  return (identity->light[0].picture_id & ~std::uint64_t{1}) ==
             (load << 32 | static_cast<std::uint64_t>(record.pattern + 1) << 1) &&
         static_cast<double>(identity->exposure.count()) == record.exposure_us;
}

void judge(const capture::CaptureResult& result, rig::SyncMode sync, Tally& tally) {
  const std::uint64_t load = sync == rig::SyncMode::kSoftware ? 2 : 1;
  const auto manifest = estimation::read_manifest(result.session);
  const auto verified = estimation::verify_session(result.session);
  const bool is_complete = result.state == estimation::SessionState::kComplete;
  (is_complete ? tally.complete_count : tally.failed_count) += 1;
  if (!manifest || !verified || manifest->state != result.state ||
      verified->checked_hash_count != verified->frame_count ||
      (is_complete && manifest->frames.size() != 176)) {
    ++tally.false_state_count;
    std::printf("%s: not what its state says: %s\n", result.session.c_str(),
                result.message.c_str());
    return;
  }
  for (const auto& record : manifest->frames) {
    ++tally.frame_count;
    if (is_its_own(result.session, *manifest, record, load)) continue;
    ++tally.wrong_frame_count;
    std::printf("%s: %s is another slot's\n", result.session.c_str(), record.file.c_str());
  }
}

// Writes the calibration that it names.
rig::RigFile soaked_rig_file(const capture::MatrixRig& rig, const fs::path& folder) {
  rig::RigFile rig_file = rig.rig_file();
  rig_file.path = folder / "rig.toml";
  rig_file.projector.width_px = 1024;  // the size that the paper's 88 patterns belong to
  rig_file.projector.height_px = 768;
  rig_file.calibration_file = folder / "calibration.json";
  std::ofstream(rig_file.calibration_file) << kCalibration;
  return rig_file;
}

int soak(int capture_count, std::uint64_t seed, const fs::path& folder) {
  capture::CaptureOptions options;
  options.directory = folder / "sessions";
  options.estimator.thread_count = 2;
  const hw_sim::LedgerWorld world;
  std::mt19937_64 random(seed);
  HealthLog health;
  Tally tally;
  for (int i = 0; i < capture_count; ++i) {
    options.created =
        std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000 + i));
    const std::size_t rig_number = random() % capture::matrix_rigs().size();
    ++tally.captures_of_rig[rig_number];
    const capture::MatrixRig& tried = capture::matrix_rigs()[rig_number];
    const rig::RigFile rig_file = soaked_rig_file(tried, folder);
    hw_sim::FaultPlan plan = capture::random_plan(random);
    std::erase_if(plan.faults, [&](const auto& fault) { return !tried.has_part_for(fault.kind); });
    tally.fault_count += static_cast<int>(plan.faults.size());
    const auto job = capture::CaptureJob::prepare(rig_file, options);
    if (!job) {
      std::printf("%s\n", job.error().message.c_str());
      return 1;
    }
    {
      hw_sim::InProcessRig rig(
          world, {rig_file.projector, rig_file.trigger, rig_file.camera, {}, {}, plan, tried.sync});
      const auto result =
          job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline(), &rig}, {}, {});
      judge(result, tried.sync, tally);
      fs::remove_all(result.session);
    }
    health.add(own_health());
  }
  for (std::size_t k = 0; k < tally.captures_of_rig.size(); ++k)
    std::printf("%s: %d captures\n", capture::matrix_rigs()[k].name.c_str(),
                tally.captures_of_rig[k]);
  std::printf(
      "%d captures with %d planned faults: %d complete, %d failed with their cause, %d frames\n"
      "frames in a wrong slot: %d; sessions that are not what their state says: %d\n",
      capture_count, tally.fault_count, tally.complete_count, tally.failed_count, tally.frame_count,
      tally.wrong_frame_count, tally.false_state_count);
  health.print();
  std::printf("%s\n", health.is_flat() ? "flat" : "NOT FLAT");
  return health.is_flat() && tally.wrong_frame_count == 0 && tally.false_state_count == 0 ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  const int capture_count = argc > 1 ? std::atoi(argv[1]) : 1000;
  const std::uint64_t seed = argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1;
  const test_support::TemporaryFolder folder;
  if (folder.path().empty()) return 1;
  return soak(capture_count, seed, folder.path());
}
