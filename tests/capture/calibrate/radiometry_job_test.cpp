// Sessions of darkness, exposures, the standard and opaque targets, on disk, to a calibration file.
#include "capture/calibrate/radiometry_job.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <numbers>

#include "estimation/calibration/calibration_file.h"
#include "estimation/session/maps.h"
#include "tests/capture/calibrate/rendered_session.h"
#include "tests/temporary_folder.h"

namespace capture {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
namespace synthetic = estimation::testing;
namespace fs = std::filesystem;

synthetic::SyntheticRig small_rig() {
  synthetic::SyntheticRig rig = synthetic::make_rig(392, 288, false);
  rig.camera.pixel_format = {estimation::ColorFilter::kBayerRG, 12};
  return rig;
}

std::string contents(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void write_geometry(const fs::path& file, const synthetic::SyntheticRig& rig) {
  const auto text = estimation::format_calibration(
      "", rig.calibration, {estimation::CalibrationPart::kGeometry, R"({"date": "monday"})"});
  ASSERT_TRUE(text);
  ASSERT_TRUE(estimation::save_text(file, *text));
}

// A steady scene, brighter to the right, at several exposures, with the sensor's noise.
void write_series(const fs::path& folder, const synthetic::SyntheticRig& rig, double grey_dither) {
  std::vector<testing::SessionFrame> frames;
  synthetic::NormalDeviates deviates(11);
  const auto add = [&](const estimation::PatternKind& kind, double drive, double exposure_us,
                       bool is_dark, double dither) {
    estimation::Image<float> signal(rig.camera.height_px, rig.camera.width_px);
    for (int row = 0; row < rig.camera.height_px; ++row)
      for (int col = 0; col < rig.camera.width_px; ++col) {
        double dn = is_dark ? 0 : drive * exposure_us * 0.2 * (0.1 + 0.9 * col / 392.0);
        dn *= 1 + dither * deviates.next();
        const double sd = std::sqrt(std::max(dn, 0.0) / testing::kGain +
                                    std::pow(testing::kReadNoise / testing::kGain, 2));
        signal.at(row, col) = static_cast<float>(dn + sd * deviates.next());
      }
    frames.push_back({kind, exposure_us, std::move(signal), is_dark});
  };
  const estimation::PatternKind white = estimation::White{}, black = estimation::Black{};
  const estimation::PatternKind grey =
      estimation::Fringe{estimation::Axis::kColumn, 1e7, 2.5e6};  // half of white
  for (const double exposure_us : {2000.0, 16000.0})
    for (int i = 0; i < 4; ++i) add(black, 0, exposure_us, true, 0);
  for (const double exposure_us : {2000.0, 4000.0, 8000.0, 16000.0})
    for (int i = 0; i < 4; ++i) add(white, 1, exposure_us, false, 0);
  for (int i = 0; i < 4; ++i) {
    add(black, 0.001, 16000, false, 0);
    add(grey, 0.5, 16000, false, grey_dither);
  }
  testing::write_session(folder, rig, frames);
}

std::vector<estimation::PatternKind> paper_with_white_and_black() {
  std::vector<estimation::PatternKind> kinds = synthetic::paper_kinds();
  kinds.push_back(estimation::White{});
  kinds.push_back(estimation::Black{});
  return kinds;
}

void write_target(const fs::path& folder, const synthetic::SyntheticRig& rig, double distance_mm,
                  double blur_px, const std::vector<estimation::PatternKind>& kinds) {
  synthetic::RenderSettings settings;
  settings.signal = 2500;
  settings.black = 5;
  settings.projector_blur_px = blur_px;
  settings.camera_blur_px = 0;
  settings.seed = static_cast<std::uint64_t>(distance_mm);
  const synthetic::RigidPlace place =
      synthetic::rigid({{0, 0, distance_mm}, 5, 8, 0}, synthetic::BoardShape{});
  testing::write_session(
      folder, rig,
      testing::expose_target(rig, place, testing::lit_by_projector(rig, place, 0.98), kinds,
                             settings, 16000));
}

TEST(RadiometryJob, SensorFromASeriesToHalfAPercent) {
  const synthetic::SyntheticRig rig = small_rig();
  const test_support::TemporaryFolder scratch;
  const fs::path& root = scratch.path();
  write_series(root / "series", rig, 0);
  write_geometry(root / "calibration.json", rig);
  RadiometryInputs inputs;
  inputs.series = {(root / "series").string()};
  const auto job = RadiometryJob::run(inputs, rig.calibration);
  ASSERT_TRUE(job) << job.error().text();
  EXPECT_THAT(job->warnings(), IsEmpty()) << job->report();
  ASSERT_TRUE(job->store(root / "calibration.json", std::chrono::system_clock::now()));
  const std::string text = contents(root / "calibration.json");
  EXPECT_THAT(text, HasSubstr("\"gain_e_per_dn\""));
  EXPECT_THAT(text, HasSubstr("monday"));
  EXPECT_THAT(job->report(), HasSubstr("gamma               1.00"));
}

TEST(RadiometryJob, ADitheringProjectorIsTold) {
  const synthetic::SyntheticRig rig = small_rig();
  const test_support::TemporaryFolder scratch;
  const fs::path& root = scratch.path();
  write_series(root / "series", rig, 0.05);
  RadiometryInputs inputs;
  inputs.series = {(root / "series").string()};
  const auto job = RadiometryJob::run(inputs, rig.calibration);
  ASSERT_TRUE(job) << job.error().text();
  EXPECT_THAT(job->warnings(), Contains(HasSubstr("dithers")));
}

TEST(RadiometryJob, StandardAndOpticsFromThePlansOwnPatterns) {
  const synthetic::SyntheticRig rig = small_rig();
  const test_support::TemporaryFolder scratch;
  const fs::path& root = scratch.path();
  write_target(root / "near", rig, 960, 0.6, paper_with_white_and_black());
  write_target(root / "far", rig, 1060, 1.2, synthetic::paper_kinds());
  write_geometry(root / "calibration.json", rig);
  RadiometryInputs inputs;
  inputs.standard = {(root / "near").string(), (root / "far").string()};
  inputs.opaque = {(root / "far").string(), (root / "near").string()};
  inputs.reflectance = {0.98, 0.98, 0.98};
  const auto job = RadiometryJob::run(inputs, rig.calibration);
  ASSERT_TRUE(job) << job.error().text();
  std::printf("%s", job->report().c_str());
  ASSERT_TRUE(job->write_report(root / "report"));
  const auto stored = job->store(root / "calibration.json", std::chrono::system_clock::now());
  ASSERT_TRUE(stored) << stored.error().text();
  const auto read = estimation::parse_calibration(contents(root / "calibration.json"), "file");
  ASSERT_TRUE(read) << read.error().text();
  // Rendered: 2500 DN in 16 ms at 1000 mm.
  const double expected =
      2500.0 / 16000 * std::pow(1000 / *read->irradiance->reference_distance_mm, 2);
  for (const double signal : read->irradiance->signal_per_us)
    EXPECT_NEAR(signal / expected, 1, 0.005);
  for (const double black : read->projector_black_dn_per_us)
    EXPECT_NEAR(black / (expected * 5 / 2500), 1, 0.05);
  const auto vignetting = estimation::read_exr(root / *read->irradiance->vignetting_file);
  ASSERT_TRUE(vignetting);
  EXPECT_NEAR(static_cast<double>(vignetting->begin()->second.at(300, 700)), 1, 0.005);
  const auto* depths = std::get_if<estimation::TransferByDepth>(&*read->stripe_transfer);
  ASSERT_NE(depths, nullptr);
  ASSERT_EQ(depths->entries.size(), 2U);
  EXPECT_LT(depths->entries[0].distance_mm, depths->entries[1].distance_mm);
  for (std::size_t i = 0; i < 2; ++i) {
    const double blur_px = i == 0 ? 0.6 : 1.2;
    for (const int n : {1, 2, 3, 4, 6}) {
      const double k = 2 * std::numbers::pi * n / 40;
      EXPECT_NEAR(depths->entries[i].transfer.harmonics[1][static_cast<std::size_t>(n - 1)],
                  std::exp(-k * k * blur_px * blur_px / 2), 0.005)
          << n;
    }
  }
}

TEST(RadiometryJob, SingleColoursGiveTheMatrix) {
  const test_support::TemporaryFolder scratch;
  const fs::path& root = scratch.path();
  std::ofstream(root / "primaries.json")
      << R"({"primaries": [[0.9, 0.1, 0.0], [0.1, 0.8, 0.2], [0.0, 0.1, 0.8]]})";
  write_geometry(root / "calibration.json", small_rig());
  RadiometryInputs inputs;
  inputs.chart = (root / "primaries.json").string();
  const auto job = RadiometryJob::run(inputs, small_rig().calibration);
  ASSERT_TRUE(job) << job.error().text();
  ASSERT_TRUE(job->store(root / "calibration.json", std::chrono::system_clock::now()));
  const auto read = estimation::parse_calibration(contents(root / "calibration.json"), "file");
  ASSERT_TRUE(read && read->color_matrix);
  const estimation::Vec3 red = *read->color_matrix * estimation::Vec3(0.9, 0.1, 0.0);
  EXPECT_NEAR(red[0], 1, 1e-9);
  EXPECT_NEAR(red[1], 0, 1e-9);
}

TEST(RadiometryJob, AChartThatIsNoneIsRefused) {
  const test_support::TemporaryFolder scratch;
  const fs::path& root = scratch.path();
  std::ofstream(root / "chart.json") << R"([{"camera": [1, 2]}])";
  RadiometryInputs inputs;
  inputs.chart = (root / "chart.json").string();
  const auto job = RadiometryJob::run(inputs, small_rig().calibration);
  ASSERT_FALSE(job);
  EXPECT_THAT(job.error().text(), HasSubstr("patch 0"));
}

}  // namespace
}  // namespace capture
