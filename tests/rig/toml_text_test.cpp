#include "rig/toml_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace {

using testing::HasSubstr;
using testing::IsEmpty;

TEST(TomlText, OrdinaryTextPasses) {
  EXPECT_THAT(rig::objection_to_toml(""), IsEmpty());
  EXPECT_THAT(rig::objection_to_toml("a = 1\n\nb = 2"), IsEmpty());
}

TEST(TomlText, ALineThatCanNestTooDeepIsNamed) {
  std::string dots = "a";
  for (int i = 0; i < 10000; ++i) dots += ".a";
  EXPECT_THAT(rig::objection_to_toml("x = 1\n" + dots + " = 1\n"), HasSubstr(":2: the line has"));
}

TEST(TomlText, TextBeyondAllMeasureIsRefused) {
  std::string text;
  while (text.size() <= (1U << 20U)) text += "# comment\n";
  EXPECT_THAT(rig::objection_to_toml(text), HasSubstr("1 MiB"));
}

}  // namespace
