// Takes that are resumed where their files are not as they were left.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <string>

#include "capture/interrupted_takes.h"
#include "tests/capture/folder_files.h"
#include "tests/capture/resumed_take.h"

namespace capture {
namespace {

using testing::HasSubstr;

void change_lines(const fs::path& path, const std::function<std::string(std::string)>& change) {
  std::ifstream file(path);
  std::string text;
  for (std::string line; std::getline(file, line);) text += change(line);
  std::ofstream(path) << text;
}

TEST_F(Resumed, PixelsThatOnlyTheManifestRemembersAreHeldAgainstIt) {
  const fs::path session = capture({}, 60).session;  // aborted: the manifest has its frames
  change_lines(session / "journal.jsonl", [](const std::string& line) {
    return line.find("frame stored") == std::string::npos ? line + "\n" : std::string();
  });
  const fs::path changed = session / "frames/pattern_003_bracket_1.tiff";
  std::fstream(changed, std::ios::in | std::ios::out | std::ios::binary).seekp(900).put('\x01');
  EXPECT_EQ(capture(session).exit_code, ExitCode::kDone);
  expect_whole(session);
  EXPECT_TRUE(fs::exists(changed.string() + ".damaged"));
}

TEST_F(Resumed, AFrameWrittenDownForAnotherSlotIsTakenAgain) {
  const fs::path session = interrupted_take();
  change_lines(session / "journal.jsonl", [](std::string line) {
    const bool is_it = line.find("pattern_004_bracket_0.tiff") != std::string::npos;
    if (const auto at = line.find("\"pattern\":4"); is_it && at != std::string::npos)
      line.replace(at, 11, "\"pattern\":6");
    return line + "\n";
  });
  EXPECT_EQ(capture(session).exit_code, ExitCode::kDone);
  expect_whole(session);
  EXPECT_TRUE(fs::exists(session / "frames/pattern_004_bracket_0.tiff.damaged"));
  const auto manifest = estimation::read_manifest(session);
  ASSERT_TRUE(manifest);
  for (std::size_t i = 0; i < manifest->frames.size(); ++i)
    EXPECT_EQ(manifest->frames[i].pattern, static_cast<int>(i / 2)) << manifest->frames[i].file;
}

TEST_F(Resumed, WhatIsNoFileUnderAFramesNameIsSetAside) {
  const fs::path session = interrupted_take();
  const fs::path outside = root_ / "outside.tiff";
  const auto in_place_of = [&session](const char* name) {
    fs::remove(session / "frames" / name);
    return session / "frames" / name;
  };
  fs::rename(session / "frames/pattern_002_bracket_0.tiff", outside);
  fs::create_symlink(outside, session / "frames/pattern_002_bracket_0.tiff");
  fs::create_symlink("nothing", in_place_of("pattern_003_bracket_0.tiff"));
  ASSERT_EQ(::mkfifo(in_place_of("pattern_004_bracket_0.tiff").c_str(), 0600), 0);
  fs::create_directory(in_place_of("pattern_005_bracket_0.tiff"));
  EXPECT_EQ(capture(session).exit_code, ExitCode::kDone);
  expect_whole(session);
  for (int pattern = 2; pattern <= 5; ++pattern)
    EXPECT_TRUE(fs::is_regular_file(fs::symlink_status(
        session / ("frames/pattern_00" + std::to_string(pattern) + "_bracket_0.tiff"))));
  EXPECT_TRUE(fs::exists(outside));
}

TEST_F(Resumed, AFailedTakeIsAnInterruptedOneWhileItIsResumed) {
  const fs::path session = interrupted_take();
  change_manifest(session, [](nlohmann::ordered_json& json) {
    json["state"] = "failed";
    json["failure"] = {{"code", "storage"}, {"slots", nlohmann::json::array()}, {"text", "full"}};
  });
  const auto job = prepare(session);
  ASSERT_TRUE(job) << job.error().message;
  std::string seen;  // what a kill at that moment would leave
  std::stop_source stop;
  run(*job, stop.get_token(), [&](const CaptureProgress& progress) {
    if (progress.slots_filled < 100 || !seen.empty()) return;
    seen = files_of(session)["session.json"];
    stop.request_stop();
  });
  const auto manifest = estimation::parse_manifest(seen, "seen");
  ASSERT_TRUE(manifest) << manifest.error().text();
  EXPECT_EQ(manifest->state, estimation::SessionState::kCapturing);
  EXPECT_FALSE(manifest->failure);
  EXPECT_GE(manifest->frames.size(), 50U);
}

TEST_F(Resumed, WhatAnotherFinishedMeanwhileStaysAsItIs) {
  const fs::path session = interrupted_take();
  const auto late = prepare(session);
  ASSERT_TRUE(late) << late.error().message;
  ASSERT_EQ(capture(session).exit_code, ExitCode::kDone);
  const auto finished = files_of(session);
  const CaptureResult result = run(*late, {}, {});
  EXPECT_EQ(result.exit_code, ExitCode::kStorage);
  EXPECT_THAT(result.message, HasSubstr("another ssrig has gone on with it meanwhile"));
  EXPECT_EQ(files_of(session), finished);
}

TEST_F(Resumed, NoFileIsOverwritten) {
  const auto job = prepare();
  ASSERT_TRUE(job) << job.error().message;
  fs::path planted;
  const CaptureResult result = run(*job, {}, [&](const CaptureProgress&) {
    if (!planted.empty()) return;
    for (const auto& folder : fs::directory_iterator(rig_file_.storage.directory))
      planted = folder.path() / "frames/pattern_079_bracket_1.tiff";
    std::ofstream(planted) << "precious";
  });
  EXPECT_EQ(result.exit_code, ExitCode::kStorage) << result.message;
  EXPECT_THAT(result.message, HasSubstr("is there already"));
  EXPECT_EQ(files_of(result.session)["frames/pattern_079_bracket_1.tiff"], "precious");
}

TEST_F(Resumed, AFrameThatSomebodyRemovedMeanwhileIsMissing) {
  const auto job = prepare();
  ASSERT_TRUE(job) << job.error().message;
  fs::path removed;
  const CaptureResult result = run(*job, {}, [&](const CaptureProgress& progress) {
    if (!removed.empty() || progress.slots_filled < 60) return;
    for (const auto& folder : fs::directory_iterator(rig_file_.storage.directory))
      removed = folder.path() / "frames/pattern_003_bracket_1.tiff";
    EXPECT_TRUE(fs::remove(removed));
  });
  EXPECT_EQ(result.exit_code, ExitCode::kStorage) << result.message;
  EXPECT_THAT(result.message, HasSubstr("another program has removed it since"));
  const auto manifest = estimation::read_manifest(result.session);
  ASSERT_TRUE(manifest);
  EXPECT_EQ(manifest->state, estimation::SessionState::kFailed);
  EXPECT_EQ(manifest->frames.size(), static_cast<std::size_t>(kSlotCount - 1));
  EXPECT_EQ(capture(result.session).exit_code, ExitCode::kDone);
  expect_whole(result.session);
}

TEST_F(Resumed, ThreeEqualBandsOfAMonoCameraAreOne) {
  std::ifstream file(rig_file_.calibration_file);
  auto calibration = nlohmann::ordered_json::parse(file);
  auto& signal = calibration["irradiance"]["signal_per_us"];
  ASSERT_EQ(signal.size(), 1U);
  signal = {signal[0], signal[0], signal[0]};
  std::ofstream(rig_file_.calibration_file) << calibration.dump(1);
  const fs::path session = interrupted_take();
  const CaptureResult result = capture(session);
  EXPECT_EQ(result.exit_code, ExitCode::kDone) << result.message;
  expect_whole(session);
}

}  // namespace
}  // namespace capture
