#include "rig/toml_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

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

TEST(TomlText, AFolderOrNothingCannotBeRead) {
  for (const std::filesystem::path& file :
       {std::filesystem::temp_directory_path(), std::filesystem::path("/nowhere/some.toml")}) {
    const auto text = rig::read_text(file, "name another");
    ASSERT_FALSE(text);
    EXPECT_THAT(text.error().detail, HasSubstr(file.string() + ": cannot be read; name another"));
  }
}

}  // namespace
