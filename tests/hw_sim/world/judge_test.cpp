#include "hw_sim/world/judge.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "estimation/session/maps.h"
#include "tests/hw_sim/world/test_rig.h"
#include "tests/temporary_folder.h"

namespace hw_sim {
namespace {

class Judge : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new test_support::TemporaryFolder;
    SceneOptions options;
    options.name = "flat_phantom";
    const auto world = make_world(make_test_rig(49, 36, 4), options);
    ASSERT_TRUE(world->write_truth(truth()));
  }
  static void TearDownTestSuite() { delete folder_; }
  static std::filesystem::path truth() { return folder_->path() / "truth"; }
  static std::filesystem::path maps() { return folder_->path() / "maps"; }
  // The truth as an estimate, with what the test changes about it.
  template <typename Change>
  static JudgeReport judged(const Change& change) {
    estimation::Maps estimate = *estimation::read_maps(truth());
    for (auto& band : estimate.validity)
      band = estimation::Image<std::uint32_t>(estimate.height_px, estimate.width_px);
    change(estimate);
    EXPECT_TRUE(estimation::write_maps(maps(), estimate));
    const auto report = judge(maps(), truth());
    EXPECT_TRUE(report) << (report ? "" : report.error().text());
    return report ? *report : JudgeReport{};
  }
  static test_support::TemporaryFolder* folder_;
};
test_support::TemporaryFolder* Judge::folder_ = nullptr;

TEST_F(Judge, TheTruthIsWithoutError) {
  const JudgeReport report = judged([](estimation::Maps&) {});
  EXPECT_GT(report.face.pixel_count, 300);
  EXPECT_GT(report.smooth_skin.pixel_count, 100);
  EXPECT_LT(report.smooth_skin.pixel_count, report.face.pixel_count);
  for (const SetErrors* set : {&report.face, &report.smooth_skin}) {
    for (const BandErrors& band : set->bands) {
      EXPECT_EQ(band.valid_frac, 1);
      for (const ErrorStats& stats :
           {band.sigma_a, band.sigma_s_prime, band.translucency, band.diffuse_reflectance}) {
        EXPECT_EQ(stats.median, 0);
        EXPECT_EQ(stats.percentile95, 0);
      }
    }
    EXPECT_EQ(set->position_mm.percentile95, 0);
    EXPECT_LT(set->normal_deg.percentile95, 0.05);  // floats
  }
}

TEST_F(Judge, ErrorsAreRelativeToTheTruth) {
  const JudgeReport report = judged([](estimation::Maps& maps) {
    for (float& value : maps.translucency_mm[1].samples()) value *= 1.1F;
    for (float& value : maps.sigma_a_per_mm[2].samples()) value *= 0.75F;
    for (float& value : maps.position_mm[0].samples()) value += 0.3F;
    for (float& value : maps.position_mm[2].samples()) value -= 0.4F;
  });
  EXPECT_NEAR(report.face.bands[1].translucency.median, 0.1, 1e-5);
  EXPECT_NEAR(report.face.bands[2].sigma_a.percentile95, 0.25, 1e-5);
  EXPECT_EQ(report.face.bands[0].translucency.median, 0);
  EXPECT_NEAR(report.face.position_mm.median, 0.5, 1e-3);
}

TEST_F(Judge, OutliersMoveThe95thPercentileAndNotTheMedian) {
  const JudgeReport report = judged([](estimation::Maps& maps) {
    int index = 0;
    for (float& value : maps.diffuse_reflectance[0].samples())
      if (index++ % 10 == 0) value *= 2;
  });
  EXPECT_EQ(report.face.bands[0].diffuse_reflectance.median, 0);
  EXPECT_NEAR(report.face.bands[0].diffuse_reflectance.percentile95, 1, 1e-5);
}

TEST_F(Judge, ErrorBitsAndMissingValuesAreNotValidAndWarningsAre) {
  const JudgeReport report = judged([](estimation::Maps& maps) {
    for (int row = 0; row < maps.height_px; ++row)
      for (int col = 0; col < maps.width_px; ++col) {
        if (row % 2 == 0) maps.validity[0].at(row, col) = estimation::kTooDark;
        if (row % 2 == 0)
          maps.translucency_mm[1].at(row, col) = std::numeric_limits<float>::quiet_NaN();
        maps.validity[2].at(row, col) = estimation::kPoorFit;
      }
  });
  EXPECT_NEAR(report.face.bands[0].valid_frac, 0.5, 0.03);
  EXPECT_NEAR(report.face.bands[1].valid_frac, 0.5, 0.03);
  EXPECT_EQ(report.face.bands[2].valid_frac, 1);
}

TEST_F(Judge, ReportsAsTableAndJson) {
  const JudgeReport report = judged([](estimation::Maps& maps) {
    for (float& value : maps.translucency_mm[0].samples()) value *= 1.1F;
    for (float& value : maps.sigma_a_per_mm[1].samples())
      value = std::numeric_limits<float>::quiet_NaN();
  });
  EXPECT_THAT(report.table(), testing::HasSubstr("forehead and cheeks"));
  EXPECT_THAT(report.table(), testing::HasSubstr("10.00"));
  const auto json = nlohmann::json::parse(report.json());
  EXPECT_NEAR(json["face"]["red"]["translucency_rel"]["median"].get<double>(), 0.1, 1e-5);
  EXPECT_TRUE(json["face"]["green"]["sigma_a_rel"]["median"].is_null());
  EXPECT_EQ(json["forehead_and_cheeks"]["blue"]["valid_frac"], 1);
}

TEST_F(Judge, MissingFoldersAndOtherSizesAreErrors) {
  EXPECT_FALSE(judge(folder_->path() / "nowhere", truth()));
  EXPECT_FALSE(judge(truth(), folder_->path() / "nowhere"));
  SceneOptions options;
  options.name = "sphere";
  const auto world = make_world(make_test_rig(30, 22, 4), options);
  ASSERT_TRUE(world->write_truth(folder_->path() / "small"));
  const auto report = judge(folder_->path() / "small", truth());
  ASSERT_FALSE(report);
  EXPECT_THAT(report.error().text(), testing::HasSubstr("49 x 36"));
}

}  // namespace
}  // namespace hw_sim
