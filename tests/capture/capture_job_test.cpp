// Whole capture jobs in the ledger world: what lies on the disk afterwards.
#include "capture/capture_job.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "capture/results.h"
#include "estimation/session/frame_io.h"
#include "estimation/session/verify.h"
#include "tests/capture/folder_files.h"
#include "tests/capture/ledger_rig.h"
#include "tests/temporary_folder.h"

namespace capture {
namespace {

namespace fs = std::filesystem;
using hw_sim::FaultKind;
using testing::HasSubstr;

constexpr char kCalibration[] = R"({
  "camera": {"K": [[80, 0, 31.5], [0, 80, 23.5], [0, 0, 1]]},
  "projector": {"K": [[80, 0, 31.5], [0, 80, 23.5], [0, 0, 1]],
                "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [-250, 0, 0]},
  "irradiance": {"signal_per_us": [0.1, 0.1, 0.1], "reference_distance_mm": 1000,
                 "vignetting": "optics/vignetting.exr"}
})";

class CaptureJobTest : public testing::Test {
 protected:
  void SetUp() override {
    ASSERT_FALSE(root_.empty());
    rig_file_ = ledger_rig_file();
    rig_file_.path = root_ / "rig.toml";
    rig_file_.calibration_file = root_ / "calibration.json";
    std::ofstream(rig_file_.calibration_file) << kCalibration;
    fs::create_directories(root_ / "optics");
    const estimation::Image<float> flat(rig_file_.projector.height_px, rig_file_.projector.width_px,
                                        1, 1.0F);
    ASSERT_TRUE(estimation::write_exr(root_ / "optics/vignetting.exr", {{"Y", flat.view()}}, {}));
    options_.directory = root_ / "sessions";
    options_.subject = "Anna B/..";
    options_.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
    options_.estimator.thread_count = 2;
  }

  tl::expected<CaptureJob, CaptureResult> prepare() const {
    return CaptureJob::prepare(rig_file_, options_);
  }
  // A capture of a rig of its own, powered up for it.
  CaptureResult run(const hw_sim::FaultPlan& faults = {}, const std::stop_token& stop = {},
                    const OnProgress& on_progress = {}) const {
    const auto job = prepare();
    if (!job) return job.error();
    const hw_sim::LedgerWorld world;
    hw_sim::InProcessRig rig(
        world, {rig_file_.projector, rig_file_.trigger, rig_file_.camera, {}, {}, faults});
    return job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, stop,
                    on_progress);
  }
  const test_support::TemporaryFolder folder_;
  const fs::path root_ = folder_.path();
  rig::RigFile rig_file_;
  CaptureOptions options_;
};

TEST_F(CaptureJobTest, SessionIsWholeAndVerified) {
  const CaptureResult result = run();
  ASSERT_EQ(result.exit_code, ExitCode::kDone) << result.message;
  EXPECT_EQ(result.session.filename(), "20260921-141320-Anna_B___");
  const auto report = estimation::verify_session(result.session);
  ASSERT_TRUE(report) << report.error().text();
  for (const auto& problem : report->problems) ADD_FAILURE() << problem.text();
  EXPECT_EQ(report->state, "complete");
  const int slot_count = 2 * (40 + 2 * (2 * 6 + 4));  // six bits of Gray code for 64 px
  EXPECT_EQ(report->checked_hash_count, slot_count);
  EXPECT_TRUE(fs::exists(result.session / "calibration/vignetting.exr"));
  EXPECT_TRUE(fs::exists(result.session / "maps/validity.exr"));
  EXPECT_FALSE(result.pictures.empty());
  for (const std::string& picture : result.pictures)
    EXPECT_TRUE(fs::exists(result.session / picture)) << picture;
}

TEST_F(CaptureJobTest, FilesHoldTheFramesOfTheirSlots) {
  const CaptureResult result = run();
  const auto manifest = estimation::read_manifest(result.session);
  ASSERT_TRUE(manifest) << manifest.error().text();
  for (const auto& record : manifest->frames) {
    SCOPED_TRACE(record.file);
    const auto frame = estimation::read_frame(result.session, *manifest, record.file);
    ASSERT_TRUE(frame);
    const auto identity = hw_sim::decode_identity(frame->view());
    ASSERT_TRUE(identity);
    ASSERT_EQ(identity->light.size(), 1U);
    EXPECT_EQ(hw_sim::shown_picture(identity->light[0].picture_id).picture, record.pattern);
    EXPECT_DOUBLE_EQ(static_cast<double>(identity->exposure.count()), record.exposure_us);
    EXPECT_EQ(identity->trigger_number, record.frame_id);
  }
}

TEST_F(CaptureJobTest, SameSeedSameBytesAndNeverOverwritten) {
  const CaptureResult first = run();
  const CaptureResult second = run();
  ASSERT_EQ(first.exit_code, ExitCode::kDone) << first.message;
  ASSERT_EQ(second.exit_code, ExitCode::kDone) << second.message;
  EXPECT_EQ(second.session.filename(), first.session.filename().string() + "-2");
  auto first_files = files_of(first.session);
  auto second_files = files_of(second.session);
  // Their ids differ, being the folders' names.
  first_files.erase("session.json");
  std::string& manifest = second_files["session.json"];
  EXPECT_THAT(manifest, HasSubstr("Anna_B___-2"));
  second_files.erase("session.json");
  EXPECT_THAT(differing_files(first_files, second_files), testing::IsEmpty());
}

TEST_F(CaptureJobTest, MapsAndPicturesFromDiskAreThoseMadeLive) {
  const CaptureResult result = run();
  ASSERT_EQ(result.exit_code, ExitCode::kDone) << result.message;
  const auto manifest = estimation::read_manifest(result.session);
  const auto again = estimation::estimate_session(result.session, options_.estimator);
  ASSERT_TRUE(manifest && again);
  ASSERT_TRUE(write_results(*again, *manifest, result.session, root_ / "maps", root_ / "report"));
  EXPECT_THAT(differing_files(files_of(result.session / "maps"), files_of(root_ / "maps")),
              testing::IsEmpty());
  fs::remove(result.session / "report/motion.json");  // the capture's, not the estimate's
  EXPECT_THAT(differing_files(files_of(result.session / "report"), files_of(root_ / "report")),
              testing::IsEmpty());
}

TEST_F(CaptureJobTest, RetakesLeaveACompleteSession) {
  const hw_sim::FaultPlan faults{.faults = {fault_at(FaultKind::kFrameLost, 1, 0),
                                            fault_at(FaultKind::kTriggerMissed, 24, 1),
                                            fault_at(FaultKind::kFrameLost, 49, 1)}};
  CaptureProgress last;
  const CaptureResult result =
      run(faults, {}, [&last](const CaptureProgress& progress) { last = progress; });
  ASSERT_EQ(result.exit_code, ExitCode::kDone) << result.message;
  EXPECT_THAT(result.message, HasSubstr("retaken"));
  EXPECT_EQ(last.slots_filled, last.slots_total);
  EXPECT_EQ(last.phase, CaptureProgress::Phase::kEstimating);
  const auto journal = files_of(result.session).at("journal.jsonl");
  EXPECT_THAT(journal, HasSubstr("\"incident\":\"frame missing\""));
  EXPECT_THAT(journal, HasSubstr("\"reaction\":\"restart\""));
}

TEST_F(CaptureJobTest, AbortKeepsTheFramesSoFar) {
  std::stop_source stop;
  const CaptureResult result = run({}, stop.get_token(), [&stop](const CaptureProgress& progress) {
    if (progress.slots_filled >= 20) stop.request_stop();
  });
  EXPECT_EQ(result.exit_code, ExitCode::kAborted);
  const auto report = estimation::verify_session(result.session);
  ASSERT_TRUE(report);
  EXPECT_EQ(report->state, "aborted");
  EXPECT_EQ(report->frame_count, report->checked_hash_count);
  // Of 20 filled slots the newest two wait for the next picture to confirm the display.
  EXPECT_THAT(report->frame_count, testing::AllOf(testing::Ge(18), testing::Le(24)));
  EXPECT_FALSE(fs::exists(result.session / "maps"));
}

TEST_F(CaptureJobTest, LostDeviceIsAFailedSessionWithItsCause) {
  hw_sim::PlannedFault off = fault_at(FaultKind::kCameraRebooted, 20);
  off.duration = std::chrono::milliseconds(0);
  const CaptureResult result = run({.faults = {off}});
  EXPECT_EQ(result.exit_code, ExitCode::kDevice);
  EXPECT_THAT(result.message, HasSubstr("camera is gone"));
  const auto manifest = estimation::read_manifest(result.session);
  ASSERT_TRUE(manifest) << manifest.error().text();
  EXPECT_EQ(manifest->state, estimation::SessionState::kFailed);
  ASSERT_TRUE(manifest->failure);
  EXPECT_EQ(manifest->failure->code, "device lost");
}

TEST_F(CaptureJobTest, SlotsThatDoNotFillAreNamed) {
  const CaptureResult result = run({.faults = {fault_at(FaultKind::kFrameTruncated, 5, 0, 200)}});
  EXPECT_EQ(result.exit_code, ExitCode::kIncomplete);
  const auto manifest = estimation::read_manifest(result.session);
  ASSERT_TRUE(manifest) << manifest.error().text();
  EXPECT_THAT(manifest->failure->slots, testing::Contains("pattern 3 bracket 0"));
  EXPECT_EQ(manifest->failure->code, "frame damaged");
}

TEST_F(CaptureJobTest, WhatIsWrongBeforehandLeavesNoSession) {
  const auto exit_code = [this] {
    const auto job = prepare();
    EXPECT_FALSE(fs::exists(root_ / "sessions") && !fs::is_empty(root_ / "sessions"));
    return job ? ExitCode::kDone : job.error().exit_code;
  };
  options_.plan = "poster";
  EXPECT_EQ(exit_code(), ExitCode::kUsage);
  options_.plan = "paper";
  options_.estimator.model = "milk";
  EXPECT_EQ(exit_code(), ExitCode::kUsage);
  options_.estimator.model = "monte_carlo";
  options_.directory = rig_file_.calibration_file / "below a file";
  EXPECT_EQ(exit_code(), ExitCode::kStorage);
  options_.directory = root_ / "sessions";
  rig_file_.calibration_file = root_ / "no_such.json";
  EXPECT_EQ(exit_code(), ExitCode::kUsage);
}

TEST_F(CaptureJobTest, MissingFileOfTheCalibrationLeavesNoSession) {
  fs::remove(root_ / "optics/vignetting.exr");
  const CaptureResult result = run();
  EXPECT_NE(result.exit_code, ExitCode::kDone);
  EXPECT_THAT(result.message, HasSubstr("vignetting.exr"));
  EXPECT_TRUE(fs::is_empty(root_ / "sessions"));
}

TEST_F(CaptureJobTest, TooLittleRoomIsRefusedBeforehand) {
  rig_file_.camera.width_px = 2'000'000;
  rig_file_.camera.height_px = 2'000'000;
  const auto job = prepare();
  ASSERT_FALSE(job);
  EXPECT_EQ(job.error().exit_code, ExitCode::kStorage);
  EXPECT_THAT(job.error().message, HasSubstr("MB are free"));
}

// A file size limit is the disk that fills up under us, without needing one.
TEST_F(CaptureJobTest, DiskThatFillsUpEndsTheCaptureAsFailed) {
  struct sigaction ignore {};
  struct sigaction before_action {};
  ignore.sa_handler = SIG_IGN;
  ASSERT_EQ(::sigaction(SIGXFSZ, &ignore, &before_action), 0);
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  const rlimit full{30'000, before.rlim_max};  // the journal reaches it, and no frame does
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &full), 0);
  const CaptureResult result = run();
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &before), 0);
  ASSERT_EQ(::sigaction(SIGXFSZ, &before_action, nullptr), 0);
  EXPECT_EQ(result.exit_code, ExitCode::kStorage);
  EXPECT_THAT(result.message, HasSubstr("make room"));
  for (const auto& [name, bytes] : files_of(result.session / "frames"))
    EXPECT_GT(bytes.size(), 6144U) << name << " is not whole";
}

}  // namespace
}  // namespace capture
