#include "rig/toml_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>

#include "tests/temporary_folder.h"

namespace {

using testing::HasSubstr;

std::string error_of(std::string_view text) {
  const auto table = rig::parse_toml(text, "some.toml");
  return table ? "" : table.error().detail;
}

TEST(TomlText, OrdinaryTextIsATable) {
  EXPECT_TRUE(rig::parse_toml("", "some.toml"));
  const auto table = rig::parse_toml("a = 1\n\nb = 2", "some.toml");
  ASSERT_TRUE(table);
  EXPECT_EQ((*table)["b"].value<int>(), 2);
}

TEST(TomlText, WhatIsNoTomlIsNamedWithItsLine) {
  EXPECT_THAT(error_of("a = 1\n[b"), HasSubstr("some.toml:2: not TOML"));
}

TEST(TomlText, ALineThatCanNestTooDeepIsNamed) {
  std::string dots = "a";
  for (int i = 0; i < 10000; ++i) dots += ".a";
  EXPECT_THAT(error_of("x = 1\n" + dots + " = 1\n"), HasSubstr("some.toml:2: the line has"));
}

TEST(TomlText, TextBeyondAllMeasureIsRefused) {
  std::string text;
  while (text.size() <= (1U << 20U)) text += "# comment\n";
  EXPECT_THAT(error_of(text), HasSubstr("1 MiB"));
}

TEST(TomlText, WhatIsNoFileCannotBeRead) {
  const test_support::TemporaryFolder folder;
  const std::filesystem::path pipe = folder.path() / "pipe";
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);  // nobody writes
  for (const std::filesystem::path& file :
       {folder.path(), folder.path() / "nowhere.toml", pipe, std::filesystem::path("/dev/zero")}) {
    const auto text = rig::read_text(file, "name another");
    ASSERT_FALSE(text);
    EXPECT_THAT(text.error().detail, HasSubstr(file.string() + ": cannot be read"));
    EXPECT_THAT(text.error().detail, HasSubstr("; name another"));
  }
}

TEST(TomlText, OfAFileBeyondAllMeasureOnlyTheBeginningIsRead) {
  const test_support::TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "long.toml";
  std::ofstream(file) << "# long";
  std::filesystem::resize_file(file, std::uintmax_t{1} << 40U);  // holes
  const auto text = rig::read_text(file, "name another");
  ASSERT_TRUE(text);
  EXPECT_THAT(error_of(*text), HasSubstr("1 MiB"));
}

}  // namespace
