// Calibration on the virtual rig: its devices around hw_sim's targets, captured by the plans and
// steps of ssrig calibrate, held against its truth.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <numbers>
#include <opencv2/calib3d.hpp>

#include "capture/calibrate/calibration_plans.h"
#include "capture/calibrate/geometry_job.h"
#include "capture/calibrate/radiometry_steps.h"
#include "capture/capture_job.h"
#include "estimation/calibration/calibration_file.h"
#include "estimation/session/maps.h"
#include "hw_sim/devices/in_process_rig.h"
#include "hw_sim/world/board_world.h"
#include "tests/capture/calibrate/rendered_session.h"
#include "tests/temporary_folder.h"

namespace capture {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
namespace synthetic = estimation::testing;
namespace fs = std::filesystem;

struct Size {
  int width_px, height_px;
};
constexpr Size kSmall{392, 288}, kUsual{588, 432};
constexpr double kDistanceMm = 1030;

estimation::Calibration true_calibration(Size size = kSmall) {
  estimation::Calibration calibration =
      synthetic::make_rig(size.width_px, size.height_px, true).calibration;  // with distortion
  calibration.irradiance = estimation::Irradiance{.signal_per_us = {0.2, 0.19, 0.17},
                                                  .reference_distance_mm = kDistanceMm,
                                                  .vignetting_file = {}};
  return calibration;
}

hw_sim::Effects true_optics() {
  hw_sim::Effects effects;
  effects.blur_px = 0.6;
  effects.focus_mm = kDistanceMm;
  effects.defocus_px_per_mm = 0.02;
  effects.black_frac = 0.002;
  effects.vignetting_frac = 0.12;
  return effects;
}

rig::RigFile make_rig_file(Size size = kSmall) {
  rig::RigFile file;
  file.name = "virtual";
  file.projector.monitor = "SIM-1";
  file.projector.width_px = 1024;
  file.projector.height_px = 768;
  file.camera.pixel_format = "BayerRG12";
  file.camera.width_px = size.width_px;
  file.camera.height_px = size.height_px;
  file.sensor.black_level_dn = testing::kBlackDn;
  file.sensor.saturation_level_dn = testing::kSaturationDn;
  file.sensor.gain_e_per_dn = testing::kGain;
  file.sensor.read_noise_e = testing::kReadNoise;
  file.sequence.exposures = {std::chrono::microseconds(16667)};
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
  // The targets of a scene from its step `first` on, one a capture.
  std::unique_ptr<hw_sim::TargetWorld> world(const char* scene, std::size_t first = 0,
                                             const hw_sim::Effects& effects = true_optics()) {
    estimation::CameraInfo camera;
    camera.width_px = size_.width_px;
    camera.height_px = size_.height_px;
    camera.pixel_format = {estimation::ColorFilter::kBayerRG, 12};
    camera.black_level_dn = testing::kBlackDn;
    camera.gain_e_per_dn = testing::kGain;
    camera.read_noise_e = testing::kReadNoise;
    captures_begun_ = first;
    auto targets = hw_sim::make_target_scene(scene);
    EXPECT_TRUE(targets);
    auto made =
        hw_sim::TargetWorld::create(camera, {1024, 768, {}}, true_calibration(size_), *targets,
                                    effects, 1, [this] { return captures_begun_; });
    EXPECT_TRUE(made) << made.error().detail;
    return std::move(*made);
  }

  fs::path capture(const hw_sim::World& before, const Plan& plan, const std::string& subject) {
    ++captures_begun_;
    CaptureOptions options;
    options.subject = subject;
    options.own_plan = plan;
    options.product = CaptureProduct::kFramesAlone;
    options.directory = folder_ / "sessions";
    options.created = std::chrono::system_clock::time_point(
        std::chrono::seconds(1'790'000'000 + 60 * captures_begun_));
    rig::RigFile rig_file = make_rig_file(size_);
    rig_file.calibration_file = folder_ / "calibration.json";
    const auto job = CaptureJob::prepare(rig_file, options);
    EXPECT_TRUE(job) << job.error().message;
    if (!job) return {};
    hw_sim::InProcessRig rig(before,
                             {rig_file.projector, rig_file.trigger, rig_file.camera, {}, {}, {}});
    const CaptureResult result =
        job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, {}, {});
    EXPECT_EQ(result.exit_code, ExitCode::kDone) << result.message;
    EXPECT_FALSE(fs::exists(result.session / "maps"));
    return result.session;
  }

  Size size_ = kSmall;
  std::size_t captures_begun_ = 0;
  const test_support::TemporaryFolder scratch_;
  const fs::path& folder_ = scratch_.path();
};

TEST_F(CalibratedVirtualRig, GeometryIsTheTruth) {
  size_ = kUsual;
  // A calibration must be there before the first: a wrong one.
  estimation::Calibration nominal;
  nominal.camera.K = nominal.projector.K = estimation::Mat3(1200, 0, 300, 0, 1200, 200, 0, 0, 1);
  nominal.projector_from_camera_mm = {200, 0, 0};
  write_calibration_of(nominal, folder_ / "calibration.json");
  GeometryJob job({estimation::BoardKind::kCheckerboard, 10, 13, 15});
  hw_sim::Effects optics;
  optics.blur_px = 0.8;
  const auto board = world("board", 0, optics);
  for (int pose = 0; pose < 6; ++pose) {
    const fs::path session = capture(*board, board_plan(make_rig_file(size_)), "pose");
    const auto added = job.add_session(session);
    ASSERT_TRUE(added) << added.error().text();
  }
  job.update();
  EXPECT_THAT(job.refusals(), IsEmpty());
  ASSERT_TRUE(job.fit());
  const estimation::GeometryFit& fit = *job.fit();
  const estimation::Calibration truth = true_calibration(size_);
  estimation::Vec3 turn;
  cv::Rodrigues(fit.calibration.projector_from_camera * truth.projector_from_camera.t(), turn);
  const double shift_mm =
      cv::norm(fit.calibration.projector_from_camera_mm - truth.projector_from_camera_mm);
  std::printf("rms %.3f and %.3f px; off by %.4f degrees (%.4f), %.3f mm (%.3f)\n",
              fit.camera_rms_px, fit.projector_rms_px, cv::norm(turn) * 180 / CV_PI,
              fit.rotation_sd_deg(), shift_mm, fit.translation_sd_mm());
  EXPECT_LT(fit.camera_rms_px, 0.02);
  EXPECT_LT(fit.projector_rms_px, 0.03);
  EXPECT_LT(cv::norm(turn) * 180 / CV_PI, 0.02);
  EXPECT_LT(shift_mm, 0.15);
}

TEST_F(CalibratedVirtualRig, RadiometryIsTheTruth) {
  const fs::path calibration = folder_ / "calibration.json";
  write_calibration_of(true_calibration(), calibration);
  RadiometryInputs inputs;
  const auto targets = world("standard");
  for (const RadiometryStep& step : radiometry_steps(make_rig_file())) {
    const fs::path session = capture(*targets, step.plan, step.subject);
    if (step.plan.name != "target") {  // those take longer, and are judged below
      const auto checked = check_step(step, session, inputs, true_calibration());
      ASSERT_TRUE(checked) << step.words << ": " << checked.error().text();
      EXPECT_THAT(*checked, IsEmpty()) << step.words;
    }
    (inputs.*step.sessions).push_back(session.string());
  }
  const auto job = RadiometryJob::run(inputs, true_calibration());
  ASSERT_TRUE(job) << job.error().text();
  EXPECT_THAT(job->warnings(), IsEmpty());
  ASSERT_TRUE(job->store(calibration, std::chrono::system_clock::now()));
  std::printf("%s", job->report().c_str());
  std::ifstream file(calibration);
  const std::string text(std::istreambuf_iterator<char>(file), {});
  EXPECT_THAT(text, HasSubstr("\"gain_e_per_dn\""));
  const auto read = estimation::parse_calibration(text, calibration.string());
  ASSERT_TRUE(read) << read.error().text();
  const auto vignetting = estimation::read_exr(folder_ / *read->irradiance->vignetting_file);
  ASSERT_TRUE(vignetting);
  const double scale = std::pow(*read->irradiance->reference_distance_mm / kDistanceMm, 2);
  for (std::size_t band = 0; band < 3; ++band) {
    const double truth = true_calibration().irradiance->signal_per_us[band];
    EXPECT_NEAR(read->irradiance->signal_per_us[band] * scale / truth, 1, 0.005) << band;
    EXPECT_NEAR(read->projector_black_dn_per_us[band] * scale / truth, 0.002, 0.0001) << band;
  }
  for (const auto& [row, col] : {std::pair(384, 200), {150, 511}, {600, 800}}) {
    const double x = col - 511.5, y = row - 383.5;
    const double truth = 1 - 0.12 * (x * x + y * y) / (511.5 * 511.5 + 383.5 * 383.5);
    EXPECT_NEAR(static_cast<double>(vignetting->begin()->second.at(row, col)) / truth, 1, 0.005);
  }
  const auto& entries = std::get<estimation::TransferByDepth>(*read->stripe_transfer).entries;
  ASSERT_GE(entries.size(), 3U);
  for (const auto& entry : entries)
    for (const int n : {1, 2, 4, 6}) {
      const double k = 2 * std::numbers::pi * n / 40;
      const double blur_px = true_optics().blur_at(entry.distance_mm);
      // 0.1 px of blur either way.
      const auto contrast = [k](double px) { return std::exp(-k * k * px * px / 2); };
      for (const auto& harmonics : entry.transfer.harmonics) {
        EXPECT_GT(harmonics[static_cast<std::size_t>(n - 1)], contrast(blur_px + 0.1)) << n;
        EXPECT_LT(harmonics[static_cast<std::size_t>(n - 1)], contrast(blur_px - 0.1)) << n;
      }
    }
  // A session carries what its calibration says of itself.
  std::ifstream manifest(fs::path(inputs.opaque[0]) / "session.json");
  EXPECT_THAT(std::string(std::istreambuf_iterator<char>(manifest), {}), HasSubstr("monday"));
}

TEST_F(CalibratedVirtualRig, AForgottenCapIsTold) {
  write_calibration_of(true_calibration(), folder_ / "calibration.json");
  const RadiometryStep step = radiometry_steps(make_rig_file()).front();
  const auto lit = world("standard", 1);
  const auto checked =
      check_step(step, capture(*lit, step.plan, step.subject), {}, true_calibration());
  ASSERT_FALSE(checked);
  EXPECT_THAT(checked.error().text(), HasSubstr("not dark"));
  EXPECT_THAT(checked.error().text(), HasSubstr("cap the lens"));
}

// Its bands ripple a third of a turn apart: their mean is steady.
TEST_F(CalibratedVirtualRig, AColourWheelThatDoesNotTurnWithTheExposureIsTold) {
  write_calibration_of(true_calibration(), folder_ / "calibration.json");
  const std::vector<RadiometryStep> steps = radiometry_steps(make_rig_file());
  hw_sim::Effects wheel = true_optics();
  wheel.ripple_frac = 0.1;
  wheel.ripple_hz = 133.7;
  const auto targets = world("standard", 0, wheel);
  RadiometryInputs before;
  before.dark.push_back(capture(*targets, steps[0].plan, steps[0].subject));
  const auto checked =
      check_step(steps[1], capture(*targets, steps[1].plan, steps[1].subject), before, {});
  ASSERT_TRUE(checked) << checked.error().text();
  EXPECT_THAT(*checked, ::testing::Contains(HasSubstr("white is not steady")));
}

TEST_F(CalibratedVirtualRig, ATargetThatIsNotThereIsTold) {
  write_calibration_of(true_calibration(), folder_ / "calibration.json");
  const RadiometryStep step = radiometry_steps(make_rig_file()).back();
  const auto capped = world("standard");
  const auto checked =
      check_step(step, capture(*capped, step.plan, step.subject), {}, true_calibration());
  ASSERT_FALSE(checked);
  EXPECT_THAT(checked.error().text(), HasSubstr("enough of the target"));
}

}  // namespace
}  // namespace capture
