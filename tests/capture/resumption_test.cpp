// Takes that were interrupted, and what becomes of them: finished where nothing has moved, else
// refused and left as they are.
#include "capture/resumption.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "capture/interrupted_takes.h"
#include "estimation/session/manifest.h"
#include "tests/capture/folder_files.h"
#include "tests/capture/resumed_take.h"

namespace capture {
namespace {

using testing::HasSubstr;
using testing::Not;

TEST_F(Resumed, TakeIsListedAndFinishedAndFormsASessionLikeAnyOther) {
  const fs::path session = interrupted_take();
  const auto takes = list_interrupted_takes(rig_file_.storage.directory);
  ASSERT_EQ(takes.size(), 1U);
  EXPECT_EQ(takes[0].session, session);
  EXPECT_EQ(takes[0].slot_count, kSlotCount);
  EXPECT_GE(takes[0].good_count, 50);
  EXPECT_THAT(takes[0].text(), HasSubstr("of 160 slots are good on the disk"));
  const auto before = files_of(session);

  const CaptureResult result = capture(session);
  ASSERT_EQ(result.exit_code, ExitCode::kDone) << result.message;
  EXPECT_EQ(result.session, session);
  EXPECT_THAT(result.message,
              HasSubstr(std::to_string(takes[0].good_count) + " of them before the interruption"));
  expect_whole(session);
  EXPECT_TRUE(list_interrupted_takes(rig_file_.storage.directory).empty());
  const auto after = files_of(session);
  for (const auto& [name, bytes] : before) {
    if (!name.starts_with("frames/")) continue;
    EXPECT_EQ(after.at(name), bytes) << name << " was overwritten";
  }
  EXPECT_TRUE(after.at("journal.jsonl").starts_with(before.at("journal.jsonl")));
  EXPECT_THAT(after.at("journal.jsonl"), HasSubstr("take resumed"));
  EXPECT_TRUE(after.contains("maps/position.exr"));

  // Beside a take that was not interrupted: the same keys, patterns and files in the same order.
  const CaptureResult other = capture();
  const auto shape_of = [](const fs::path& folder) {
    std::ifstream file(folder / "session.json");
    nlohmann::ordered_json json = nlohmann::ordered_json::parse(file);
    json.erase("id");
    for (auto& frame : json["frames"])
      for (const char* key : {"frame_id", "camera_timestamp_ns", "edge_timestamp_ns", "sha256"})
        frame[key] = frame.contains(key);
    return json.dump(1);
  };
  EXPECT_EQ(shape_of(session), shape_of(other.session));
}

TEST_F(Resumed, AsOftenAsItIsInterrupted) {
  const fs::path session = interrupted_take(20);
  EXPECT_EQ(capture(session, 70).exit_code, ExitCode::kAborted);
  EXPECT_EQ(capture(session, 120).exit_code, ExitCode::kAborted);
  EXPECT_EQ(capture(session).exit_code, ExitCode::kDone);
  expect_whole(session);
}

TEST_F(Resumed, HeadThatMovedIsRefusedWithFigures) {
  const fs::path session = interrupted_take();
  auto before = files_of(session);
  const CaptureResult moved = capture(session, kSlotCount + 1, {.stripes_px = 2, .row_px = 3});
  EXPECT_EQ(moved.exit_code, ExitCode::kIncomplete);
  EXPECT_EQ(moved.state, estimation::SessionState::kInterrupted);
  EXPECT_THAT(moved.message, testing::ContainsRegex("the stripes moved by (1.9|2.0)"));
  EXPECT_THAT(moved.message, testing::ContainsRegex("moved by (2.9|3.0). px along the stripes"));
  EXPECT_THAT(moved.message, HasSubstr("mm in depth"));
  const CaptureResult dimmed = capture(session, kSlotCount + 1, {.light = 0.9});
  EXPECT_THAT(dimmed.message, HasSubstr("the projector's light changed by -10."));
  auto after = files_of(session);
  EXPECT_THAT(after["journal.jsonl"], HasSubstr("resume refused"));
  before.erase("journal.jsonl");
  after.erase("journal.jsonl");
  EXPECT_EQ(after, before) << "a take that cannot be finished stays as it is";
  const CaptureResult back = capture(session, kSlotCount + 1, {.stripes_px = 0.3});
  EXPECT_EQ(back.exit_code, ExitCode::kDone) << "the head is nearly back";
  EXPECT_THAT(back.motion, testing::StartsWith("usable: "));
}

TEST_F(Resumed, WhatDiffersIsNamed) {
  const fs::path session = interrupted_take();
  const auto before = files_of(session);
  const auto expect_refusal = [&](const std::string& what) {
    const CaptureResult result = capture(session);
    EXPECT_EQ(result.exit_code, ExitCode::kUsage);
    EXPECT_THAT(result.message, HasSubstr(what));
    EXPECT_THAT(differing_files(files_of(session), before), testing::IsEmpty());
    rig_file_ = striped_rig_file(root_);
  };
  rig_file_.sequence.exposures.back() = std::chrono::microseconds(50'000);
  expect_refusal("sequence.exposures_us was 10000 40000 and is now 10000 50000");
  rig_file_.sensor.black_level_dn = 70;
  expect_refusal("/camera/black_level was 64");
  rig_file_.sequence.is_shuffled = true;
  expect_refusal("the order of projection was 0 1 2");
  rig_file_.camera.bracketing = rig::Bracketing::kTriggerWidth;
  expect_refusal("camera.bracketing was sequencer and is now trigger_width");
  rig_file_.sequence.sync = rig::SyncMode::kCameraLine;
  expect_refusal("sequence.sync was trigger_box and is now camera_line");
  rig_file_.projector.width_px = 128;
  expect_refusal("/projector/width was 256 and is now 128");
  const std::string calibration = root_ / "other.json";
  std::ofstream(calibration) << R"({"camera": {"K": [[301, 0, 47.5], [0, 300, 35.5], [0, 0, 1]]},
    "projector": {"K": [[800, 0, 327.5], [0, 800, 95.5], [0, 0, 1]],
                  "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [-250, 0, 0]}})";
  rig_file_.calibration_file = calibration;
  expect_refusal("/calibration/camera/K was ");
}

TEST_F(Resumed, DamagedFrameIsSetAsideAndTakenAgain) {
  const fs::path session = interrupted_take();
  const fs::path damaged = session / "frames/pattern_003_bracket_1.tiff";
  const fs::path torn = session / "frames/pattern_005_bracket_0.tiff";
  std::fstream(damaged, std::ios::in | std::ios::out | std::ios::binary).seekp(900).put('\x7f');
  fs::resize_file(torn, fs::file_size(torn) / 2);
  EXPECT_EQ(capture(session).exit_code, ExitCode::kDone);
  expect_whole(session);
  EXPECT_TRUE(fs::exists(damaged.string() + ".damaged"));
  EXPECT_TRUE(fs::exists(torn.string() + ".damaged"));
}

TEST_F(Resumed, FramesThatTheJournalDoesNotKnowAreDecoded) {
  const fs::path session = interrupted_take();
  std::ifstream file(session / "journal.jsonl");
  std::string kept;
  for (std::string line; std::getline(file, line);)
    if (line.find("frame stored") == std::string::npos) kept += line + "\n";
  std::ofstream(session / "journal.jsonl") << kept << R"({"event": "frame sto)";  // a power cut
  const auto take = find_interruption(session);
  ASSERT_TRUE(take);
  EXPECT_GE(take->good_count, 50);
  const CaptureResult result = capture(session);
  EXPECT_EQ(result.exit_code, ExitCode::kDone) << result.message;
  EXPECT_THAT(result.message, HasSubstr(std::to_string(take->good_count) + " of them before"));
  expect_whole(session);
}

TEST_F(Resumed, WhereOnlyTheManifestIsMissingNothingIsShown) {
  const CaptureResult whole = capture();
  ASSERT_EQ(whole.exit_code, ExitCode::kDone);
  const std::string manifest = files_of(whole.session)["session.json"];
  change_manifest(whole.session, [](nlohmann::ordered_json& json) {
    json["state"] = "capturing";
    json["frames"] = nlohmann::ordered_json::array();
  });
  // The head has left; nobody needs it.
  EXPECT_EQ(capture(whole.session, kSlotCount + 1, {.light = 0}).exit_code, ExitCode::kDone);
  EXPECT_EQ(files_of(whole.session)["session.json"], manifest);
}

TEST_F(Resumed, OnlyWhatIsInterrupted) {
  const CaptureResult whole = capture();
  const CaptureResult complete = capture(whole.session);
  EXPECT_EQ(complete.exit_code, ExitCode::kUsage);
  EXPECT_THAT(complete.message, HasSubstr("is complete"));
  EXPECT_EQ(capture(root_ / "nowhere").exit_code, ExitCode::kUsage);

  const fs::path session = interrupted_take();
  const int journal = ::open((session / "journal.jsonl").c_str(), O_RDWR);
  ASSERT_EQ(::flock(journal, LOCK_EX), 0);  // as the process does that is capturing
  EXPECT_FALSE(find_interruption(session));
  EXPECT_THAT(capture(session).message, HasSubstr("is being captured at this moment"));
  ::close(journal);
  EXPECT_TRUE(find_interruption(session));

  fs::resize_file(session / "journal.jsonl", 0);
  EXPECT_THAT(capture(session).message, HasSubstr("does not say how it was begun"));
}

TEST_F(Resumed, FailedTakeToo) {
  rig_file_.sequence.retake_limit = 0;
  CaptureOptions options;
  options.directory = rig_file_.storage.directory;
  options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
  options.estimator.is_geometry_only = true;
  const auto job = CaptureJob::prepare(rig_file_, options);
  ASSERT_TRUE(job);
  const StripedWorld world;
  auto rig_options = in_process(rig_file_);
  hw_sim::PlannedFault torn = hw_sim::default_fault(hw_sim::FaultKind::kFrameTruncated);
  torn.place = hw_sim::FaultPlace{40, 0};
  rig_options.faults = {.faults = {torn}};
  hw_sim::InProcessRig rig(world, rig_options);
  const CaptureResult failed =
      job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, {}, {});
  ASSERT_EQ(failed.state, estimation::SessionState::kFailed);
  const CaptureResult result = capture(failed.session);
  EXPECT_EQ(result.exit_code, ExitCode::kDone) << result.message;
  expect_whole(failed.session);
}

}  // namespace
}  // namespace capture
