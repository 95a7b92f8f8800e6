// Which shift each frame of a series of stripes really shows. Each place's light is fitted as a
// sum of harmonics of the shift; a frame's light less that fit, seen against the first harmonic of
// all places, tells by how much its phase and its modulation are off. What moves shifts all frames
// in turn by little; a frame that shows another picture stands alone between its neighbours.
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <limits>
#include <map>
#include <numeric>
#include <opencv2/core.hpp>
#include <utility>

#include "estimation/motion/picture_series.h"

namespace estimation {
namespace {

using Complex = std::complex<double>;

constexpr int kHarmonics = 3;
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

// Fits light = sum of harmonics at each place, by least squares over the frames.
class HarmonicFit {
 public:
  // Of all frames but `without`.
  HarmonicFit(const std::vector<double>& phases_rad, std::optional<std::size_t> without)
      : frame_count_(static_cast<int>(phases_rad.size())),
        term_count_(2 * kHarmonics + 1),
        design_(frame_count_, term_count_) {
    for (int n = 0; n < frame_count_; ++n) {
      design_(n, 0) = 1;
      for (int k = 1; 2 * k < term_count_; ++k) {
        design_(n, 2 * k - 1) = std::cos(k * phases_rad[static_cast<std::size_t>(n)]);
        design_(n, 2 * k) = std::sin(k * phases_rad[static_cast<std::size_t>(n)]);
      }
    }
    cv::Mat1d used = design_.clone();
    if (without) used.row(static_cast<int>(*without)) = 0.0;
    is_solved_ = cv::invert(used, inverse_, cv::DECOMP_SVD) > kLeastCondition;
  }
  bool is_solved() const { return is_solved_; }
  int term_count() const { return term_count_; }
  double term(int frame, int term) const { return design_(frame, term); }
  // How much of a frame's own light its fit follows.
  double leverage(int frame) const {
    double sum = 0;
    for (int t = 0; t < term_count_; ++t) sum += design_(frame, t) * inverse_(t, frame);
    return sum;
  }
  // [term][place]
  std::vector<std::vector<float>> coefficients(
      const std::vector<std::vector<float>>& light_dn) const {
    std::vector<std::vector<float>> found(static_cast<std::size_t>(term_count_),
                                          std::vector<float>(light_dn.front().size()));
    for (int t = 0; t < term_count_; ++t) {
      std::vector<float>& row = found[static_cast<std::size_t>(t)];
      for (int n = 0; n < frame_count_; ++n) {
        const auto weight = static_cast<float>(inverse_(t, n));
        const std::vector<float>& light = light_dn[static_cast<std::size_t>(n)];
        for (std::size_t i = 0; i < row.size(); ++i) row[i] += weight * light[i];
      }
    }
    return found;
  }

 private:
  static constexpr double kLeastCondition = 1e-3;  // of an inversion by SVD: smallest over largest
  const int frame_count_, term_count_;
  cv::Mat1d design_, inverse_;
  bool is_solved_ = false;
};

// Of the first harmonic with the mean over all places: 0 for places all over the period, 1 for one.
double coherence(const std::vector<std::vector<float>>& coefficients) {
  Complex product = 0;
  double harmonic_square = 0, mean_square = 0;
  for (std::size_t i = 0; i < coefficients[0].size(); ++i) {
    const auto mean = static_cast<double>(coefficients[0][i]);
    const Complex harmonic(static_cast<double>(coefficients[1][i]),
                           static_cast<double>(coefficients[2][i]));
    product += mean * harmonic;
    harmonic_square += std::norm(harmonic);
    mean_square += mean * mean;
  }
  return std::norm(product) / (harmonic_square * mean_square);
}

// The square of the first harmonic, of what noise as large as the fit leaves would make of it.
double signal_of(const HarmonicFit& fit, const std::vector<std::vector<float>>& coefficients,
                 const std::vector<std::vector<float>>& light_dn) {
  constexpr std::size_t kStride = 8;  // places enough
  double signal = 0, left = 0;
  for (std::size_t i = 0; i < coefficients[0].size(); i += kStride) {
    signal += std::norm(
        Complex(static_cast<double>(coefficients[1][i]), static_cast<double>(coefficients[2][i])));
    for (std::size_t n = 0; n < light_dn.size(); ++n) {
      double surplus = static_cast<double>(light_dn[n][i]);
      for (int t = 0; t < fit.term_count(); ++t)
        surplus -= fit.term(static_cast<int>(n), t) *
                   static_cast<double>(coefficients[static_cast<std::size_t>(t)][i]);
      left += surplus * surplus;
    }
  }
  const auto count = static_cast<double>(light_dn.size());
  const double variance = left / (count - fit.term_count());
  return signal * count / (4 * std::max(variance, 1e-9));
}

// Relative to what the fit has for the frame's shift: 1 is right; the argument is the phase by
// which it is ahead, the size its modulation.
Complex phasor_of(const HarmonicFit& fit, const std::vector<std::vector<float>>& coefficients,
                  const std::vector<float>& light_dn, int frame) {
  std::array<float, 7> terms{};
  for (int t = 0; t < fit.term_count(); ++t)
    terms[static_cast<std::size_t>(t)] = static_cast<float>(fit.term(frame, t));
  const float cosine = terms[1], sine = terms[2];
  const float *mean = coefficients[0].data(), *in_cosine = coefficients[1].data(),
              *in_sine = coefficients[2].data();
  cv::Matx33d matrix;
  cv::Vec3d vector;
  constexpr std::size_t kRun = 512;  // floats add up in runs that keep their precision
  std::array<float, kRun> surplus{};
  for (std::size_t begin = 0; begin < light_dn.size(); begin += kRun) {
    const std::size_t count = std::min(kRun, light_dn.size() - begin);
    for (std::size_t i = 0; i < count; ++i) surplus[i] = light_dn[begin + i];
    for (int t = 0; t < fit.term_count(); ++t) {
      const float term = terms[static_cast<std::size_t>(t)];
      const float* coefficient = coefficients[static_cast<std::size_t>(t)].data() + begin;
      for (std::size_t i = 0; i < count; ++i) surplus[i] -= term * coefficient[i];
    }
    std::array<float, 9> sums{};
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t at = begin + i;
      const float in_phase = cosine * in_cosine[at] + sine * in_sine[at];
      const float ahead = cosine * in_sine[at] - sine * in_cosine[at];
      sums[0] += in_phase * in_phase;
      sums[1] += in_phase * ahead;
      sums[2] += in_phase * mean[at];
      sums[3] += ahead * ahead;
      sums[4] += ahead * mean[at];
      sums[5] += mean[at] * mean[at];
      sums[6] += in_phase * surplus[i];
      sums[7] += ahead * surplus[i];
      sums[8] += mean[at] * surplus[i];
    }
    const auto sum = [&sums](std::size_t i) { return static_cast<double>(sums[i]); };
    matrix += cv::Matx33d(sum(0), sum(1), sum(2), sum(1), sum(3), sum(4), sum(2), sum(4), sum(5));
    vector += cv::Vec3d(sum(6), sum(7), sum(8));
  }
  cv::Vec3d found;
  if (!cv::solve(matrix, vector, found, cv::DECOMP_CHOLESKY)) return {0, 0};
  const double own = std::max(1 - fit.leverage(frame), 0.05);
  return Complex(1, 0) + Complex(found[0], found[1]) / own;
}

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
    if (check_.judged_count > 0) check_blind();
    return std::move(check_);
  }

 private:
  GroupCheck refuse(const std::string& why) {
    GroupCheck refused;
    refused.wrong = check_.wrong;
    for (const std::size_t frame : series_.frames) refused.unchecked.emplace_back(frame, why);
    refused.judged_count = check_.wrong.size();
    return refused;
  }

  // Judges the frames that are furthest off, each by a fit of all others; one that is wrong leaves
  // the series. False: all are right.
  bool find_worst() {
    constexpr std::size_t kFewest = 2 * (2 * kHarmonics), kMostSuspects = 4;
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
    for (std::size_t n = 0; n < phasors.size(); ++n)
      all.off.push_back(deviation(course, phasors[n], n));
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
      if (!step || std::abs(*step) == 0) continue;  // the picture before was the same
      if (std::abs(*step) > kSureOfPicture * last_.sd(n, *step)) continue;
      check_.unchecked.emplace_back(series_.frames[n],
                                    "the stripes moved, or are seen, too unsteadily");
      --check_.judged_count;
    }
  }

  const BracketPictures& pictures_;
  LitTable table_;
  ShiftSeries series_;                // without those that are known to be wrong
  std::map<int, double> phases_rad_;  // by pattern, of all
  Deviations last_;
  GroupCheck check_;
};

}  // namespace

GroupCheck check_shifts(const CameraInfo& camera, const BracketPictures& pictures,
                        const ShiftSeries& series) {
  return ShiftCheck(camera, pictures, series).run();
}

}  // namespace estimation
