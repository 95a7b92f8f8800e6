// Captures of a striped card in the in-process rig, interrupted and resumed.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "capture/capture_job.h"
#include "estimation/session/verify.h"
#include "tests/capture/striped_world.h"
#include "tests/temporary_folder.h"

namespace capture {

namespace fs = std::filesystem;

constexpr int kSlotCount = 2 * (40 + 2 * (2 * 8 + 4));

class Resumed : public testing::Test {
 protected:
  void SetUp() override {
    ASSERT_FALSE(root_.empty());
    rig_file_ = striped_rig_file(root_);
  }

  // To the end, or aborted once so many slots are filled.
  CaptureResult capture(const fs::path& resume = {}, int abort_after = kSlotCount + 1,
                        const Pose& pose = {}) {
    const auto job = prepare(resume);
    if (!job) return job.error();
    std::stop_source stop;
    return run(
        *job, stop.get_token(),
        [&](const CaptureProgress& progress) {
          if (progress.slots_filled >= abort_after) stop.request_stop();
        },
        pose);
  }
  tl::expected<CaptureJob, CaptureResult> prepare(const fs::path& resume = {}) const {
    CaptureOptions options;
    options.directory = rig_file_.storage.directory;
    options.subject = "Anna";
    options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
    options.resume = resume;
    options.estimator.thread_count = 1;
    options.estimator.is_geometry_only = true;  // the maps are not what is looked at
    return CaptureJob::prepare(rig_file_, options);
  }
  CaptureResult run(const CaptureJob& job, const std::stop_token& stop,
                    const OnProgress& on_progress, const Pose& pose = {}) const {
    const StripedWorld world([pose](double) { return pose; });
    hw_sim::InProcessRig rig(world, in_process(rig_file_));
    return job.run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, stop,
                   on_progress);
  }

  // A take whose process was killed: what is on the disk is what an aborted one leaves, but for the
  // manifest, which is as it was at the start.
  fs::path interrupted_take(int abort_after = 60) {
    const CaptureResult result = capture({}, abort_after);
    EXPECT_EQ(result.exit_code, ExitCode::kAborted) << result.message;
    change_manifest(result.session, [](nlohmann::ordered_json& json) {
      json["state"] = "capturing";
      json["frames"] = nlohmann::ordered_json::array();
    });
    return result.session;
  }
  static void change_manifest(const fs::path& session,
                              const std::function<void(nlohmann::ordered_json&)>& change) {
    std::ifstream file(session / "session.json");
    nlohmann::ordered_json json = nlohmann::ordered_json::parse(file);
    change(json);
    std::ofstream(session / "session.json") << json.dump(1);
  }

  static void expect_whole(const fs::path& session) {
    const auto report = estimation::verify_session(session);
    ASSERT_TRUE(report) << report.error().text();
    for (const auto& problem : report->problems) ADD_FAILURE() << problem.text();
    EXPECT_EQ(report->state, "complete");
    EXPECT_EQ(report->checked_hash_count, kSlotCount);
  }

  const test_support::TemporaryFolder folder_;
  const fs::path root_ = folder_.path();
  rig::RigFile rig_file_;
};

}  // namespace capture
