#include "estimation/models/monte_carlo/white_transform.h"

#include <algorithm>
#include <numbers>

#include "estimation/models/monte_carlo/small_solve.h"

namespace estimation {
namespace {

constexpr int kFrequencies = ScoreGrid::kFrequencyCount;

std::size_t at(int bin, int frequency) {
  return static_cast<std::size_t>(bin) * kFrequencies + static_cast<std::size_t>(frequency);
}

// The integral of L^(-3/2 - term) from a to b.
double law_integral(int term, double a, double b) {
  const double power = -0.5 - term;
  return (std::pow(a, power) - (std::isinf(b) ? 0 : std::pow(b, power))) / -power;
}

}  // namespace

WhiteTransform::WhiteTransform(const WalkMedium& medium, const WhiteScore& score)
    : single_(medium) {
  const auto photons = static_cast<double>(score.photon_count());
  double mass_beyond = 1 - single_.transform(0, 0);
  for (int bin = 0; bin < ScoreGrid::path_bin_count(); ++bin) {
    const double begin = ScoreGrid::path_begin_tmfp(bin);
    const double end = ScoreGrid::path_begin_tmfp(bin + 1);
    bins_.push_back({0.5 * (begin + end), end - begin});
    for (int i = 0; i < kFrequencies; ++i) {
      sum_.push_back(score.sum(bin, i) / photons);
      moment_.push_back(score.moment(bin, i) / photons);
    }
    if (begin < kLawFrom_tmfp) mass_beyond -= sum_[at(bin, 0)];
  }
  fit_law(mass_beyond);
}

// Fits the law to the flux in the bins (which roulette gives about the same absolute noise each),
// then gives those bins the law's flux, keeping their phase averages.
void WhiteTransform::fit_law(double mass_beyond) {
  std::array<std::array<double, 5>, 4> rows{};  // the fourth is the condition on the whole
  double first_tmfp = 0;
  for (std::size_t bin = 0; bin < bins_.size(); ++bin) {
    const double begin = bins_[bin].middle_tmfp - 0.5 * bins_[bin].width_tmfp;
    if (begin < kLawFrom_tmfp) continue;
    if (first_tmfp == 0) first_tmfp = begin;
    for (int i = 0; i < 3; ++i) {
      const double shape = law_integral(i, begin, begin + bins_[bin].width_tmfp);
      for (int j = 0; j < 3; ++j)
        rows[static_cast<std::size_t>(i)][static_cast<std::size_t>(j)] +=
            shape * law_integral(j, begin, begin + bins_[bin].width_tmfp);
      rows[static_cast<std::size_t>(i)][4] += shape * sum_[at(static_cast<int>(bin), 0)];
    }
  }
  for (int i = 0; i < 3; ++i) {
    const double whole = law_integral(i, first_tmfp, std::numeric_limits<double>::infinity());
    rows[static_cast<std::size_t>(i)][3] = rows[3][static_cast<std::size_t>(i)] = whole;
  }
  rows[3][4] = mass_beyond;
  const std::array<double, 4> solution = solve(rows);
  std::copy_n(solution.begin(), 3, law_.begin());
  for (int bin = 0; bin < static_cast<int>(bins_.size()); ++bin) {
    const Bin& place = bins_[static_cast<std::size_t>(bin)];
    const double begin = place.middle_tmfp - 0.5 * place.width_tmfp;
    if (begin < kLawFrom_tmfp) continue;
    double flux = 0;
    for (int i = 0; i < 3; ++i)
      flux += law_[static_cast<std::size_t>(i)] * law_integral(i, begin, begin + place.width_tmfp);
    const double scored = sum_[at(bin, 0)];
    for (int i = 0; i < kFrequencies; ++i) {
      const double k = ScoreGrid::k_tmfp(i);
      if (scored > 0) {
        sum_[at(bin, i)] *= flux / scored;
        moment_[at(bin, i)] *= flux / scored;
      } else {
        sum_[at(bin, i)] = flux * std::exp(-k * k / 3 * place.middle_tmfp);
      }
    }
  }
}

// The integral of the law times exp(-decay L) beyond the longest path.
double WhiteTransform::tail(double decay) const {
  const double from = ScoreGrid::kLongestPath_tmfp;
  const double kept = std::exp(-decay * from);
  double integral = 2 * kept / std::sqrt(from) -
                    2 * std::sqrt(std::numbers::pi * decay) * std::erfc(std::sqrt(decay * from));
  double total = law_[0] * integral;
  for (int i = 1; i < 3; ++i) {
    integral = (std::pow(from, -0.5 - i) * kept - decay * integral) / (0.5 + i);
    total += law_[static_cast<std::size_t>(i)] * integral;
  }
  return total;
}

double WhiteTransform::multiple(double absorption, int frequency) const {
  double total = 0;
  for (int bin = 0; bin < static_cast<int>(bins_.size()); ++bin) {
    const Bin& place = bins_[static_cast<std::size_t>(bin)];
    const double across = absorption * place.width_tmfp;
    // exp(-x L) over the bin to second order; the flux' own spread in it as if it were even.
    total += std::exp(-absorption * place.middle_tmfp) *
             (sum_[at(bin, frequency)] * (1 + across * across / 24) -
              absorption * moment_[at(bin, frequency)]);
  }
  const double k = ScoreGrid::k_tmfp(frequency);
  return total + tail(absorption + k * k / 3);
}

double WhiteTransform::transform(double absorption, int frequency) const {
  return single_.transform(absorption, ScoreGrid::k_tmfp(frequency)) +
         multiple(absorption, frequency);
}

// 1 - R_d -> 2 C sqrt(pi x), and s^2 -> 3 x.
double WhiteTransform::slope() const { return 2 * law_[0] * std::sqrt(std::numbers::pi / 3); }

}  // namespace estimation
