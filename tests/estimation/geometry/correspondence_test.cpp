#include "estimation/geometry/correspondence.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/estimation/geometry/synthetic_frames.h"

namespace estimation {
namespace {

using testing::add_gray;
using testing::add_stripes;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::paper_kinds;
using testing::SyntheticFrames;
using testing::SyntheticScene;

constexpr ProjectorInfo kProjector{1024, 768, {}};

// 176 x 200 px that cross 700 columns and 500 rows.
SyntheticScene slanted_scene() { return testing::slanted_scene(176, 200, 3.437, 2.771); }

// A white reflector near full well: 4.88 e/DN, 10 e read noise, exposures of 16.667 and 66.667 ms.
void add_noise(SyntheticScene& scene, CorrespondenceOptions& options) {
  scene.read_sd = 2e-4;
  scene.shot_dn_per_us = 2.5e-6 * 5;
  options.noise = {{std::numeric_limits<double>::infinity(), scene.read_sd * scene.read_sd,
                    scene.shot_dn_per_us}};
}

struct Errors {
  int valid_count = 0, outlier_count = 0;  // an outlier is off by more than 1.5 px
  double rms_px = 0, bias_px = 0;          // of the others
  double normalized_rms = 0;               // error over sd
};

Errors errors_of(const Image<float>& position_px, const Image<float>& sd_px,
                 const std::function<double(int, int)>& truth) {
  Errors errors;
  double squares = 0, normalized = 0, sum = 0;
  for (int row = 0; row < position_px.height_px(); ++row) {
    for (int col = 0; col < position_px.width_px(); ++col) {
      const double found = double{position_px.at(row, col)};
      if (std::isnan(found)) continue;
      ++errors.valid_count;
      const double error = found - truth(row, col);
      if (std::abs(error) > 1.5) {
        ++errors.outlier_count;
        continue;
      }
      squares += error * error;
      sum += error;
      normalized += std::pow(error / double{sd_px.at(row, col)}, 2);
    }
  }
  errors.rms_px = std::sqrt(squares / errors.valid_count);
  errors.bias_px = sum / errors.valid_count;
  errors.normalized_rms = std::sqrt(normalized / errors.valid_count);
  return errors;
}

double valid_frac(const Errors& errors, const SyntheticScene& scene) {
  return errors.valid_count / static_cast<double>(scene.height_px * scene.width_px);
}

TEST(Correspondence, PaperPlanWithoutNoiseIsExactInColumns) {
  const SyntheticScene scene = slanted_scene();
  const SyntheticFrames frames(scene, paper_kinds());
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_EQ(columns.valid_count, scene.height_px * scene.width_px);
  EXPECT_EQ(columns.outlier_count, 0);
  EXPECT_LT(columns.rms_px, 1e-3);
  EXPECT_THAT(found.notes, IsEmpty());
  // Rows have four shifts of a square wave alone: the third harmonic aliases into the phase.
  const Errors rows = errors_of(found.row_px, found.row_sd_px, scene.row_px);
  EXPECT_EQ(rows.outlier_count, 0);
  EXPECT_LT(rows.rms_px, 0.35);
}

TEST(Correspondence, StandardDeviationIsCalibrated) {
  SyntheticScene scene = slanted_scene();
  CorrespondenceOptions options;
  add_noise(scene, options);
  const SyntheticFrames frames(scene, paper_kinds());
  const auto found = decode_correspondence(frames.signals(), kProjector, options);
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_GT(valid_frac(columns, scene), 0.999);
  EXPECT_EQ(columns.outlier_count, 0);
  EXPECT_LT(columns.rms_px, 0.03);
  EXPECT_LT(std::abs(columns.bias_px), 0.002);
  EXPECT_NEAR(columns.normalized_rms, 1, 0.2);
}

TEST(Correspondence, NoOutliersAtPeriodBordersUnderSkinsBlurAndNoise) {
  for (const double blur_px : {0.7, 3.0, 6.0}) {
    for (const std::uint64_t seed : {11U, 12U, 13U}) {
      SCOPED_TRACE(::testing::Message() << "blur " << blur_px << " px, seed " << seed);
      SyntheticScene scene = slanted_scene();
      scene.blur_px = blur_px;
      scene.seed = seed;
      CorrespondenceOptions options;
      add_noise(scene, options);
      const SyntheticFrames frames(scene, paper_kinds());
      const auto found = decode_correspondence(frames.signals(), kProjector, options);
      const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
      EXPECT_EQ(columns.outlier_count, 0);
      EXPECT_GT(valid_frac(columns, scene), 0.99);
      const Errors rows = errors_of(found.row_px, found.row_sd_px, scene.row_px);
      EXPECT_EQ(rows.outlier_count, 0);
    }
  }
}

TEST(Correspondence, ColoursOfTheMosaicAgree) {
  SyntheticScene scene = slanted_scene();
  scene.gain = {1, 0.6, 0.6, 0.2};
  const SyntheticFrames frames(scene, paper_kinds());
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_EQ(columns.valid_count, scene.height_px * scene.width_px);
  EXPECT_LT(columns.rms_px, 1e-3);
}

TEST(Correspondence, AnyNumberOfBitsOnAnyProjector) {
  struct Case {
    int width_px, bits, period_px, stripe_px, step_px;
  };
  for (const Case& c : {Case{1920, 11, 40, 8, 1},
                        {640, 10, 32, 8, 4},
                        {300, 9, 16, 8, 4},
                        {2560, 12, 24, 6, 2},
                        {64, 6, 20, 5, 5},
                        {1024, 12, 40, 8, 5}}) {
    SCOPED_TRACE(::testing::Message() << c.width_px << " columns, period " << c.period_px);
    SyntheticScene scene = slanted_scene();
    scene.projector_width_px = c.width_px;
    // Beside the projector's border there is no light to complete the stripes: keep 6 px away.
    const double step = (c.width_px - 13.0) / scene.width_px;
    scene.column_px = [=](int row, int col) { return 6 + step * (col + 0.005 * row); };
    std::vector<PatternKind> kinds;
    add_gray(kinds, Axis::kColumn, c.bits - 1, 0);
    add_stripes(kinds, Axis::kColumn, c.period_px, c.stripe_px, c.step_px);
    std::reverse(kinds.begin(), kinds.end());
    const SyntheticFrames frames(scene, kinds);
    const auto found =
        decode_correspondence(frames.signals(), ProjectorInfo{c.width_px, 16, {}}, {});
    const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
    EXPECT_GT(valid_frac(columns, scene), 0.99);
    EXPECT_EQ(columns.outlier_count, 0);
    EXPECT_TRUE(found.row_px.empty());
    EXPECT_THAT(found.notes, IsEmpty());
  }
}

TEST(Correspondence, MissingLowBitsAreMadeUpForByPhases) {
  const SyntheticScene scene = slanted_scene();
  std::vector<PatternKind> kinds;
  add_gray(kinds, Axis::kColumn, 9, 3);
  add_stripes(kinds, Axis::kColumn, 40, 8, 1);
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_EQ(columns.valid_count, scene.height_px * scene.width_px);
  EXPECT_LT(columns.rms_px, 1e-3);
}

TEST(Correspondence, MissingHighBitsAreReportedAndNotGuessed) {
  const SyntheticScene scene = slanted_scene();
  std::vector<PatternKind> kinds;
  add_gray(kinds, Axis::kColumn, 7, 0);
  add_stripes(kinds, Axis::kColumn, 40, 8, 1);
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const bool has_any =
      std::any_of(found.column_px.samples().begin(), found.column_px.samples().end(),
                  [](float value) { return !std::isnan(value); });
  // Period 40 and a code that repeats every 1024 px lose some of the range, never silently.
  const Errors columns =
      has_any ? errors_of(found.column_px, found.column_sd_px, scene.column_px) : Errors{};
  EXPECT_EQ(columns.outlier_count, 0);
  EXPECT_THAT(found.notes, ::testing::ElementsAre(HasSubstr("lacks bits 9, 8")));
}

TEST(Correspondence, WithoutTheTopBitOnlyMirroredColumnsAreLostAndSaid) {
  SyntheticScene scene = slanted_scene();
  scene.projector_width_px = 500;
  scene.column_px = [](int row, int col) { return 2.0 * col + 0.3 * row; };
  std::vector<PatternKind> kinds;
  add_gray(kinds, Axis::kColumn, 7, 0);
  add_stripes(kinds, Axis::kColumn, 40, 8, 1);
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), ProjectorInfo{500, 300, {}}, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  // u and 511 - u share all bits but the top one; where both have nearly the same phase, every 20
  // columns, they cannot be told apart.
  EXPECT_GT(valid_frac(columns, scene), 0.8);
  EXPECT_EQ(columns.outlier_count, 0);
  EXPECT_THAT(found.notes, ::testing::ElementsAre(HasSubstr("lacks bits 8")));
}

TEST(Correspondence, MissingInversesAreReadAgainstTheOtherPairsOrWhite) {
  const SyntheticScene scene = slanted_scene();
  const auto expect_decoded = [&](const std::vector<PatternKind>& kinds) {
    const SyntheticFrames frames(scene, kinds);
    const auto found = decode_correspondence(frames.signals(), kProjector, {});
    const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
    EXPECT_EQ(columns.valid_count, scene.height_px * scene.width_px);
    EXPECT_LT(columns.rms_px, 1e-3);
  };
  std::vector<PatternKind> stripes;
  add_stripes(stripes, Axis::kColumn, 40, 8, 1);
  {
    SCOPED_TRACE("one pair");
    std::vector<PatternKind> kinds = stripes;
    add_gray(kinds, Axis::kColumn, 9, 9, true);
    add_gray(kinds, Axis::kColumn, 8, 0, false);
    expect_decoded(kinds);
  }
  {
    SCOPED_TRACE("white and black");
    std::vector<PatternKind> kinds = stripes;
    add_gray(kinds, Axis::kColumn, 9, 0, false);
    kinds.push_back(White{});
    kinds.push_back(Black{});
    expect_decoded(kinds);
  }
  {
    SCOPED_TRACE("only the stripes' mean");
    std::vector<PatternKind> kinds = stripes;
    add_gray(kinds, Axis::kColumn, 9, 0, false);
    expect_decoded(kinds);
  }
}

TEST(Correspondence, BitsWithoutInversesOrAnythingElseAreReadAgainstEachOther) {
  SyntheticScene scene = slanted_scene();
  scene.blur_px = 0.6;
  CorrespondenceOptions options;
  add_noise(scene, options);
  std::vector<PatternKind> kinds;
  add_gray(kinds, Axis::kColumn, 9, 0, false);
  add_gray(kinds, Axis::kRow, 9, 0, false);
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), kProjector, options);
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_GT(valid_frac(columns, scene), 0.98);
  EXPECT_LT(columns.rms_px, 0.4);
  EXPECT_EQ(columns.outlier_count, 0);
  // Noise alone is no code.
  scene.white = 0;
  const SyntheticFrames nothing(scene, kinds);
  const auto dark = decode_correspondence(nothing.signals(), kProjector, options);
  EXPECT_EQ(errors_of(dark.column_px, dark.column_sd_px, scene.column_px).valid_count, 0);
}

// Held-back sessions may hold them: the first sent noise through the decoder as if it were a phase,
// the second asked for 60 GB.
TEST(Correspondence, StripesAndFringesThatCanHaveNoPhaseAreNamedAndLeftOut) {
  SyntheticScene scene = slanted_scene();
  CorrespondenceOptions options;
  add_noise(scene, options);
  std::vector<PatternKind> kinds = paper_kinds();
  for (int shift_px = 0; shift_px < 20; shift_px += 5)
    kinds.push_back(Stripes{Axis::kColumn, 20, 20, shift_px});
  for (const double period_px : {1e9, 0.01})
    for (int i = 0; i < 4; ++i)
      kinds.push_back(Fringe{Axis::kColumn, period_px, period_px * i / 4});
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), kProjector, options);
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_GT(valid_frac(columns, scene), 0.999);
  EXPECT_EQ(columns.outlier_count, 0);
  EXPECT_THAT(found.notes, ::testing::UnorderedElementsAre(HasSubstr("lit everywhere"),
                                                           HasSubstr("flat on this projector"),
                                                           HasSubstr("finer than a projector")));
}

TEST(Correspondence, GrayCodeAloneGivesWholeColumns) {
  const SyntheticScene scene = [] {
    SyntheticScene s = slanted_scene();
    s.blur_px = 0.6;
    return s;
  }();
  std::vector<PatternKind> kinds;
  add_gray(kinds, Axis::kColumn, 9, 0);
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_GT(valid_frac(columns, scene), 0.99);
  EXPECT_LT(columns.rms_px, 0.4);
  EXPECT_EQ(columns.outlier_count, 0);
  EXPECT_THAT(found.notes, ::testing::ElementsAre(HasSubstr("whole px")));
}

TEST(Correspondence, StripesWithoutGrayCodeAreNotDecoded) {
  const SyntheticScene scene = slanted_scene();
  std::vector<PatternKind> kinds;
  add_stripes(kinds, Axis::kColumn, 40, 8, 1);
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  EXPECT_TRUE(found.column_px.empty());
  EXPECT_THAT(found.notes, ::testing::ElementsAre(HasSubstr("no Gray code")));
  EXPECT_EQ(found.validity.at(20, 20), std::uint32_t{kNoCorrespondence});
}

TEST(Correspondence, StripesWithoutGrayCodeSufficeWithinOnePeriod) {
  SyntheticScene scene = slanted_scene();
  scene.projector_width_px = 40;
  scene.column_px = [](int, int col) { return 14 + 0.06 * col; };
  std::vector<PatternKind> kinds;
  add_stripes(kinds, Axis::kColumn, 40, 8, 1);
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), ProjectorInfo{40, 30, {}}, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_EQ(columns.valid_count, scene.height_px * scene.width_px);
  EXPECT_LT(columns.rms_px, 1e-3);
}

TEST(Correspondence, FringesOfSeveralPeriodsNeedNoGrayCode) {
  const SyntheticScene scene = slanted_scene();
  std::vector<PatternKind> kinds;
  for (const double period_px : {21.5, 128.0, 1024.0}) {
    for (int i = 0; i < 5; ++i) {
      kinds.push_back(Fringe{Axis::kColumn, period_px, period_px * i / 5});
    }
  }
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_EQ(columns.valid_count, scene.height_px * scene.width_px);
  EXPECT_LT(columns.rms_px, 5e-3);
}

TEST(Correspondence, SaturatedSamplesAreLeftOut) {
  const SyntheticScene scene = slanted_scene();
  SyntheticFrames frames(scene, paper_kinds());
  constexpr std::size_t kPatternCount = 88;
  const float limit = 0.3F;
  for (std::size_t i = 0; i < kPatternCount; ++i) {
    for (float& value : frames.frame(i).samples()) {
      if (value > limit) value = std::numeric_limits<float>::quiet_NaN();
    }
  }
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_EQ(columns.outlier_count, 0);
  EXPECT_GT(valid_frac(columns, scene), 0.95);
  EXPECT_LT(columns.rms_px, 0.3);
}

// As where the short exposure of single patterns is missing: bits without an inverse are read
// against the pairs that a pixel still has.
TEST(Correspondence, SingleBitsAreReadBesidePairsWithASaturatedSide) {
  const SyntheticScene scene = slanted_scene();
  std::vector<PatternKind> kinds;
  add_gray(kinds, Axis::kColumn, 9, 8, true);
  add_gray(kinds, Axis::kColumn, 7, 0, false);
  const std::size_t code_count = kinds.size();
  add_stripes(kinds, Axis::kColumn, 40, 8, 1);
  SyntheticFrames frames(scene, kinds);
  for (std::size_t i = 2; i < code_count; ++i)
    for (float& value : frames.frame(i).samples())
      if (value > 0.3F) value = std::numeric_limits<float>::quiet_NaN();
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  // Half lit at an edge of the finest bits, a sample is as good as lost: measured 5.0%.
  EXPECT_GT(valid_frac(columns, scene), 0.945);
  EXPECT_EQ(columns.outlier_count, 0);
  EXPECT_LT(columns.rms_px, 1e-3);
}

TEST(Correspondence, LostSamplesAreTheReasonOnlyWhereTheyLeaveSomethingUnread) {
  const SyntheticScene scene = slanted_scene();
  for (const bool is_pair_lost : {false, true}) {
    std::vector<PatternKind> kinds;
    add_gray(kinds, Axis::kColumn, 6, 0);  // without the high bits nothing is placed
    add_stripes(kinds, Axis::kColumn, 40, 8, 1);
    SyntheticFrames frames(scene, kinds);
    frames.frame(0).at(50, 60) = std::numeric_limits<float>::quiet_NaN();
    if (is_pair_lost) frames.frame(1).at(50, 60) = std::numeric_limits<float>::quiet_NaN();
    const auto found = decode_correspondence(frames.signals(), kProjector, {});
    EXPECT_EQ(found.validity.at(50, 60), is_pair_lost ? kSaturated : kNoCorrespondence);
    EXPECT_EQ(found.validity.at(50, 70), kNoCorrespondence);
  }
}

TEST(Correspondence, AnAxisThatLacksBitsLeavesTheOther) {
  const SyntheticScene scene = slanted_scene();
  std::vector<PatternKind> kinds;
  for (const PatternKind& kind : paper_kinds()) {
    const auto* code = std::get_if<GrayCode>(&kind);
    if (code == nullptr || code->axis == Axis::kColumn || code->bit != 9) kinds.push_back(kind);
  }
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_EQ(columns.valid_count, scene.height_px * scene.width_px);
  EXPECT_LT(columns.rms_px, 1e-3);
  const Errors rows = errors_of(found.row_px, found.row_sd_px, scene.row_px);
  EXPECT_LT(valid_frac(rows, scene), 0.9);
  EXPECT_EQ(rows.outlier_count, 0);
  EXPECT_THAT(found.notes, ::testing::ElementsAre(HasSubstr("rows cannot be told from others")));
}

TEST(Correspondence, MissingShiftsDoNotBiasThePhase) {
  const SyntheticScene scene = slanted_scene();
  std::vector<PatternKind> kinds;
  add_gray(kinds, Axis::kColumn, 9, 0);
  for (int shift_px = 0; shift_px < 40; ++shift_px) {
    const bool is_lost = shift_px == 7 || shift_px == 8 || shift_px == 9 || shift_px == 22;
    if (!is_lost) kinds.push_back(Stripes{Axis::kColumn, 40, 8, shift_px});
  }
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_EQ(columns.valid_count, scene.height_px * scene.width_px);
  EXPECT_LT(columns.rms_px, 0.01);
}

TEST(Correspondence, BackgroundAndShadowAreNamedNotDecoded) {
  SyntheticScene scene = slanted_scene();
  CorrespondenceOptions options;
  add_noise(scene, options);
  SyntheticFrames frames(scene, paper_kinds());
  testing::NormalDeviates deviates(99);
  for (std::size_t i = 0; i < 88; ++i) {
    for (int row = 0; row < scene.height_px; ++row) {
      for (int col = 0; col < 80; ++col) {
        frames.frame(i).at(row, col) = static_cast<float>(0.002 + scene.read_sd * deviates.next());
      }
    }
  }
  const auto found = decode_correspondence(frames.signals(), kProjector, options);
  for (int row = 0; row < scene.height_px; ++row) {
    for (int col = 0; col < 80; ++col) {
      ASSERT_EQ(found.validity.at(row, col), std::uint32_t{kBackground}) << row << " " << col;
      ASSERT_TRUE(std::isnan(found.column_px.at(row, col)));
    }
  }
}

TEST(Correspondence, AWrongPixelIsRejectedByItsNeighbours) {
  const SyntheticScene scene = slanted_scene();
  SyntheticFrames frames(scene, paper_kinds());
  // One pixel sees what another, 60 px away, sees.
  for (std::size_t i = 0; i < 88; ++i) frames.frame(i).at(90, 100) = frames.frame(i).at(90, 160);
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  EXPECT_TRUE(std::isnan(found.column_px.at(90, 100)));
  EXPECT_EQ(found.validity.at(90, 100), std::uint32_t{kNoCorrespondence});
  EXPECT_FALSE(std::isnan(found.column_px.at(90, 101)));
}

TEST(Correspondence, TheSyncSquareBelongsToNoPattern) {
  const SyntheticScene scene = slanted_scene();
  const SyntheticFrames frames(scene, paper_kinds());
  ProjectorInfo projector = kProjector;
  projector.sync_square = SyncSquare{300, 300, 40, 40};
  const auto found = decode_correspondence(frames.signals(), projector, {});
  int inside_count = 0;
  for (int row = 0; row < scene.height_px; ++row) {
    for (int col = 0; col < scene.width_px; ++col) {
      const double u = scene.column_px(row, col), v = scene.row_px(row, col);
      if (u < 301 || u > 338 || v < 301 || v > 338) continue;
      ++inside_count;
      EXPECT_NE(found.validity.at(row, col), 0U);
    }
  }
  EXPECT_GT(inside_count, 50);
}

TEST(Correspondence, TwoFramesOfOnePatternAreAveraged) {
  const SyntheticScene scene = slanted_scene();
  std::vector<PatternKind> kinds = paper_kinds();
  const std::vector<PatternKind> once = kinds;
  kinds.insert(kinds.end(), once.begin(), once.begin() + 40);
  const SyntheticFrames frames(scene, kinds);
  const auto found = decode_correspondence(frames.signals(), kProjector, {});
  const Errors columns = errors_of(found.column_px, found.column_sd_px, scene.column_px);
  EXPECT_EQ(columns.valid_count, scene.height_px * scene.width_px);
  EXPECT_LT(columns.rms_px, 1e-3);
}

TEST(Correspondence, SameBitsForAnyNumberOfThreads) {
  SyntheticScene scene = slanted_scene();
  CorrespondenceOptions options;
  add_noise(scene, options);
  const SyntheticFrames frames(scene, paper_kinds());
  const auto decode = [&](std::size_t thread_count) {
    const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism,
                                            thread_count);
    return decode_correspondence(frames.signals(), kProjector, options);
  };
  const Correspondence one = decode(1), four = decode(4);
  const auto same_bits = [](const Image<float>& a, const Image<float>& b) {
    return std::equal(a.samples().begin(), a.samples().end(), b.samples().begin(),
                      [](float x, float y) {
                        return std::bit_cast<std::uint32_t>(x) == std::bit_cast<std::uint32_t>(y);
                      });
  };
  EXPECT_TRUE(same_bits(one.column_px, four.column_px));
  EXPECT_TRUE(same_bits(one.row_px, four.row_px));
  EXPECT_TRUE(same_bits(one.column_sd_px, four.column_sd_px));
}

}  // namespace
}  // namespace estimation
