// Telling the periods of a phase apart by Gray code and by the phases of other periods.
#pragma once

#include <span>
#include <vector>

namespace estimation {

// Half the width of a blurred transition. Skin's mean free path is 2 to 7 px, and a bit four px
// from its transition must count fully, because one of the two bits that tell neighbouring periods
// of 16 apart may be no farther from its own.
inline constexpr float kGrayRampPx = 4;

// What a blurred Gray-code bit looks like at projector coordinate `position_px`: -1 (dark) to 1
// (lit), 0 at a transition, ramps as wide as skin's blur.
double soft_gray_bit(int bit, double position_px);

// One bit's reading at a pixel: (lit - dark) over the pixel's modulation, -1 .. 1, and the variance
// of that from noise. A bit that could not be read has infinite variance.
struct BitReading {
  float value = 0;
  float variance = 0;
};

// A phase's reading at a pixel: coordinate modulo period_px.
struct PhaseReading {
  float period_px = 0;
  float position_px = 0;
  float sd_px = 0;
};

struct PeriodChoice {
  double position_px = 0;  // the phase's coordinate, unwrapped
  double margin = 0;       // log-likelihood over the second best period; infinite if there is none
};

// Unwraps one phase of period `period_px` over a projector of `size_px` columns (or rows).
// Immutable, so thread-safe; `scratch` is the caller's.
class PeriodChooser {
 public:
  PeriodChooser(double period_px, int size_px, std::vector<int> bits);

  // How far phases of two periods may disagree beside their noise, px: light that enters obliquely
  // comes out shifted. At first kUsualSlackPx; rigs whose periods are beats of one another need
  // less.
  static constexpr double kUsualSlackPx = 0.7;
  void set_slack_px(double slack_px) { slack_px_ = slack_px; }

  PeriodChoice choose(const PhaseReading& phase, std::span<const BitReading> bits,
                      std::span<const PhaseReading> others, std::vector<float>& scratch) const;

 private:
  double period_px_;
  double slack_px_ = kUsualSlackPx;
  int bin_count_;        // of the phase, kBinsPerPx a px
  int candidate_count_;  // periods -1 .. candidate_count_ - 2
  std::vector<int> bits_;
  std::vector<float> expected_;  // [bin][bit][candidate] soft_gray_bit
  std::vector<float> base_;      // [bin][candidate] 0, or very unlikely outside the projector
};

}  // namespace estimation
