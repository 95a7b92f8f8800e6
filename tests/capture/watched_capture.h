// Whole captures of a striped subject that moves, or whose light changes, and what the watch on
// them reports.
#pragma once

#include <gtest/gtest.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <stop_token>
#include <string>

#include "capture/capture_job.h"
#include "tests/capture/striped_world.h"
#include "tests/temporary_folder.h"

namespace capture {

class WatchedCapture : public testing::Test {
 protected:
  void SetUp() override {
    ASSERT_FALSE(root_.empty());
    rig_file_ = striped_rig_file(root_);
  }

  CaptureResult capture(const PoseAt& pose_at) {
    CaptureOptions options;
    options.directory = rig_file_.storage.directory;
    options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
    options.estimator.thread_count = 2;
    options.estimator.is_geometry_only = true;  // the maps are not what is looked at
    options.resume = resume_;
    options.own_plan = own_plan_;
    const auto job = CaptureJob::prepare(rig_file_, options);
    if (!job) return job.error();
    const StripedWorld world(pose_at, subject_);
    hw_sim::InProcessOptions devices = in_process(rig_file_);
    devices.faults = faults_;
    hw_sim::InProcessRig rig(world, devices);
    std::stop_source stop;
    const CaptureResult result =
        job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, stop.get_token(),
                 [&](const CaptureProgress& progress) {
                   if (progress.slots_filled >= abort_after_) stop.request_stop();
                   if (progress.phase == CaptureProgress::Phase::kEstimating)
                     told_before_the_maps_ = progress.motion;
                   else if (!progress.motion.empty())
                     state_when_told_ = stored_state();
                   last_total_ = progress.slots_total;
                 });
    std::printf("%s\n", result.motion.c_str());
    EXPECT_EQ(result.state, abort_after_ == kToTheEnd ? estimation::SessionState::kComplete
                                                      : estimation::SessionState::kAborted)
        << result.message;
    return result;
  }
  // Of the only session, as its manifest has it now.
  std::string stored_state() const {
    for (const auto& session : std::filesystem::directory_iterator(rig_file_.storage.directory)) {
      std::ifstream file(session.path() / "session.json");
      return nlohmann::json::parse(file, nullptr, false)["state"];
    }
    return "";
  }
  static nlohmann::json report_of(const CaptureResult& result) {
    std::ifstream file(result.session / "report/motion.json");
    return nlohmann::json::parse(file, nullptr, false);
  }

  static constexpr int kToTheEnd = 1'000'000;
  const test_support::TemporaryFolder folder_;
  const std::filesystem::path root_ = folder_.path();
  rig::RigFile rig_file_;
  Subject subject_ = Subject::kHead;
  hw_sim::FaultPlan faults_;
  int abort_after_ = kToTheEnd;  // slots filled
  std::filesystem::path resume_;
  std::optional<Plan> own_plan_;
  std::string told_before_the_maps_, state_when_told_;
  int last_total_ = 0;
};

}  // namespace capture
