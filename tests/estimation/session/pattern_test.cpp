#include "estimation/session/pattern.h"

#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <numbers>
#include <random>

#include "estimation/session/manifest.h"
#include "session_folder.h"

namespace estimation {
namespace {

TEST(Pattern, StripesAreLitWhereTheContractSays) {
  std::mt19937_64 random(1);
  for (int draw = 0; draw < 200; ++draw) {
    const int period_px = 1 + static_cast<int>(random() % 64);
    const int width_px = 1 + static_cast<int>(random() % static_cast<unsigned>(period_px));
    const int shift_px = static_cast<int>(random() % 400) - 200;
    const Stripes stripes{Axis::kColumn, period_px, width_px, shift_px};
    SCOPED_TRACE(describe(stripes));
    int remainder = -shift_px;
    while (remainder < 0) remainder += period_px;
    for (int col = 0; col < 150; ++col) {
      const bool is_lit = (remainder + col) % period_px < width_px;
      EXPECT_EQ(brightness(stripes, 7, col), is_lit ? 1.0 : 0.0) << col;
    }
  }
}

TEST(Pattern, StripesMoveWithTheirShift) {
  const Stripes still{Axis::kColumn, 40, 8, 0};
  const Stripes moved{Axis::kColumn, 40, 8, 3};
  for (int col = 3; col < 200; ++col) {
    EXPECT_EQ(brightness(moved, 0, col), brightness(still, 0, col - 3));
  }
}

TEST(Pattern, AnExtremeShiftDoesNotOverflow) {
  const Stripes stripes{Axis::kColumn, 40, 8, std::numeric_limits<int>::min()};
  // -2^31 is 32 mod 40 (2^31 = 53687091 * 40 + 8), so column 32 is the first lit.
  EXPECT_EQ(brightness(stripes, 0, 31), 0.0);
  EXPECT_EQ(brightness(stripes, 0, 32), 1.0);
}

TEST(Pattern, RowPatternsVaryAlongRows) {
  const Stripes stripes{Axis::kRow, 10, 5, 0};
  EXPECT_EQ(brightness(stripes, 4, 9), 1.0);
  EXPECT_EQ(brightness(stripes, 5, 0), 0.0);
}

int gray_code_of(int position_px, int bit_count) {
  int code = 0;
  for (int bit = 0; bit < bit_count; ++bit) {
    if (brightness(GrayCode{Axis::kColumn, bit, false}, 0, position_px) > 0) code |= 1 << bit;
  }
  return code;
}

TEST(Pattern, GrayCodesOfNeighboursDifferInOneBit) {
  for (int col = 1; col < 2048; ++col) {
    const int changed = gray_code_of(col, 11) ^ gray_code_of(col - 1, 11);
    EXPECT_EQ(std::popcount(static_cast<unsigned>(changed)), 1) << col;
  }
}

TEST(Pattern, GrayCodesAreAllDifferentAndDecodeByPrefixXor) {
  for (int col = 0; col < 2048; ++col) {
    int decoded = 0;
    for (int rest = gray_code_of(col, 11); rest != 0; rest >>= 1) decoded ^= rest;
    EXPECT_EQ(decoded, col);
  }
}

TEST(Pattern, AnInvertedGrayBitIsTheComplement) {
  for (int row = 0; row < 64; ++row) {
    EXPECT_EQ(brightness(GrayCode{Axis::kRow, 2, false}, row, 0) +
                  brightness(GrayCode{Axis::kRow, 2, true}, row, 0),
              1.0);
  }
}

TEST(Pattern, FringeIsTheContractsCosine) {
  const Fringe fringe{Axis::kColumn, 12.5, 1.25};
  for (int col = 0; col < 50; ++col) {
    const double expected = (1 + std::cos(2 * std::numbers::pi * (col - 1.25) / 12.5)) / 2;
    EXPECT_NEAR(brightness(fringe, 3, col), expected, 1e-12);
  }
}

TEST(Pattern, RenderedPixelsAreTheBrightnessRoundedToNearest) {
  const std::vector<PatternKind> kinds{Stripes{Axis::kRow, 7, 3, 2},
                                       GrayCode{Axis::kColumn, 3, true},
                                       Fringe{Axis::kRow, 9.5, 0.25},
                                       Fringe{Axis::kColumn, 31, 4},
                                       White{},
                                       Black{}};
  for (const PatternKind& kind : kinds) {
    SCOPED_TRACE(describe(kind));
    const Image<unsigned char> image = render_pattern(kind, 20, 33);
    ASSERT_EQ(image.height_px(), 20);
    ASSERT_EQ(image.width_px(), 33);
    for (int row = 0; row < 20; ++row) {
      for (int col = 0; col < 33; ++col) {
        EXPECT_EQ(image.at(row, col), std::lround(255 * brightness(kind, row, col)));
      }
    }
  }
}

TEST(PatternDeathTest, AnImagePatternHasNoBrightness) {
  EXPECT_DEATH(static_cast<void>(brightness(ImageFile{"a.png"}, 0, 0)), "no formula");
  EXPECT_DEATH(static_cast<void>(render_pattern(ImageFile{"a.png"}, 2, 2)), "no formula");
}

TEST(Pattern, ThePaperPlanIsTheReferenceSessions) {
  const auto manifest = read_manifest(example_session());
  ASSERT_TRUE(manifest) << manifest.error().text();
  EXPECT_EQ(paper_patterns().size(), 88U);
  EXPECT_EQ(paper_patterns(), manifest->patterns);
}

TEST(Pattern, DescriptionsNameEveryParameter) {
  EXPECT_EQ(describe(Stripes{Axis::kColumn, 40, 8, 3}), "stripes column 40/8 shift 3");
  EXPECT_EQ(describe(GrayCode{Axis::kRow, 9, true}), "gray code row bit 9 inverted");
  EXPECT_EQ(describe(Fringe{Axis::kColumn, 12.5, 1.5}), "fringe column 12.5 shift 1.5");
  EXPECT_EQ(describe(White{}), "white");
  EXPECT_EQ(describe(Black{}), "black");
  EXPECT_EQ(describe(ImageFile{"p/a.png"}), "image p/a.png");
}

}  // namespace
}  // namespace estimation
