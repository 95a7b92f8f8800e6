// A run of frames that each show what was shown a picture earlier, or later: what a stray trigger
// leaves behind that was taken for a flip. Among themselves such frames are as regular as right
// ones; only what they are filed under does not fit. Told by how much of all frames' light the
// patterns explain, as filed and as displaced.
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <map>
#include <utility>

#include "estimation/motion/picture_series.h"

namespace estimation {
namespace {

constexpr std::size_t kMostPlaces = 4096;
constexpr std::size_t kHarmonics = 3;  // 97% of what stripes of a fifth of their period change
constexpr std::size_t kShortest = 2;   // frames; one alone is told by its neighbours
constexpr std::size_t kStep = 4;       // of the first search
// Frames' worth of light that the displacement must explain beyond the filing (one stale frame
// costs up to two), and the share of what the filing leaves open.
constexpr double kLeastGain = 2.5, kLeastGainShare = 0.3;
// Between frames that follow each other: sweeps in order hardly tell a displacement from a motion,
// and hardly suffer from it.
constexpr double kLeastTurnRad = 0.4;

// Sets of positions with what each shows.
struct Filing {
  std::map<int, std::vector<std::pair<std::size_t, double>>> series;  // position, phase
  std::map<int, std::pair<std::vector<std::size_t>, std::vector<std::size_t>>> pairs;
};

class DisplacementSearch {
 public:
  DisplacementSearch(const CameraInfo& camera, const BracketPictures& pictures,
                     const std::vector<PictureRole>& roles)
      : roles_(roles), count_(pictures.shown.size()) {
    std::vector<std::size_t> all(count_);
    for (std::size_t i = 0; i < count_; ++i) all[i] = i;
    const LitTable table = make_table(camera, pictures, all);
    if (table.places.size() < kFewestPlaces) return;
    is_usable_ = true;
    sum_products(table);
    leave_out_ordered_sweeps();
  }

  std::optional<DisplacedRun> find() const {
    if (!is_usable_) return std::nullopt;
    double counted = 0;
    const double filed = explained({}, counted);
    const double open = counted - filed;
    DisplacedRun best;
    double most = filed;
    const auto consider = [&](const DisplacedRun& run) {
      // The picture at the run's end is seen nowhere: a pair less to count.
      double own_counted = 0;
      double own = explained(run, own_counted);
      if (own_counted > 0) own *= counted / own_counted;
      if (own <= most) return false;
      most = own;
      best = run;
      return true;
    };
    for (const int offset : {-1, 1})
      for (std::size_t begin = 0; begin < count_; begin += kStep)
        for (std::size_t end = begin + kStep; end < count_ + kStep; end += kStep)
          consider({begin, std::min(end, count_), offset});
    if (best.offset == 0) return std::nullopt;
    for (bool is_better = true; is_better;) {
      is_better = false;
      const DisplacedRun from = best;
      if (from.begin > 0) is_better |= consider({from.begin - 1, from.end, from.offset});
      if (from.begin + 1 < from.end) is_better |= consider({from.begin + 1, from.end, from.offset});
      if (from.end < count_) is_better |= consider({from.begin, from.end + 1, from.offset});
      if (from.begin + 1 < from.end) is_better |= consider({from.begin, from.end - 1, from.offset});
    }
    const double gain = most - filed;
    if (best.end - best.begin < kShortest || gain < kLeastGain || gain < kLeastGainShare * open)
      return std::nullopt;
    return best;
  }

 private:
  double product(std::size_t a, std::size_t b) const { return products_[a * count_ + b]; }

  // Less its share of the mean picture: a flash, and the lamp's own changes, look much like that.
  static void take_off(const std::vector<float>& mean, std::vector<float>& frame) {
    double both = 0, own = 0;
    for (std::size_t k = 0; k < mean.size(); ++k) {
      both += static_cast<double>(frame[k] * mean[k]);
      own += static_cast<double>(mean[k] * mean[k]);
    }
    const auto share = static_cast<float>(own > 0 ? both / own : 0);
    for (std::size_t k = 0; k < mean.size(); ++k) frame[k] -= share * mean[k];
  }

  void sum_products(const LitTable& table) {
    const std::size_t stride = (table.places.size() + kMostPlaces - 1) / kMostPlaces;
    std::vector<std::vector<float>> light(count_);
    std::vector<float> mean((table.places.size() + stride - 1) / stride);
    for (std::size_t i = 0; i < count_; ++i)
      for (std::size_t k = 0; k < mean.size(); ++k) {
        light[i].push_back(table.light_dn[i][k * stride]);
        mean[k] += light[i][k] / static_cast<float>(count_);
      }
    for (auto& frame : light) take_off(mean, frame);
    products_.resize(count_ * count_);
    for (std::size_t a = 0; a < count_; ++a)
      for (std::size_t b = 0; b <= a; ++b) {
        float sum = 0;
        for (std::size_t k = 0; k < mean.size(); ++k) sum += light[a][k] * light[b][k];
        products_[a * count_ + b] = products_[b * count_ + a] = static_cast<double>(sum);
      }
  }

  void leave_out_ordered_sweeps() {
    std::map<int, std::vector<double>> turns_rad;
    for (std::size_t i = 1; i < count_; ++i)
      if (roles_[i].series >= 0 && roles_[i].series == roles_[i - 1].series)
        turns_rad[roles_[i].series].push_back(
            std::abs(std::arg(std::polar(1.0, roles_[i].phase_rad - roles_[i - 1].phase_rad))));
    for (auto& [series, own] : turns_rad)
      if (median_of(std::move(own)) < kLeastTurnRad)
        for (PictureRole& role : roles_)
          if (role.series == series) role = {};
  }

  Filing filing(const DisplacedRun& run) const {
    Filing filing;
    for (std::size_t i = 0; i < count_; ++i) {
      std::size_t shows = i;
      if (i >= run.begin && i < run.end) {
        if (run.offset < 0 && i == 0) continue;  // black, or a priming
        shows = run.offset < 0 ? i - 1 : i + static_cast<std::size_t>(run.offset);
        if (shows >= count_) continue;
      }
      const PictureRole& role = roles_[shows];
      if (role.series >= 0) filing.series[role.series].emplace_back(i, role.phase_rad);
      for (const PictureRole::Half& half : role.halves) {
        auto& pair = filing.pairs[half.pair];
        (half.is_second ? pair.second : pair.first).push_back(i);
      }
    }
    return filing;
  }

  // Frames' worth of light that the patterns explain, of `counted` frames.
  double explained(const DisplacedRun& run, double& counted) const {
    const Filing filed = filing(run);
    counted = 0;
    double sum = 0;
    for (const auto& [number, frames] : filed.series) sum += explained_sweep(frames, counted);
    return sum + explained_pairs(filed, counted);
  }

  // By the first harmonics.
  double explained_sweep(const std::vector<std::pair<std::size_t, double>>& frames,
                         double& counted) const {
    using Turns = std::array<std::complex<double>, kHarmonics>;
    const auto size = static_cast<double>(frames.size());
    std::vector<Turns> turns(frames.size());
    Turns mean{};
    for (std::size_t a = 0; a < frames.size(); ++a)
      for (std::size_t n = 0; n < kHarmonics; ++n) {
        turns[a][n] = std::polar(1.0, static_cast<double>(n + 1) * frames[a].second);
        mean[n] += turns[a][n] / size;
      }
    for (Turns& own : turns)
      for (std::size_t n = 0; n < kHarmonics; ++n) own[n] -= mean[n];
    double power = 0, sum = 0, squares = 0;
    for (std::size_t a = 0; a < frames.size(); ++a) {
      for (std::size_t b = 0; b < frames.size(); ++b) {
        const double both = product(frames[a].first, frames[b].first);
        double alike = 0;
        for (std::size_t n = 0; n < kHarmonics; ++n)
          alike +=
              turns[a][n].real() * turns[b][n].real() + turns[a][n].imag() * turns[b][n].imag();
        power += both * alike;
        sum += both;
      }
      squares += product(frames[a].first, frames[a].first);
    }
    const double whole = squares - sum / size;
    if (!(whole > 0)) return 0;
    counted += size;
    return size * std::min(2 * power / size / whole, 1.0);
  }

  // By pairs' adding up to the same, each pair against its own contrast: fine codes have little.
  double explained_pairs(const Filing& filed, double& counted) const {
    using Weighted = std::vector<std::pair<std::size_t, double>>;  // frames and their weights
    std::vector<Weighted> sums, differences;
    std::vector<double> mean_weights(count_);
    for (const auto& [number, halves] : filed.pairs) {
      if (halves.first.empty() || halves.second.empty()) continue;
      Weighted& sum = sums.emplace_back();
      Weighted& difference = differences.emplace_back();
      for (const std::size_t frame : halves.first) {
        sum.emplace_back(frame, 1 / static_cast<double>(halves.first.size()));
        difference.push_back(sum.back());
      }
      for (const std::size_t frame : halves.second) {
        sum.emplace_back(frame, 1 / static_cast<double>(halves.second.size()));
        difference.emplace_back(frame, -sum.back().second);
      }
      for (const auto& [frame, weight] : sum) mean_weights[frame] += weight;
    }
    if (sums.empty()) return 0;
    const auto pair_count = static_cast<double>(sums.size());
    // Of each frame with the mean of all sums, and that mean's own square.
    std::vector<double> with_mean(count_);
    double mean_square = 0;
    for (std::size_t a = 0; a < count_; ++a) {
      for (std::size_t b = 0; b < count_; ++b)
        with_mean[a] += product(a, b) * mean_weights[b] / pair_count;
      mean_square += with_mean[a] * mean_weights[a] / pair_count;
    }
    const auto square = [this](const Weighted& frames) {
      double sum = 0;
      for (const auto& [a, weight_a] : frames)
        for (const auto& [b, weight_b] : frames) sum += weight_a * weight_b * product(a, b);
      return sum;
    };
    double explained = 0;
    for (std::size_t pair = 0; pair < sums.size(); ++pair) {
      double along = 0;
      for (const auto& [frame, weight] : sums[pair]) along += weight * with_mean[frame];
      const double left = std::max(square(sums[pair]) - 2 * along + mean_square, 0.0);
      const double contrast = square(differences[pair]);
      if (contrast + left > 0) explained += 2 * contrast / (contrast + left);
    }
    counted += 2 * pair_count;
    return explained;
  }

  std::vector<PictureRole> roles_;
  std::size_t count_;
  bool is_usable_ = false;
  std::vector<double> products_;  // [frame][frame] of light less its share of the mean
};

}  // namespace

std::optional<DisplacedRun> find_displaced(const CameraInfo& camera,
                                           const BracketPictures& pictures,
                                           const std::vector<PictureRole>& roles) {
  return DisplacementSearch(camera, pictures, roles).find();
}

}  // namespace estimation
