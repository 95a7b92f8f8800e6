// Sessions of a board in several poses, on disk, to a calibration file.
#include "capture/calibrate/geometry_job.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>

#include "estimation/calibration/calibration_file.h"
#include "tests/capture/calibrate/rendered_session.h"
#include "tests/temporary_folder.h"

namespace capture {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
namespace synthetic = estimation::testing;
namespace fs = std::filesystem;

const synthetic::BoardShape kShape{7, 9, 18};
const estimation::Board kBoard{estimation::BoardKind::kCheckerboard, 8, 10, 18};

synthetic::SyntheticRig small_rig() {
  synthetic::SyntheticRig rig = synthetic::make_rig(588, 432, true);
  rig.camera.pixel_format = {estimation::ColorFilter::kBayerRG, 12};
  return rig;
}

void write_pose(const fs::path& folder, const synthetic::SyntheticRig& rig,
                const synthetic::BoardPlace& place, std::uint64_t seed) {
  synthetic::RenderSettings settings;
  settings.signal = 3000;
  settings.seed = seed;
  settings.site_gain = {0.7, 1, 1, 0.6};
  testing::write_session(
      folder, rig,
      testing::expose_target(rig, rigid(place, kShape), synthetic::checkerboard(kShape),
                             synthetic::board_kinds(), settings, 16667));
}

std::string contents(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

TEST(GeometryJob, TwelveSessionsBecomeACalibrationFileThatSessionsCarry) {
  const synthetic::SyntheticRig rig = small_rig();
  const test_support::TemporaryFolder scratch;
  const fs::path& root = scratch.path();
  GeometryJob job(kBoard);
  std::vector<synthetic::BoardPlace> places = synthetic::fifteen_places();
  places.resize(12);
  for (std::size_t i = 0; i < places.size(); ++i) {
    const fs::path folder = root / ("pose_" + std::to_string(i + 1));
    write_pose(folder, rig, places[i], i + 1);
    const auto added = job.add_session(folder);
    ASSERT_TRUE(added) << added.error().text();
  }
  job.update();
  EXPECT_THAT(job.refusals(), IsEmpty());
  ASSERT_TRUE(job.fit());
  EXPECT_LT(job.fit()->camera_rms_px, 0.2);
  EXPECT_LT(job.fit()->projector_rms_px, 0.2);
  const fs::path file = root / "rig" / "calibration.json";
  const auto kept = job.store(file, std::chrono::system_clock::now());
  ASSERT_TRUE(kept) << kept.error().text();
  EXPECT_THAT(kept->string(), IsEmpty());
  const auto read = estimation::parse_calibration(contents(file), file.string());
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_NEAR(read->camera.K(0, 0) / rig.calibration.camera.K(0, 0), 1, 0.003);
  EXPECT_LT(cv::norm(read->projector_from_camera_mm - rig.calibration.projector_from_camera_mm), 1);
  EXPECT_THAT(estimation::extra_calibration_keys(contents(file)), HasSubstr("pose_12"));
  const auto written = job.write_report(root / "report");
  ASSERT_TRUE(written) << written.error().text();
  for (const char* name : {"report.txt", "report.html", "pose_errors.png", "camera_coverage.png",
                           "projector_coverage.png"})
    EXPECT_TRUE(fs::exists(root / "report" / name)) << name;
  EXPECT_THAT(contents(root / "report" / "report.txt"), HasSubstr("pose_7"));
}

TEST(GeometryJob, ASessionWithoutTheBoardLeavesTheOthersAsTheyWere) {
  const synthetic::SyntheticRig rig = small_rig();
  const test_support::TemporaryFolder scratch;
  const fs::path& root = scratch.path();
  write_pose(root / "good", rig, {{0, 0, 1000}, 0, 0, 0}, 1);
  testing::write_session(root / "blank", rig,
                         testing::expose_target(
                             rig, synthetic::rigid({}, kShape), [](double, double) { return 0.5; },
                             synthetic::board_kinds(), {.signal = 3000}, 16667));
  GeometryJob job(kBoard);
  ASSERT_TRUE(job.add_session(root / "good"));
  const auto blank = job.add_session(root / "blank");
  ASSERT_FALSE(blank);
  EXPECT_THAT(blank.error().text(), HasSubstr("blank"));
  EXPECT_FALSE(job.add_session(root / "nowhere"));
  EXPECT_EQ(job.pose_count(), 1U);
  job.update();
  EXPECT_FALSE(job.fit());
  ASSERT_FALSE(job.refusals().empty());
  EXPECT_THAT(job.refusals()[0], HasSubstr("1 poses"));
  EXPECT_THAT(job.report(), HasSubstr("the next pose would be"));
}

}  // namespace
}  // namespace capture
