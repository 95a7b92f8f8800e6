// What a resumed capture believes of a journal: tests/fuzz/journal_fuzz.cpp tries the rest.
#include "capture/stored_take.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "tests/temporary_folder.h"

namespace {

using namespace std::chrono_literals;

const std::string kBegun = R"({"event":"take begun","exposures_us":[16667,66667],"order":[0,2,1],)"
                           R"("settings":{"sequence.sync":"trigger_box"}})"
                           "\n";

std::string stored(const std::string& file, const std::string& pattern) {
  return R"({"event":"frame stored","exposure_us":16667.0,"frame_id":3,"byte_count":6324,"file":")" +
         file + R"(","pattern":)" + pattern + "}\n";
}

TEST(Journal, SaysHowItsTakeWasBegunAndWhichFramesAreStored) {
  const capture::Journal journal =
      capture::parse_journal(kBegun + stored("frames/002_0.tiff", "2"));
  ASSERT_TRUE(journal.beginning);
  EXPECT_EQ(journal.beginning->exposures,
            (std::vector<std::chrono::microseconds>{16667us, 66667us}));
  EXPECT_EQ(journal.beginning->order, (std::vector<int>{0, 2, 1}));
  EXPECT_EQ(journal.beginning->settings.at("sequence.sync"), "trigger_box");
  const capture::JournalledFrame& frame = journal.frames.at("frames/002_0.tiff");
  EXPECT_EQ(frame.record.pattern, 2);
  EXPECT_EQ(frame.record.frame_id, 3U);
  EXPECT_EQ(frame.byte_count, 6324U);
}

TEST(Journal, PassesOverATornLastLine) {
  const std::string second = stored("frames/001_0.tiff", "1");
  const capture::Journal journal =
      capture::parse_journal(kBegun + stored("frames/000_0.tiff", "0") + second.substr(0, 90));
  EXPECT_TRUE(journal.beginning);
  EXPECT_EQ(journal.frames.size(), 1U);
}

// 2^32 would be pattern 0 in 32 bits.
TEST(Journal, PassesOverANumberBeyondItsType) {
  EXPECT_TRUE(capture::parse_journal(stored("a.tiff", "4294967296")).frames.empty());
  EXPECT_TRUE(capture::parse_journal(stored("a.tiff", "-1")).frames.empty());
}

// Printing nested values is recursive: a line of brackets would exhaust the stack.
TEST(Journal, IsNotFelledByADeeplyNestedSetting) {
  constexpr std::size_t kDepth = 200'000;
  const std::string line = R"({"event":"take begun","exposures_us":[1],"settings":{"deep":)" +
                           std::string(kDepth, '[') + std::string(kDepth, ']') + "}}\n";
  const capture::Journal journal = capture::parse_journal(line);
  ASSERT_TRUE(journal.beginning);
  EXPECT_TRUE(journal.beginning->settings.empty());
}

TEST(Journal, IsEmptyWhereThereIsNone) {
  const test_support::TemporaryFolder folder;
  const capture::Journal journal = capture::read_journal(folder.path() / "no session");
  EXPECT_FALSE(journal.beginning);
  EXPECT_TRUE(journal.frames.empty());
}

TEST(Journal, IsEmptyWhereItIsAFolder) {
  const test_support::TemporaryFolder session;
  ASSERT_TRUE(std::filesystem::create_directories(session.path() / "journal.jsonl"));
  EXPECT_FALSE(capture::read_journal(session.path()).beginning);
}

}  // namespace
