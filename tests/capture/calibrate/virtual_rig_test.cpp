// Calibration on the virtual rig: captured by its devices as any capture is, held against its
// truth.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <numbers>

#include "capture/calibrate/geometry_job.h"
#include "capture/calibrate/radiometry_job.h"
#include "capture/capture_job.h"
#include "estimation/calibration/calibration_file.h"
#include "hw_sim/devices/in_process_rig.h"
#include "tests/capture/calibrate/plane_world.h"

namespace capture {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
namespace synthetic = estimation::testing;
namespace fs = std::filesystem;

const synthetic::BoardShape kShape{9, 12, 15};

rig::RigFile rig_file_for(const synthetic::SyntheticRig& rig, const fs::path& calibration) {
  rig::RigFile file;
  file.name = "virtual";
  file.projector.monitor = "SIM-1";
  file.projector.width_px = rig.projector.width_px;
  file.projector.height_px = rig.projector.height_px;
  file.camera.pixel_format = "Mono12";
  file.camera.width_px = rig.camera.width_px;
  file.camera.height_px = rig.camera.height_px;
  file.sensor.black_level_dn = testing::kBlackDn;
  file.sensor.saturation_level_dn = testing::kSaturationDn;
  file.sensor.gain_e_per_dn = testing::kGain;
  file.sensor.read_noise_e = testing::kReadNoise;
  file.sequence.exposures = {std::chrono::microseconds(16667)};
  file.calibration_file = calibration;
  return file;
}

void write_calibration_of(const estimation::Calibration& calibration, const fs::path& path) {
  const auto text = estimation::format_calibration(
      "", calibration, {estimation::CalibrationPart::kGeometry, R"({"date": "monday"})"});
  ASSERT_TRUE(text);
  ASSERT_TRUE(estimation::save_text(path, *text));
}

class CalibratedVirtualRig : public ::testing::Test {
 protected:
  fs::path capture(const testing::PlaneWorld& world, const fs::path& calibration) const {
    const rig::RigFile rig_file = rig_file_for(rig_, calibration);
    CaptureOptions options;
    options.directory = folder_ / "sessions";
    options.estimator.is_geometry_only = true;
    options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
    const auto job = CaptureJob::prepare(rig_file, options);
    EXPECT_TRUE(job) << job.error().message;
    if (!job) return {};
    hw_sim::InProcessRig rig(world,
                             {rig_file.projector, rig_file.trigger, rig_file.camera, {}, {}, {}});
    const CaptureResult result =
        job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, {}, {});
    EXPECT_EQ(result.exit_code, ExitCode::kDone) << result.message;
    return result.session;
  }

  const synthetic::SyntheticRig rig_ = synthetic::make_rig(588, 432, true);
  const testing::ScratchFolder scratch_;
  const fs::path& folder_ = scratch_.path();
};

TEST_F(CalibratedVirtualRig, GeometryIsTheTruth) {
  // A calibration must be there before the first: a wrong one.
  estimation::Calibration nominal;
  nominal.camera.K = nominal.projector.K = estimation::Mat3(1200, 0, 300, 0, 1200, 200, 0, 0, 1);
  write_calibration_of(nominal, folder_ / "nominal.json");
  GeometryJob job({estimation::BoardKind::kCheckerboard, 10, 13, 15});
  std::vector<synthetic::BoardPlace> places = synthetic::fifteen_places();
  places.resize(10);
  for (const synthetic::BoardPlace& place : places) {
    const testing::PlaneWorld world(rig_, rigid(place, kShape), synthetic::checkerboard(kShape),
                                    0.7, 0.2);
    const auto added = job.add_session(capture(world, folder_ / "nominal.json"));
    ASSERT_TRUE(added) << added.error().text();
  }
  job.update();
  EXPECT_THAT(job.refusals(), IsEmpty());
  ASSERT_TRUE(job.fit());
  const estimation::GeometryFit& fit = *job.fit();
  estimation::Vec3 turn;
  cv::Rodrigues(fit.calibration.projector_from_camera * rig_.calibration.projector_from_camera.t(),
                turn);
  const double shift_mm = cv::norm(fit.calibration.projector_from_camera_mm -
                                   rig_.calibration.projector_from_camera_mm);
  std::printf("rms %.3f and %.3f px; off by %.4f degrees (%.4f), %.3f mm (%.3f)\n",
              fit.camera_rms_px, fit.projector_rms_px, cv::norm(turn) * 180 / CV_PI,
              fit.rotation_sd_deg(), shift_mm, fit.translation_sd_mm());
  EXPECT_LT(fit.camera_rms_px, 0.2);
  EXPECT_LT(fit.projector_rms_px, 0.2);
  EXPECT_LT(cv::norm(turn) * 180 / CV_PI, 0.05);
  EXPECT_LT(shift_mm, 0.4);
}

TEST_F(CalibratedVirtualRig, RadiometryIsTheTruth) {
  const fs::path calibration = folder_ / "calibration.json";
  write_calibration_of(rig_.calibration, calibration);
  constexpr double kSignalPerUs = 0.18;
  RadiometryInputs inputs;
  inputs.reflectance = {0.95, 0.95, 0.95};
  const std::vector<std::pair<double, double>> kTargets{{950, 0.6}, {1060, 1.3}};
  for (const auto& [distance_mm, blur_px] : kTargets) {
    const synthetic::RigidPlace place = synthetic::rigid({{0, 0, distance_mm}, 4, 6, 0}, kShape);
    const testing::PlaneWorld world(rig_, place, testing::lit_by_projector(rig_, place, 0.95),
                                    blur_px, kSignalPerUs);
    inputs.opaque.push_back(capture(world, calibration).string());
  }
  inputs.standard = inputs.opaque;
  const auto job = RadiometryJob::run(inputs, rig_.calibration);
  ASSERT_TRUE(job) << job.error().text();
  ASSERT_TRUE(job->store(calibration, std::chrono::system_clock::now()));
  std::printf("%s", job->report().c_str());
  EXPECT_THAT(job->warnings(), IsEmpty());
  std::ifstream file(calibration);
  const auto read = estimation::parse_calibration(
      std::string(std::istreambuf_iterator<char>(file), {}), calibration.string());
  ASSERT_TRUE(read) << read.error().text();
  const double scale = std::pow(*read->irradiance->reference_distance_mm / 1000, 2);
  EXPECT_NEAR(read->irradiance->signal_per_us[0] * scale / kSignalPerUs, 1, 0.005);
  const auto& entries = std::get<estimation::TransferByDepth>(*read->stripe_transfer).entries;
  ASSERT_EQ(entries.size(), 2U);
  for (std::size_t i = 0; i < 2; ++i)
    for (const int n : {1, 2, 4, 6}) {
      const double k = 2 * std::numbers::pi * n / 40, blur_px = kTargets[i].second;
      // 0.1 px of blur either way.
      const auto contrast = [k](double px) { return std::exp(-k * k * px * px / 2); };
      const double found = entries[i].transfer.harmonics[0][static_cast<std::size_t>(n - 1)];
      EXPECT_GT(found, contrast(blur_px + 0.1)) << n;
      EXPECT_LT(found, contrast(blur_px - 0.1)) << n;
    }
  // A session carries what its calibration says of itself.
  std::ifstream manifest(fs::path(inputs.opaque[0]) / "session.json");
  const std::string text(std::istreambuf_iterator<char>(manifest), {});
  EXPECT_THAT(text, HasSubstr("monday"));
}

}  // namespace
}  // namespace capture
