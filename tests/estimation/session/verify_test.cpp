#include "estimation/session/verify.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "estimation/session/frame_io.h"
#include "estimation/session/maps.h"
#include "session_folder.h"

namespace estimation {
namespace {

namespace fs = std::filesystem;
using testing::Contains;
using testing::Each;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

VerifyReport verified(const fs::path& session) {
  const auto report = verify_session(session);
  EXPECT_TRUE(report) << report.error().text();
  return report.value_or(VerifyReport{});
}

std::vector<std::string> texts(const VerifyReport& report) {
  std::vector<std::string> lines;
  for (const InputError& problem : report.problems) lines.push_back(problem.text());
  return lines;
}

// The only problem of a session; it names the pointer and has the part.
void expect_one_problem(const BreakableSession& session, const std::string& pointer,
                        const std::string& part) {
  session.save();
  const VerifyReport report = verified(session.path());
  ASSERT_EQ(report.problems.size(), 1U) << testing::PrintToString(texts(report));
  EXPECT_THAT(report.problems[0].place, HasSubstr(pointer));
  EXPECT_THAT(report.problems[0].text(), HasSubstr(part));
}

TEST(Verify, TheReferenceSessionIsWhole) {
  const VerifyReport report = verified(example_session());
  EXPECT_EQ(report.state, "complete");
  EXPECT_EQ(report.frame_count, 176);
  EXPECT_THAT(texts(report), IsEmpty());
  EXPECT_THAT(report.notes, IsEmpty());
}

TEST(Verify, AManifestThatCannotBeReadIsAnError) {
  const TemporaryFolder folder;
  EXPECT_FALSE(verify_session(folder.path()));
  write_text(folder.path() / "session.json", "{");
  EXPECT_FALSE(verify_session(folder.path()));
}

TEST(Verify, EachBrokenFrameIsItsOwnProblem) {
  BreakableSession session;
  fs::remove(session.path() / "frames/003_1.tiff");
  fs::resize_file(session.path() / "frames/010_0.tiff", 3000);
  const VerifyReport report = verified(session.path());
  EXPECT_EQ(report.frame_count, 174);
  ASSERT_EQ(report.problems.size(), 2U);
  EXPECT_EQ(report.problems[0].fault, InputFault::kNotFound);
  EXPECT_EQ(report.problems[0].place, "/frames/7/file");
  EXPECT_THAT(report.problems[0].file, HasSubstr("frames/003_1.tiff"));
  EXPECT_EQ(report.problems[1].fault, InputFault::kUnreadable);
  EXPECT_EQ(report.problems[1].place, "/frames/20/file");
  EXPECT_THAT(report.problems[1].text(), HasSubstr("truncated"));
}

TEST(Verify, AFrameOfTheWrongSizeIsNamed) {
  BreakableSession session;
  const Image<std::uint16_t> small(47, 64);
  ASSERT_TRUE(write_file_atomically(session.path() / "frames/000_0.tiff",
                                    encode_frame_tiff(small.view(), 12).value()));
  expect_one_problem(session, "/frames/0/file", "is 64 x 47 px with 1 channel; expected 64 x 48");
}

TEST(Verify, AFrameBehindALinkOutOfTheFolderIsNamed) {
  BreakableSession session;
  fs::remove(session.path() / "frames/000_0.tiff");
  fs::create_symlink(example_session() / "frames/000_0.tiff", session.path() / "frames/000_0.tiff");
  expect_one_problem(session, "/frames/0/file", "leads out of the session folder");
}

TEST(Verify, HashesAreChecked) {
  BreakableSession session;
  const auto bytes = bytes_of(text_of(session.path() / "frames/000_0.tiff"));
  session.document()["frames"][0]["sha256"] = sha256_hex(bytes);
  session.save();
  EXPECT_EQ(verified(session.path()).checked_hash_count, 1);
  fs::copy_file(session.path() / "frames/000_1.tiff", session.path() / "frames/000_0.tiff",
                fs::copy_options::overwrite_existing);
  expect_one_problem(session, "/frames/0/file", "has SHA-256 ");
  EXPECT_EQ(verified(session.path()).checked_hash_count, 0);
}

TEST(Verify, DarkFramesAreRead) {
  BreakableSession session;
  session.document()["camera"]["dark_frames"] = {{{"exposure_us", 10}, {"file", "dark.tiff"}}};
  expect_one_problem(session, "/camera/dark_frames/0/file", "dark.tiff");
  fs::copy(session.path() / "frames/000_0.tiff", session.path() / "dark.tiff");
  EXPECT_THAT(texts(verified(session.path())), IsEmpty());
}

void write_plane(const fs::path& path, const std::vector<std::string>& channels, int height_px,
                 int width_px, float value) {
  const Image<float> plane(height_px, width_px, 1, value);
  std::vector<ExrChannel> exr;
  for (const std::string& channel : channels) exr.push_back({channel, plane.view()});
  ASSERT_TRUE(write_exr(path, exr, {}));
}

TEST(Verify, CalibrationFilesAreReadAndMeasured) {
  BreakableSession session;
  session.document()["camera"]["flat_field"] = "flat.exr";
  const std::string flat = "/camera/flat_field";
  expect_one_problem(session, flat, "No such file");
  write_plane(session.path() / "flat.exr", {"Y"}, 48, 63, 1);
  expect_one_problem(session, flat, "is 63 x 48 px; expected 64 x 48");
  write_plane(session.path() / "flat.exr", {"R", "G"}, 48, 64, 1);
  expect_one_problem(session, flat, "has 2 channels; expected 1");
  write_plane(session.path() / "flat.exr", {"Y"}, 48, 64, 0);
  expect_one_problem(session, flat, "has no pixel that is finite and above 0");
  write_text(session.path() / "flat.exr", "no EXR");
  expect_one_problem(session, flat, "flat.exr");
  write_plane(session.path() / "flat.exr", {"Y"}, 48, 64, 1);

  session.document()["calibration"]["irradiance"]["vignetting"] = "vignetting.exr";
  write_plane(session.path() / "vignetting.exr", {"Y"}, 48, 64, 1);
  expect_one_problem(session, "/calibration/irradiance/vignetting", "expected 1024 x 768");
  write_plane(session.path() / "vignetting.exr", {"Y"}, 768, 1024, 1);

  session.document()["calibration"]["stripe_transfer"] = "transfer.exr";
  write_plane(session.path() / "transfer.exr", {"R.1", "R.2", "G.1"}, 48, 64, 0.9F);
  expect_one_problem(session, "/calibration/stripe_transfer", "has no channel B.1");
  write_plane(session.path() / "transfer.exr", {"R.1", "G.1", "B.1"}, 48, 64, 1.2F);
  expect_one_problem(session, "/calibration/stripe_transfer",
                     "has 1.2 in channel R.1 at column 0, row 0");
  write_plane(session.path() / "transfer.exr", {"R.1", "G.1", "B.1"}, 48, 64, 1.01F);  // noise
  EXPECT_THAT(texts(verified(session.path())), IsEmpty());
}

TEST(Verify, DamagedPixelsOfAFlatFieldAreNoted) {
  BreakableSession session;
  session.document()["camera"]["flat_field"] = "flat.exr";
  Image<float> flat(48, 64, 1, 1.0F);
  flat.at(3, 4) = 0;
  flat.at(5, 6) = -1;
  flat.at(7, 8) = std::numeric_limits<float>::quiet_NaN();
  ASSERT_TRUE(write_exr(session.path() / "flat.exr", {{"Y", flat.view()}}, {}));
  session.save();
  const VerifyReport report = verified(session.path());
  EXPECT_THAT(texts(report), IsEmpty());
  EXPECT_THAT(report.notes, testing::Contains(HasSubstr("3 of 3072 pixels are damaged")));
}

TEST(Verify, PatternPicturesAreReadAndMeasured) {
  BreakableSession session;
  session.document()["patterns"].push_back({{"index", 90}, {"kind", "image"}, {"file", "p.tiff"}});
  const std::string pointer = "/patterns/88/file";
  expect_one_problem(session, pointer, "No such file");
  fs::copy(session.path() / "frames/000_0.tiff", session.path() / "p.tiff");
  expect_one_problem(session, pointer, "is 64 x 48 px; expected the projector's 1024 x 768");
  const Image<std::uint16_t> picture(768, 1024, 3);
  ASSERT_TRUE(write_file_atomically(session.path() / "p.tiff",
                                    encode_frame_tiff(picture.view(), 8).value()));
  EXPECT_THAT(texts(verified(session.path())), IsEmpty());
}

TEST(Verify, TheStateAndItsFailureAreNoted) {
  BreakableSession session;
  session.document()["state"] = "failed";
  session.document()["failure"] = {{"code", "kFrameLost"}, {"slots", {"a"}}, {"text", "lost"}};
  session.save();
  const VerifyReport report = verified(session.path());
  EXPECT_EQ(report.state, "failed");
  EXPECT_THAT(report.notes, Contains(HasSubstr("failed (kFrameLost: lost)")));
}

TEST(Verify, OutputsThatCannotBeComputedAreNoted) {
  BreakableSession session;
  auto& document = session.document();
  document["calibration"].erase("irradiance");
  document["camera"].erase("black_level");
  document["camera"].erase("gain_e_per_dn");
  session.save();
  const VerifyReport report = verified(session.path());
  EXPECT_THAT(texts(report), IsEmpty());
  EXPECT_THAT(report.notes, Contains(HasSubstr("geometry alone can be estimated: "
                                               "/calibration/irradiance/signal_per_us")));
  EXPECT_THAT(report.notes, Contains(HasSubstr("/camera/black_level (or /camera/dark_frames)")));
  EXPECT_THAT(report.notes, Contains(HasSubstr("/camera/gain_e_per_dn")));
}

// Keeps the frames of the patterns below `end` and from `begin` on.
void drop_frames(nlohmann::json& document, int end, int begin) {
  nlohmann::json kept = nlohmann::json::array();
  for (const auto& frame : document["frames"]) {
    if (frame["pattern"] < end || frame["pattern"] >= begin) kept.push_back(frame);
  }
  document["frames"] = kept;
}

TEST(Verify, SubsetsOfPatternsAreNoted) {
  BreakableSession session;
  drop_frames(session.document(), 38, 44);  // shifts 38 and 39, column bits 9 and 8
  session.save();
  const VerifyReport report = verified(session.path());
  EXPECT_THAT(texts(report), IsEmpty());
  EXPECT_THAT(report.notes, Contains(HasSubstr("stripes column 40/8 are not evenly shifted")));
  EXPECT_THAT(report.notes, Contains(HasSubstr("columns cannot be told apart by Gray code: no "
                                               "frames of bit 8, 9 of 10 bits")));
  EXPECT_THAT(report.notes,
              Contains(HasSubstr("no readable frame of pattern 38, 39, 40, 41, 42, 43")));
  EXPECT_THAT(report.notes, Contains(HasSubstr("12 files in frames/ are not named")));
}

TEST(Verify, LowBitsThatPhasesMakeUpForAreNotMissed) {
  BreakableSession session;
  drop_frames(session.document(), 52, 60);  // column bits 3 to 0; stripes of period 16 and 40 stay
  session.save();
  EXPECT_THAT(verified(session.path()).notes, Not(Contains(HasSubstr("told apart"))));
}

TEST(Verify, ASessionWithoutStripesIsNoted) {
  BreakableSession session;
  session.document()["frames"] = nlohmann::json::array();
  session.save();
  const VerifyReport report = verified(session.path());
  EXPECT_EQ(report.frame_count, 0);
  EXPECT_THAT(report.notes, Contains(HasSubstr("no stripes have frames")));
}

}  // namespace
}  // namespace estimation
