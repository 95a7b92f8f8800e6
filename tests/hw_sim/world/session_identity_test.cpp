// A whole capture by the in-process devices: every frame file holds the picture and the exposure
// that its slot names, by the frame's own word.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <set>
#include <utility>

#include "capture/capture_job.h"
#include "estimation/session/frame_io.h"
#include "hw_sim/devices/in_process_rig.h"
#include "hw_sim/world/identity_block.h"
#include "hw_sim/world/simulated_rig.h"
#include "tests/hw_sim/world/test_rig.h"
#include "tests/temporary_folder.h"

namespace hw_sim {
namespace {

// Under a light sync square and under a dark one.
std::array<std::uint32_t, 2> hashes_of(const estimation::PatternKind& kind,
                                       const rig::ProjectorSettings& projector) {
  std::array<std::uint32_t, 2> hashes{};
  for (const bool is_light : {false, true}) {
    estimation::Image<unsigned char> picture =
        estimation::render_pattern(kind, projector.height_px, projector.width_px);
    const int size_px = projector.sync_square.size_px;  // in the bottom right corner
    for (int row = picture.height_px() - size_px; row < picture.height_px(); ++row)
      for (int col = picture.width_px() - size_px; col < picture.width_px(); ++col)
        picture.at(row, col) = is_light ? 255 : 0;
    hashes[is_light ? 1 : 0] = picture_hash(picture);
  }
  return hashes;
}

TEST(SessionIdentity, EveryFrameIsTheOneItsSlotNames) {
  const auto rig_file = rig::read_rig_file(SMALL_RIG);
  ASSERT_TRUE(rig_file) << rig_file.error().detail;
  ASSERT_EQ(rig_file->projector.sync_square.corner, rig::Corner::kBottomRight);
  const auto rig = simulated_rig(*rig_file);
  ASSERT_TRUE(rig) << rig.error().detail;
  SceneOptions scene;
  scene.name = "sphere";
  scene.has_indirect = false;
  const auto world = HeadWorld::create(rig->camera, rig->projector, rig->calibration, scene);
  ASSERT_TRUE(world) << world.error().detail;
  const test_support::TemporaryFolder folder;
  capture::CaptureOptions options;
  options.directory = folder.path();
  options.product = capture::CaptureProduct::kFramesAlone;
  options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
  const auto job = capture::CaptureJob::prepare(*rig_file, options);
  ASSERT_TRUE(job) << job.error().message;
  InProcessRig devices(**world,
                       {rig_file->projector, rig_file->trigger, rig_file->camera, {}, {}, {}});
  const capture::CaptureResult result = job->run(
      {devices.projector(), devices.trigger(), devices.camera(), devices.timeline()}, {}, {});
  ASSERT_EQ(result.exit_code, capture::ExitCode::kDone) << result.message;

  const auto manifest = estimation::read_manifest(result.session);
  ASSERT_TRUE(manifest) << manifest.error().text();
  ASSERT_EQ(manifest->frames.size(), 176U);
  const IdentityBlockLayout layout{static_cast<int>(*rig->camera.black_level_dn),
                                   (1 << rig->camera.pixel_format.bit_depth) - 1};
  std::set<std::uint32_t> triggers;
  for (const estimation::FrameRecord& info : manifest->frames) {
    const auto frame = estimation::read_frame(result.session, *manifest, info.file);
    ASSERT_TRUE(frame) << frame.error().text();
    const auto identity = layout.read(std::as_const(*frame).view());
    ASSERT_TRUE(identity) << info.file;
    EXPECT_EQ(identity->exposure.count(), static_cast<std::int64_t>(info.exposure_us)) << info.file;
    EXPECT_EQ(identity->picture_count, 1) << info.file;
    const auto pattern =
        std::find_if(manifest->patterns.begin(), manifest->patterns.end(),
                     [&](const estimation::Pattern& each) { return each.index == info.pattern; });
    ASSERT_NE(pattern, manifest->patterns.end());
    const auto hashes = hashes_of(pattern->kind, rig_file->projector);
    EXPECT_TRUE(identity->picture_hash == hashes[0] || identity->picture_hash == hashes[1])
        << info.file;
    EXPECT_EQ(info.frame_id, identity->trigger_number) << info.file;  // nothing was lost
    triggers.insert(identity->trigger_number);
  }
  EXPECT_EQ(triggers.size(), 176U);
  // One after the other, behind those that the session settles with.
  EXPECT_EQ(*triggers.rbegin() - *triggers.begin(), 175U);
}

}  // namespace
}  // namespace hw_sim
