// Captures of the simulated face that holds still, comes nearer, breathes, blinks or sits under a
// lamp that flickers: what the repeats of the first pattern say, against what the world did.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/capture/face_rig.h"
#include "tests/temporary_folder.h"

namespace capture {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

class FaceMotion : public testing::Test {
 protected:
  static void SetUpTestSuite() { folder_ = std::make_unique<test_support::TemporaryFolder>(); }
  static void TearDownTestSuite() { folder_.reset(); }

  // The report of a capture under such effects.
  static nlohmann::json watch(const hw_sim::Effects& effects) {
    CaptureOptions options;
    options.directory = folder_->path() / "sessions";
    options.estimator.is_geometry_only = true;  // the maps are not what is looked at
    const rig::RigFile rig_file = small_rig();
    const auto world = make_face(rig_file, {.name = "face_female",
                                            .effects = effects,
                                            .has_indirect = false,
                                            .has_identity = false,
                                            .seed = 7,
                                            .cache_folder = folder_->path() / "cache"});
    const CaptureResult result = capture_once(rig_file, *world, options);
    EXPECT_EQ(result.exit_code, ExitCode::kDone) << result.message;
    std::printf("%s\n", result.motion.c_str());
    std::ifstream file(result.session / "report/motion.json");
    return nlohmann::json::parse(file, nullptr, false);
  }

  static std::unique_ptr<test_support::TemporaryFolder> folder_;
};
std::unique_ptr<test_support::TemporaryFolder> FaceMotion::folder_;

TEST_F(FaceMotion, StillFaceIsGood) {
  const nlohmann::json report = watch({});
  EXPECT_EQ(report["verdict"], "good");
  for (const auto& repeat : report["repeats"]) {
    EXPECT_LT(repeat["stripes_projector_px"].get<double>(), 0.05);
    EXPECT_LT(repeat["head_mm"].get<double>(), 0.1);
    EXPECT_TRUE(repeat["local_changes"].empty());
  }
}

TEST_F(FaceMotion, FaceThatComesNearerIsMeasuredInMillimetres) {
  const double speed_mm_per_s = -0.15;
  const nlohmann::json report = watch({.drift_mm_per_s = {0, 0, speed_mm_per_s}});
  EXPECT_EQ(report["verdict"], "retake");
  EXPECT_THAT(report["text"].get<std::string>(), HasSubstr("the stripes moved by"));
  for (const auto& repeat : report["repeats"]) {
    const double moved_mm = std::abs(speed_mm_per_s) * repeat["elapsed_s"].get<double>();
    EXPECT_NEAR(repeat["head_mm"].get<double>(), moved_mm, 0.15 * moved_mm + 0.05);
    ASSERT_TRUE(repeat.contains("translation_mm")) << "the surface was not used";
    EXPECT_LT(repeat["translation_mm"][2].get<double>(), 0) << "nearer is less deep";
  }
}

TEST_F(FaceMotion, BreathingUnderFlickeringLightIsSeenAsMotionNotAsLight) {
  hw_sim::Effects effects;
  effects.breathing_mm = {0, 0.2, 0.4};
  effects.ambient_frac = 0.01;
  effects.flicker_frac = 0.3;
  const nlohmann::json report = watch(effects);
  EXPECT_NE(report["verdict"], "good");
  double most_mm = 0;
  for (const auto& repeat : report["repeats"]) {
    most_mm = std::max(most_mm, repeat["head_mm"].get<double>());
    EXPECT_LT(std::abs(repeat["light_frac"].get<double>()), 0.01);
  }
  EXPECT_GT(most_mm, 0.2);
  EXPECT_LT(most_mm, 1.0);  // between two of 0.4 mm to either side
}

TEST_F(FaceMotion, BlinkAtARepeatIsFoundAtTheEyes) {
  const nlohmann::json still = watch({});
  hw_sim::Effects effects;
  effects.blink_start_s = still["repeats"][1]["elapsed_s"].get<double>() - 0.1;
  effects.blink_s = 0.4;
  const nlohmann::json report = watch(effects);
  EXPECT_EQ(report["verdict"], "usable");
  EXPECT_THAT(report["text"].get<std::string>(), HasSubstr("(a blink?)"));
  EXPECT_TRUE(report["repeats"][0]["local_changes"].empty());
  EXPECT_FALSE(report["repeats"][1]["local_changes"].empty());
  EXPECT_LT(report["repeats"][1]["stripes_projector_px"].get<double>(), 0.1);
}

TEST_F(FaceMotion, BlinkOfAFewPatternsBetweenRepeatsIsFound) {
  hw_sim::Effects effects;
  effects.blink_start_s = 1.0;
  effects.blink_s = 0.15;
  const nlohmann::json report = watch(effects);
  EXPECT_EQ(report["verdict"], "usable");
  for (const auto& repeat : report["repeats"]) EXPECT_TRUE(repeat["local_changes"].empty());
  ASSERT_EQ(report["brief_changes"].size(), 1U);
  EXPECT_NEAR(report["brief_changes"][0]["elapsed_s"].get<double>(), 1.0, 0.2);
}

}  // namespace
}  // namespace capture
