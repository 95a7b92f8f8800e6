// Correspondence straight from the frames: what a camera records, in whole numbers.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <vector>

#include "estimation/geometry/correspondence.h"
#include "estimation/radiometry/merge.h"
#include "tests/estimation/geometry/synthetic_frames.h"

namespace estimation {
namespace {

using testing::add_gray;
using testing::add_stripes;
using testing::paper_kinds;
using testing::SyntheticFrames;
using testing::SyntheticScene;

constexpr ProjectorInfo kProjector{1024, 768, {}};

// No whole number of vectors wide.
SyntheticScene small_scene() { return testing::slanted_scene(45, 141, 4.437, 9.771); }

struct Sensor {
  std::vector<double> exposures_us;
  double black_dn = 0, saturation_dn = 0;
};

// Frames of every pattern at every exposure, as the sensor counts them.
class Recording {
 public:
  Recording(const SyntheticFrames& frames, const Sensor& sensor) : sensor_(sensor) {
    for (const PatternSignal& signal : frames.signals()) {
      kinds_.push_back(signal.kind);
      for (const double exposure_us : sensor.exposures_us) {
        Image<std::uint16_t> frame(signal.signal.height_px, signal.signal.width_px);
        for (int row = 0; row < frame.height_px(); ++row)
          for (int col = 0; col < frame.width_px(); ++col) {
            const double dn = sensor.black_dn + exposure_us * double{signal.signal.at(row, col)};
            frame.at(row, col) =
                static_cast<std::uint16_t>(std::lround(std::clamp(dn, 0.0, sensor.saturation_dn)));
          }
        images_.push_back(std::move(frame));
      }
    }
    const std::size_t count = sensor.exposures_us.size();
    for (std::size_t i = 0; i < images_.size(); ++i) {
      if (i % count == 0) brackets_.emplace_back();
      brackets_.back().push_back({sensor.exposures_us[i % count], images_[i].view()});
    }
  }

  std::vector<PatternSignal> frames() const {
    std::vector<PatternSignal> signals;
    for (std::size_t i = 0; i < kinds_.size(); ++i)
      signals.push_back({kinds_[i], {}, brackets_[i]});
    return signals;
  }

  std::vector<Image<float>> merged(const CameraBlack& black) const {
    std::vector<Image<float>> merged;
    for (const auto& bracket : brackets_)
      merged.push_back(merge_brackets(bracket, black, sensor_.saturation_dn, {}));
    return merged;
  }

 private:
  Sensor sensor_;
  std::vector<const PatternKind*> kinds_;
  std::vector<Image<std::uint16_t>> images_;
  std::vector<std::vector<ExposedFrame>> brackets_;  // [pattern]
};

CorrespondenceOptions options_of(const Sensor& sensor, const CameraBlack& black) {
  CorrespondenceOptions options;
  options.levels = {&black, sensor.saturation_dn};
  options.noise =
      merged_noise(sensor.exposures_us, {4.88, 10}, sensor.saturation_dn - sensor.black_dn);
  return options;
}

void expect_same(const Image<float>& a, const Image<float>& b) {
  ASSERT_EQ(a.samples().size(), b.samples().size());
  for (std::size_t i = 0; i < a.samples().size(); ++i) {
    ASSERT_EQ(std::isnan(a.samples()[i]), std::isnan(b.samples()[i])) << i;
    if (std::isnan(a.samples()[i])) continue;
    ASSERT_NEAR(a.samples()[i], b.samples()[i], 1e-3F) << i;
  }
}

// Some long exposures of the stripes are saturated, some pixels in both.
TEST(FramesDecoding, AgreesWithMergedSignalsWhateverIsSaturated) {
  const Sensor sensor{{16667, 66667}, 64, 4000};
  for (const double white : {0.05, 0.08, 0.24}) {
    SCOPED_TRACE(white);
    SyntheticScene scene = small_scene();
    scene.white = white;
    scene.read_sd = 5e-4;
    const SyntheticFrames synthetic(scene, paper_kinds());
    const Recording recording(synthetic, sensor);
    Image<std::uint16_t> dark(scene.height_px, scene.width_px, 1, 64);
    for (std::size_t i = 0; i < dark.samples().size(); i += 3) dark.samples()[i] = 65;
    std::vector<CameraBlack::Dark> darks;
    darks.push_back({16667, dark});
    for (const CameraBlack& black : {CameraBlack(64), CameraBlack(darks)}) {
      const CorrespondenceOptions options = options_of(sensor, black);
      const std::vector<Image<float>> images = recording.merged(black);
      std::vector<PatternSignal> signals = synthetic.signals();
      for (std::size_t i = 0; i < signals.size(); ++i) signals[i].signal = images[i].view();
      const Correspondence merged = decode_correspondence(signals, kProjector, options);
      const Correspondence direct = decode_correspondence(recording.frames(), kProjector, options);
      expect_same(direct.column_px, merged.column_px);
      expect_same(direct.column_sd_px, merged.column_sd_px);
      expect_same(direct.row_px, merged.row_px);
      EXPECT_TRUE(std::equal(direct.validity.samples().begin(), direct.validity.samples().end(),
                             merged.validity.samples().begin()));
    }
  }
}

struct Tally {
  int valid = 0, wrong = 0;  // wrong: off by more than 1.5 px
  double rms_px = 0;         // of the others
};

Tally tally_of(const Image<float>& column_px, const SyntheticScene& scene) {
  Tally tally;
  double squares = 0;
  for (int row = 0; row < scene.height_px; ++row)
    for (int col = 0; col < scene.width_px; ++col) {
      const double error_px = double{column_px.at(row, col)} - scene.column_px(row, col);
      if (std::isnan(error_px)) continue;
      ++tally.valid;
      if (std::abs(error_px) > 1.5) {
        ++tally.wrong;
      } else {
        squares += error_px * error_px;
      }
    }
  tally.rms_px = std::sqrt(squares / std::max(tally.valid - tally.wrong, 1));
  return tally;
}

// A camera of 8 bits whose numbers are not known, on a projector of 1280 x 800 with one axis.
TEST(FramesDecoding, EightBitsOnOneAxisOfAnyProjector) {
  const ProjectorInfo projector{1280, 800, {}};
  SyntheticScene scene = small_scene();
  scene.projector_width_px = 1280;
  scene.column_px = [](int row, int col) { return 12.3 + 8.837 * col + 0.113 * row; };
  scene.white = 0.012;
  scene.black = 0.0006;
  std::vector<PatternKind> kinds;
  add_gray(kinds, Axis::kColumn, 10, 0);
  add_stripes(kinds, Axis::kColumn, 32, 8, 4);
  const SyntheticFrames synthetic(scene, kinds);
  const Sensor sensor{{20000}, 2, 255};
  const Recording recording(synthetic, sensor);
  const CameraBlack black(2);
  const Correspondence found =
      decode_correspondence(recording.frames(), projector, options_of(sensor, black));
  const Tally tally = tally_of(found.column_px, scene);
  EXPECT_EQ(tally.wrong, 0);
  EXPECT_GT(tally.valid, scene.height_px * scene.width_px * 99 / 100);
  EXPECT_LT(tally.rms_px, 0.03);
  EXPECT_TRUE(found.row_px.empty());
}

// One bit of the code read the wrong way round wherever `is_wrong` says so.
Correspondence decode_with_wrong_bit(const SyntheticScene& scene, int bit, double min_support_frac,
                                     const std::function<bool(int row, int col)>& is_wrong) {
  const std::vector<PatternKind> kinds = paper_kinds();
  SyntheticFrames synthetic(scene, kinds);
  const auto find = [&](bool is_inverted) {
    const PatternKind kind = GrayCode{Axis::kColumn, bit, is_inverted};
    return static_cast<std::size_t>(std::find(kinds.begin(), kinds.end(), kind) - kinds.begin());
  };
  Image<float>&plain = synthetic.frame(find(false)), &inverse = synthetic.frame(find(true));
  for (int row = 0; row < scene.height_px; ++row)
    for (int col = 0; col < scene.width_px; ++col)
      if (is_wrong(row, col)) std::swap(plain.at(row, col), inverse.at(row, col));
  const Sensor sensor{{66667}, 64, 4000};
  const CameraBlack black(64);
  CorrespondenceOptions options = options_of(sensor, black);
  options.min_support_frac = min_support_frac;
  return decode_correspondence(Recording(synthetic, sensor).frames(), kProjector, options);
}

// Where the stripes' phase jumps from a period's end to the next one's beginning.
bool is_at_period_border(const SyntheticScene& scene, int row, int col) {
  return std::abs(std::remainder(scene.column_px(row, col), 40)) < 2;
}

SyntheticScene scene_of_borders() {
  SyntheticScene scene = small_scene();
  scene.column_px = [](int row, int col) { return 150.3 + 4.437 * col + 0.613 * row; };
  scene.white = 0.05;
  return scene;
}

// A bit misread at its own transition, where it has hardly any contrast: with codes and phases
// unwrapped one after the other that is a period too much or too little.
TEST(FramesDecoding, BitsMisreadAtPeriodBordersDoNotSurviveTheFusion) {
  const SyntheticScene scene = scene_of_borders();
  for (int bit = 0; bit < 10; ++bit) {
    const double run_px = std::ldexp(1, bit);
    const auto is_wrong = [&](int row, int col) {
      // Transitions lie run_px away from the middles of the lit and dark runs, at halves.
      const double past_px = std::remainder(scene.column_px(row, col) + 0.5 - run_px, 2 * run_px);
      return is_at_period_border(scene, row, col) && std::abs(past_px) < 2;
    };
    const Correspondence found = decode_with_wrong_bit(scene, bit, 0, is_wrong);
    const Tally tally = tally_of(found.column_px, scene);
    EXPECT_EQ(tally.wrong, 0) << "bit " << bit;
    EXPECT_GT(tally.valid, scene.height_px * scene.width_px * 98 / 100) << "bit " << bit;
  }
}

// At full contrast a wrong bit makes the code of another column, and where that one's phases are
// the same only the neighbours can tell.
TEST(FramesDecoding, WrongBitsAreFoundByTheFusionOrByTheNeighbours) {
  const SyntheticScene scene = scene_of_borders();
  for (int bit = 0; bit < 10; ++bit) {
    const auto is_wrong = [&](int row, int col) { return is_at_period_border(scene, row, col); };
    const Correspondence found =
        decode_with_wrong_bit(scene, bit, CorrespondenceOptions{}.min_support_frac, is_wrong);
    const Tally tally = tally_of(found.column_px, scene);
    EXPECT_EQ(tally.wrong, 0) << "bit " << bit;
    EXPECT_GT(tally.valid, scene.height_px * scene.width_px * 85 / 100) << "bit " << bit;
  }
}

}  // namespace
}  // namespace estimation
