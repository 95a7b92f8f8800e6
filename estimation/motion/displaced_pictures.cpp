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
constexpr std::size_t kShortest = 4;   // frames; shorter runs are told frame by frame
constexpr std::size_t kStep = 4;       // of the first search
// Frames' worth of light that the displacement must explain beyond the filing (one stale frame
// costs up to two), and the share of what the filing leaves open.
constexpr double kLeastGain = 3, kLeastGainShare = 0.3;
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
      double own_counted = 0;
      const double own = explained(run, own_counted);
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
      if (role.pair >= 0)
        (role.is_second ? filing.pairs[role.pair].second : filing.pairs[role.pair].first)
            .push_back(i);
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

  // By pairs' adding up to the same.
  double explained_pairs(const Filing& filed, double& counted) const {
    std::vector<std::pair<std::size_t, double>> all;  // frame and its weight in its pair's sum
    double pair_count = 0, squares = 0, own_sums = 0;
    for (const auto& [number, halves] : filed.pairs) {
      if (halves.first.empty() || halves.second.empty()) continue;
      const std::size_t before = all.size();
      for (const auto* half : {&halves.first, &halves.second})
        for (const std::size_t frame : *half)
          all.emplace_back(frame, 1 / static_cast<double>(half->size()));
      ++pair_count;
      for (std::size_t a = before; a < all.size(); ++a)
        for (std::size_t b = before; b < all.size(); ++b)
          own_sums += all[a].second * all[b].second * product(all[a].first, all[b].first);
    }
    double sum = 0, plain = 0;
    for (const auto& [a, weight_a] : all) {
      squares += product(a, a);
      for (const auto& [b, weight_b] : all) {
        sum += weight_a * weight_b * product(a, b);
        plain += product(a, b);
      }
    }
    const auto size = static_cast<double>(all.size());
    const double whole = squares - plain / std::max(size, 1.0);
    if (!(whole > 0)) return 0;
    counted += size;
    const double left = (own_sums - sum / pair_count) / 2;
    return size * (1 - std::clamp(left / whole, 0.0, 1.0));
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
