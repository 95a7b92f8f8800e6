// Whole captures in which a wrong picture comes with flawless evidence by time: the square flips,
// the edge comes, the frame has its number, but the display shows what it showed before.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <utility>

#include "capture/capture_job.h"
#include "capture/stored_pictures.h"
#include "capture/take.h"
#include "estimation/session/verify.h"
#include "tests/capture/striped_world.h"
#include "tests/temporary_folder.h"

namespace capture {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;

// Under some pictures, by their place in the order of showing (0 is the priming), a share of the
// light is that of the picture before; for so many showings of the picture.
struct Stale {
  std::set<int> showings;
  double share_frac = 1;
  int times = 1;
};

class StaleWorld final : public hw_sim::World {
 public:
  explicit StaleWorld(Stale stale) : stale_(std::move(stale)) {}
  int width_px() const override { return world_.width_px(); }
  int height_px() const override { return world_.height_px(); }
  int channel_count() const override { return 1; }
  void expose(const hw_sim::Exposure& exposure,
              estimation::ImageView<std::uint16_t> frame_dn) const override {
    world_.expose(as_shown(exposure), frame_dn);
  }

 private:
  hw_sim::Exposure as_shown(hw_sim::Exposure exposure) const {
    const std::lock_guard lock(mutex_);
    const auto asked = exposure.light.back().picture;
    if (asked != shown_) {
      before_ = std::exchange(shown_, asked);
      ++showing_;
      if (stale_.showings.contains(showing_)) bad_.push_back({asked->brightness, 0});
      is_stale_ = false;
      for (Bad& bad : bad_) {
        if (!std::ranges::equal(bad.brightness.samples(), asked->brightness.samples())) continue;
        is_stale_ = bad.count++ < stale_.times;
      }
    }
    if (!is_stale_ || !before_) return exposure;
    std::vector<hw_sim::LightSegment> light;
    for (hw_sim::LightSegment segment : exposure.light) {
      const std::chrono::nanoseconds whole = segment.duration;
      segment.duration =
          std::chrono::duration_cast<std::chrono::nanoseconds>(whole * stale_.share_frac);
      segment.picture = before_;
      light.push_back(segment);
      segment.duration = whole - segment.duration;
      segment.picture = asked;
      light.push_back(segment);
    }
    exposure.light = light;
    return exposure;
  }

  struct Bad {
    estimation::Image<unsigned char> brightness;
    int count = 0;
  };
  const StripedWorld world_;
  const Stale stale_;
  mutable std::mutex mutex_;
  mutable std::shared_ptr<const hw_sim::Picture> shown_,
      before_;  // guarded by mutex_, as all below
  mutable std::vector<Bad> bad_;
  mutable int showing_ = -1;
  mutable bool is_stale_ = false;
};

class PictureCapture : public testing::Test {
 protected:
  void SetUp() override {
    ASSERT_FALSE(root_.empty());
    rig_file_ = striped_rig_file(root_);
    rig_file_.sequence.is_shuffled = true;
  }

  CaptureResult capture(const Stale& stale, const fs::path& resume = {}) {
    CaptureOptions options;
    options.directory = rig_file_.storage.directory;
    options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
    options.estimator.thread_count = 2;
    options.estimator.is_geometry_only = true;  // the maps are not what is looked at
    options.resume = resume;
    const auto job = CaptureJob::prepare(rig_file_, options);
    if (!job) return job.error();
    const StaleWorld world(stale);
    hw_sim::InProcessRig rig(world, in_process(rig_file_));
    return job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, {}, {});
  }
  // Showing 1 is the first of the order.
  int pattern_at(int showing) const {
    const auto plan = make_plan("paper", rig_file_.projector, rig_file_.sequence);
    const Take take = make_take(*plan, rig_file_.sequence.repeat_every);
    return take.entry({take.plan.order[static_cast<std::size_t>(showing - 1)], 0}).pattern;
  }
  static int set_aside_count(const CaptureResult& result) {
    int count = 0;
    for (const auto& file : fs::directory_iterator(result.session / "frames"))
      count += file.path().string().find(".wrong_picture") != std::string::npos ? 1 : 0;
    return count;
  }
  static std::string text_of(const fs::path& path) {
    std::ifstream file(path);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  static nlohmann::json motion_of(const CaptureResult& result) {
    return nlohmann::json::parse(text_of(result.session / "report/motion.json"), nullptr, false);
  }
  static std::set<int> retaken_patterns(const CaptureResult& result) {
    std::set<int> patterns;
    const nlohmann::json motion = motion_of(result);
    for (const auto& each : motion["pictures"]["retaken"])
      patterns.insert(each["pattern"].get<int>());
    return patterns;
  }

  const test_support::TemporaryFolder folder_;
  const fs::path root_ = folder_.path();
  rig::RigFile rig_file_;
};

TEST_F(PictureCapture, AStalePictureIsTakenAgainAndItsFilesAreKeptAside) {
  // The first, one of the sweep, the first of the code, and a complement.
  const std::set<int> showings{1, 9, 43, 51};
  const CaptureResult result = capture({.showings = showings});
  EXPECT_EQ(result.state, estimation::SessionState::kComplete) << result.message;
  EXPECT_THAT(result.message, HasSubstr("160 of 160 slots filled"));
  EXPECT_THAT(result.message, HasSubstr("again because the first did not show its pattern"));
  const std::set<int> retaken = retaken_patterns(result);
  for (const int showing : showings)
    EXPECT_TRUE(retaken.contains(pattern_at(showing))) << "showing " << showing;
  EXPECT_LE(retaken.size(), showings.size() + 1) << "a complement";
  EXPECT_EQ(set_aside_count(result), static_cast<int>(2 * retaken.size()));
  const std::string journal = text_of(result.session / "journal.jsonl");
  EXPECT_THAT(journal, HasSubstr("\"event\":\"frame set aside\""));
  EXPECT_THAT(journal, HasSubstr("\"event\":\"pictures checked\""));
  const auto verified = estimation::verify_session(result.session);
  ASSERT_TRUE(verified);
  EXPECT_TRUE(verified->problems.empty());
  EXPECT_EQ(verified->frame_count, 160);
  const auto stored = check_stored_pictures(result.session);
  ASSERT_TRUE(stored);
  EXPECT_THAT(stored->wrong, IsEmpty()) << stored->text();
}

TEST_F(PictureCapture, TheVerdictOnMotionRestsOnTheFramesThatCount) {
  for (const double share_frac : {1.0, 0.5}) {  // of the priming's black, in the first showing
    SCOPED_TRACE(share_frac);
    const CaptureResult result = capture({.showings = {1}, .share_frac = share_frac});
    EXPECT_EQ(retaken_patterns(result), std::set<int>{pattern_at(1)});
    EXPECT_THAT(result.motion, StartsWith("good: "));
    EXPECT_EQ(motion_of(result)["verdict"], "good");
    // The one that was to show the square's other level is a repeat like the others now.
    EXPECT_EQ(motion_of(result)["repeats"].size(), 6U);
  }
}

TEST_F(PictureCapture, ARepeatAmongWrongPicturesSaysNothingAndOneFollowsTheRetakes) {
  const std::set<int> showings{21, 22, 23, 24, 25, 26, 27};
  ASSERT_EQ(pattern_at(24), pattern_at(1)) << "not the repeat";
  const CaptureResult result = capture({.showings = showings});
  EXPECT_EQ(result.state, estimation::SessionState::kComplete) << result.message;
  std::set<int> wrong;
  for (const int showing : showings)
    if (showing != 24) wrong.insert(pattern_at(showing));
  EXPECT_THAT(retaken_patterns(result), testing::IsSupersetOf(wrong));
  EXPECT_LE(retaken_patterns(result).size(), wrong.size() + 1) << "a neighbour of the run";
  EXPECT_THAT(result.motion, StartsWith("good: "));
  EXPECT_EQ(motion_of(result)["repeats"].size(), 4U);
}

TEST_F(PictureCapture, AnExposureThatStraddledTheSwapIsTakenAgain) {
  const CaptureResult result = capture({.showings = {14, 48}, .share_frac = 0.4});
  EXPECT_EQ(result.state, estimation::SessionState::kComplete) << result.message;
  const std::set<int> retaken = retaken_patterns(result);
  EXPECT_EQ(retaken, (std::set<int>{pattern_at(14), pattern_at(48)}));
}

TEST_F(PictureCapture, APictureThatIsNeverShownFailsTheCaptureWhichAnotherTimeFinishes) {
  const CaptureResult failed = capture({.showings = {9}, .times = 1000});
  EXPECT_EQ(failed.state, estimation::SessionState::kFailed);
  EXPECT_EQ(failed.exit_code, ExitCode::kIncomplete);
  EXPECT_THAT(failed.message, HasSubstr("frames of pattern " + std::to_string(pattern_at(9)) +
                                        " do not show their pictures"));
  const auto manifest = estimation::read_manifest(failed.session);
  ASSERT_TRUE(manifest);
  ASSERT_TRUE(manifest->failure);
  EXPECT_EQ(manifest->failure->code, "wrong picture");
  EXPECT_EQ(manifest->failure->slots.size(), 2U);
  const int aside_count = set_aside_count(failed);
  EXPECT_EQ(aside_count, 2 * rig_file_.sequence.retake_limit);
  const CaptureResult finished = capture({}, failed.session);
  EXPECT_EQ(finished.state, estimation::SessionState::kComplete) << finished.message;
  EXPECT_EQ(set_aside_count(finished), aside_count + 2) << "nothing is lost or overwritten";
  const auto stored = check_stored_pictures(finished.session);
  ASSERT_TRUE(stored);
  EXPECT_THAT(stored->wrong, IsEmpty()) << stored->text();
}

TEST_F(PictureCapture, FilesThatChangedPlacesAreFoundInTheSession) {
  const CaptureResult result = capture({});
  ASSERT_EQ(result.state, estimation::SessionState::kComplete) << result.message;
  EXPECT_EQ(set_aside_count(result), 0);
  const auto manifest = estimation::read_manifest(result.session);
  ASSERT_TRUE(manifest);
  fs::copy_file(result.session / manifest->frames[16].file,
                result.session / manifest->frames[30].file, fs::copy_options::overwrite_existing);
  const auto stored = check_stored_pictures(result.session);
  ASSERT_TRUE(stored);
  ASSERT_EQ(stored->wrong.size(), 1U) << stored->text();
  EXPECT_EQ(stored->wrong[0].pattern, 15);
  EXPECT_EQ(name_patterns(*stored), "pattern 15");
}

}  // namespace
}  // namespace capture
