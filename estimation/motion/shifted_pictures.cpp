// Which shift each frame of a series of stripes really shows. Each place's light is fitted as a
// sum of harmonics of the shift; a frame's light less that fit, seen against the first harmonic of
// all places, tells by how much its phase and its modulation are off. What moves shifts all frames
// in turn by little; a frame that shows another picture stands alone between its neighbours.
#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <map>
#include <numeric>
#include <opencv2/core.hpp>
#include <utility>

#include "estimation/motion/harmonic_fit.h"
#include "estimation/motion/picture_series.h"

namespace estimation {
namespace {

using Complex = std::complex<double>;

constexpr double kWrongShiftFrac = 0.2;  // of another shift's light
// Half a period of the stripes is about 0.4: then light and phase are no longer told apart.
constexpr double kMostCoherence = 0.2;
constexpr double kLeastModulation = 0.8;  // of the neighbours': less, and a fifth is no stripes
// Of the first harmonic's square, what noise alone makes of it: sensor noise in frames that show
// nothing fits itself as well as stripes do.
constexpr double kLeastSignal = 3;
// Standard deviations from which on a frame is looked at without its own say.
constexpr double kSuspect = 3;
// A frame whose deviation no neighbour in time explains; 2 px of 40.
constexpr double kForeign = 0.35;
// Of a deviation's square: unexplained by the picture that it is put down to.
constexpr double kMostUnexplained = 0.25;
// At the end of a part of a period the other frames' fit goes on where nothing holds it: what it
// leaves out of the stripes' shape is told as that frame's deviation, several times as large.
constexpr double kMostLeverage = 0.5;

// Phase and logarithm of modulation, which steady motion and a lamp's drift change steadily.
struct Course {
  std::vector<double> elapsed_s, phase_rad, modulation;  // [in the order of showing]
};

Course course_of(const std::vector<Complex>& phasors, const std::vector<double>& elapsed_s) {
  Course course;
  course.elapsed_s = elapsed_s;
  for (const Complex& phasor : phasors) {
    course.phase_rad.push_back(std::arg(phasor));
    course.modulation.push_back(std::log(std::max(std::abs(phasor), 1e-3)));
  }
  return course;
}

// What the frames around it say of a frame, in several ways.
std::vector<Complex> expectations(const Course& course, std::size_t n) {
  const std::size_t count = course.phase_rad.size();
  std::vector<Complex> all;
  const auto add = [&all](double phase_rad, double modulation) {
    all.push_back(std::polar(std::exp(modulation), phase_rad));
  };
  const auto middle = [&](std::size_t begin, std::size_t end) {
    const auto part = [&](const std::vector<double>& values) {
      return median_of({values.begin() + static_cast<std::ptrdiff_t>(begin),
                        values.begin() + static_cast<std::ptrdiff_t>(end)});
    };
    return std::pair(part(course.phase_rad), part(course.modulation));
  };
  const auto along = [&](std::size_t near, std::size_t far) {
    const double span_s = course.elapsed_s[far] - course.elapsed_s[near];
    const double part = span_s != 0 ? (course.elapsed_s[n] - course.elapsed_s[near]) / span_s : 0;
    add(course.phase_rad[near] + part * (course.phase_rad[far] - course.phase_rad[near]),
        course.modulation[near]);
  };
  constexpr std::size_t kReach = 3;
  if (n >= 1) add(course.phase_rad[n - 1], course.modulation[n - 1]);
  if (n + 1 < count) add(course.phase_rad[n + 1], course.modulation[n + 1]);
  if (n >= 2) along(n - 1, n - 2);
  if (n + 2 < count) along(n + 1, n + 2);
  const auto before = middle(n >= kReach ? n - kReach : 0, n);
  const auto after = middle(n + 1, std::min(count, n + 1 + kReach));
  if (n >= 1) add(before.first, before.second);
  if (n + 1 < count) add(after.first, after.second);
  if (n >= 1 && n + 1 < count) {
    along(n - 1, n + 1);
    add((before.first + after.first) / 2, (before.second + after.second) / 2);
  }
  return all;
}

// The smallest of a frame's deviations from what those around it say; 0: as they.
Complex deviation(const Course& course, const Complex& phasor, std::size_t n) {
  Complex least(std::numeric_limits<double>::infinity(), 0);
  for (const Complex& expected : expectations(course, n)) {
    const Complex off = phasor / expected - 1.0;
    if (std::abs(off) < std::abs(least)) least = off;
  }
  return std::isfinite(least.real()) ? least : Complex(0, 0);
}

// The 95th percentile over some frames' time each, which noise does not feign, px of the projector.
double speed_of(const Course& course, double period_px) {
  constexpr std::size_t kSpan = 4;
  std::vector<double> speeds;
  for (std::size_t n = kSpan; n < course.phase_rad.size(); ++n) {
    const double span_s = course.elapsed_s[n] - course.elapsed_s[n - kSpan];
    if (span_s > 0)
      speeds.push_back(std::abs(course.phase_rad[n] - course.phase_rad[n - kSpan]) / span_s);
  }
  if (speeds.empty()) return 0;
  std::sort(speeds.begin(), speeds.end());
  return speeds[(speeds.size() - 1) * 95 / 100] * period_px / (2 * CV_PI);
}

// Of all frames of a series: by how much each is off, what its neighbours in time have taken off.
struct Deviations {
  std::vector<Complex> off;
  double speed_px_per_s = 0;
  std::vector<bool> is_held;  // by frames on both sides of its shift
  // A robust standard deviation of all but frame `without`: of the size, or along a direction.
  double sd(std::size_t without, const Complex& along = 0) const {
    std::vector<double> sizes;
    for (std::size_t n = 0; n < off.size(); ++n)
      if (n != without)
        sizes.push_back(std::abs(along) > 0
                            ? std::abs((off[n] * std::conj(along)).real()) / std::abs(along)
                            : std::abs(off[n]));
    constexpr double kLeast = 1e-4;
    return std::max(1.4826 * median_of(std::move(sizes)), kLeast);
  }
};

class ShiftCheck {
 public:
  ShiftCheck(const CameraInfo& camera, const BracketPictures& pictures, const ShiftSeries& series)
      : pictures_(pictures), table_(make_table(camera, pictures, series.frames)), series_(series) {
    for (std::size_t n = 0; n < series.frames.size(); ++n)
      phases_rad_[pictures.shown[series.frames[n]].picture->pattern] = series.phases_rad[n];
  }

  GroupCheck run() && {
    if (table_.places.size() < kFewestPlaces)
      return refuse("too little is lit, or too much of it clipped");
    check_.judged_count = series_.frames.size();
    while (find_worst()) {
    }
    if (!is_refused_) check_blind();
    return std::move(check_);
  }

 private:
  GroupCheck refuse(const std::string& why) {
    is_refused_ = true;
    GroupCheck refused;
    refused.wrong = check_.wrong;
    for (const std::size_t frame : series_.frames) refused.unchecked.emplace_back(frame, why);
    refused.judged_count = check_.wrong.size();
    return refused;
  }

  // Judges the frames that are furthest off, each by a fit of all others; one that is wrong leaves
  // the series. False: all are right.
  bool find_worst() {
    constexpr std::size_t kFewest = 4U * kShiftHarmonics, kMostSuspects = 4;
    const auto all = series_.frames.size() < kFewest ? std::nullopt : measure(std::nullopt);
    if (!all) {
      check_ = refuse(
          "too few other shifts, too little light or too little of a period tell what it should "
          "look like");
      return false;
    }
    check_.speed_px_per_s = all->speed_px_per_s;
    std::vector<std::size_t> suspects(all->off.size());
    std::iota(suspects.begin(), suspects.end(), std::size_t{0});
    std::erase_if(suspects, [&all](std::size_t n) { return !all->is_held[n]; });
    std::stable_sort(suspects.begin(), suspects.end(), [&](std::size_t a, std::size_t b) {
      return std::abs(all->off[a]) > std::abs(all->off[b]);
    });
    suspects.resize(std::min(suspects.size(), kMostSuspects));
    last_ = *all;
    for (const std::size_t n : suspects) {
      if (std::abs(all->off[n]) < kSuspect * all->sd(n)) break;
      const auto others = measure(n);
      if (!others) continue;
      const auto found = judge(n, *others);
      if (!found) continue;
      check_.wrong.push_back(*found);
      const auto at = static_cast<std::ptrdiff_t>(n);
      series_.frames.erase(series_.frames.begin() + at);
      series_.phases_rad.erase(series_.phases_rad.begin() + at);
      table_.light_dn.erase(table_.light_dn.begin() + at);
      return true;
    }
    return false;
  }

  // By a fit of all frames but `without`; nullopt: they do not determine it.
  std::optional<Deviations> measure(std::optional<std::size_t> without) const {
    const HarmonicFit fit(series_.phases_rad, without);
    if (!fit.is_solved()) return std::nullopt;
    const auto coefficients = fit.coefficients(table_.light_dn);
    // Negated: of no light at all it is no number.
    if (!(coherence(coefficients) <= kMostCoherence) ||
        !(signal_of(fit, coefficients, table_.light_dn) >= kLeastSignal))
      return std::nullopt;
    std::vector<Complex> phasors;
    std::vector<double> elapsed_s;
    for (std::size_t n = 0; n < series_.frames.size(); ++n) {
      phasors.push_back(phasor_of(fit, coefficients, table_.light_dn[n], static_cast<int>(n)));
      elapsed_s.push_back(pictures_.shown[series_.frames[n]].picture->elapsed_s);
    }
    Deviations all;
    const Course course = course_of(phasors, elapsed_s);
    for (std::size_t n = 0; n < phasors.size(); ++n) {
      all.off.push_back(deviation(course, phasors[n], n));
      all.is_held.push_back(fit.leverage(static_cast<int>(n)) <= kMostLeverage);
    }
    all.speed_px_per_s = speed_of(course, series_.period_px);
    return all;
  }

  // Of a frame that shows a pattern of this series; nullopt: it does not.
  std::optional<double> phase_of(std::size_t frame) const {
    const auto found = phases_rad_.find(pictures_.shown[frame].picture->pattern);
    return found == phases_rad_.end() ? std::nullopt : std::optional(found->second);
  }
  // As a deviation: the whole of the picture that was shown before (-1) or after (+1).
  std::optional<Complex> step_to(std::size_t n, int direction) const {
    const std::size_t frame = series_.frames[n];
    if ((direction < 0 && frame == 0) || (direction > 0 && frame + 1 == pictures_.shown.size()))
      return std::nullopt;
    const auto phase = phase_of(direction < 0 ? frame - 1 : frame + 1);
    if (!phase) return std::nullopt;
    return std::polar(1.0, *phase - series_.phases_rad[n]) - 1.0;
  }

  std::optional<GroupFinding> judge(std::size_t n, const Deviations& all) const {
    const Complex off = all.off[n];
    const std::size_t frame = series_.frames[n];
    for (const int direction : {-1, 1}) {
      const auto step = step_to(n, direction);
      if (!step || std::abs(*step) == 0) continue;
      const double share = (off * std::conj(*step)).real() / std::norm(*step);
      const Complex rest = off - share * *step;
      if (share >= kWrongShiftFrac && std::norm(rest) < kMostUnexplained * std::norm(off) &&
          share * std::abs(*step) > kSureOfPicture * all.sd(n, *step)) {
        const std::size_t seen = direction < 0 ? frame - 1 : frame + 1;
        return GroupFinding{frame, share, pictures_.shown[seen].picture->pattern};
      }
    }
    if (std::abs(off) < kSureOfPicture * all.sd(n)) return std::nullopt;
    const double modulation = std::abs(1.0 + off);
    if (modulation < kLeastModulation) return GroupFinding{frame, 1 - modulation};
    if (std::abs(off) > kForeign) return GroupFinding{frame, std::abs(off) / 2};
    return std::nullopt;
  }

  // Frames in which not even the picture before would have been told.
  void check_blind() {
    for (std::size_t n = 0; n < series_.frames.size(); ++n) {
      const auto step = step_to(n, -1);
      if (last_.is_held[n]) {
        if (!step || std::abs(*step) == 0) continue;  // the picture before was the same
        if (std::abs(*step) > kSureOfPicture * last_.sd(n, *step)) continue;
      }
      check_.unchecked.emplace_back(
          series_.frames[n], last_.is_held[n] ? "the stripes moved, or are seen, too unsteadily"
                                              : "too few other shifts are near its own");
      --check_.judged_count;
    }
  }

  const BracketPictures& pictures_;
  LitTable table_;
  ShiftSeries series_;                // without those that are known to be wrong
  std::map<int, double> phases_rad_;  // by pattern, of all
  Deviations last_;
  GroupCheck check_;
  bool is_refused_ = false;
};

}  // namespace

GroupCheck check_shifts(const CameraInfo& camera, const BracketPictures& pictures,
                        const ShiftSeries& series) {
  return ShiftCheck(camera, pictures, series).run();
}

}  // namespace estimation
