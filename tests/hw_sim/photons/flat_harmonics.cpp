#include "tests/hw_sim/photons/flat_harmonics.h"

#include <math.h>  // j0, which <cmath> has as a slow std::cyl_bessel_j only
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "tests/hw_sim/photons/half_space.h"

namespace hw_sim {

using estimation::Vec3;

namespace {

constexpr int kBatches = 32;
// Of the least that any harmonic reflects: dimmer paths go on by chance. Half that costs a third
// more time for the same noise, three times that half as much again.
constexpr double kDim = 1;
// Harmonic 0 is asked for more exactly than the others.
constexpr double kCountsOfTotal = 3;

double phase(double g, double cosine) {
  const double base = 1 + g * g - 2 * g * cosine;
  return 1 / (base * std::sqrt(base));
}

// The chance that a scattering came from the part of the phase function that is alike for all
// azimuths: no less light goes anywhere at these polar angles than to the opposite azimuth.
double chance_of_forgetting(const Turn& turn) {
  const double before = turn.way_before[2], after = turn.way_after[2];
  const double opposite =
      before * after - std::sqrt(std::max(0.0, (1 - before * before) * (1 - after * after)));
  return phase(turn.anisotropy, opposite) /
         phase(turn.anisotropy, turn.way_before.dot(turn.way_after));
}

using Values = std::vector<std::complex<double>>;

// One path's harmonics, summed as it goes.
class StripeWatcher final : public PathWatcher {
 public:
  // `importance` by frequency, 1 at most.
  StripeWatcher(const FlatView& view, std::span<const double> freqs_per_mm,
                std::span<const double> importance, PhotonRandom& random)
      : is_lit_from_above_(view.towards_lamp[0] == 0 && view.towards_lamp[1] == 0),
        is_seen_from_everywhere_(!view.towards_eye),
        freqs_per_mm_(freqs_per_mm),
        importance_(importance),
        random_(random),
        kept_(freqs_per_mm.size()),
        sums_(freqs_per_mm.size(), 0.0) {}

  // What follows belongs to a new path, whose deposits are in `deposits`.
  void begin(const std::vector<Deposit>& deposits) {
    deposits_ = &deposits;
    used_ = 0;
    begin_mm_ = {0, 0, 0};
    may_turn_ = is_seen_from_everywhere_;
    std::fill(kept_.begin(), kept_.end(), 1.0);
  }
  const Values& sums() const { return sums_; }

  double on_turn(const Turn& turn) override {
    for (; used_ < deposits_->size(); ++used_) add((*deposits_)[used_]);
    if (random_.uniform() > chance_of_forgetting(turn)) return 1;
    const Vec3 moved_mm = turn.point_mm - begin_mm_;
    double left = 0;
    for (std::size_t i = 0; i < kept_.size(); ++i) {
      kept_[i] *= wave(i, moved_mm, may_turn_);
      left = std::max(left, std::abs(kept_[i]) * importance_[i] * turn.weight);
    }
    begin_mm_ = turn.point_mm;
    may_turn_ = true;
    if (left >= kDim) return 1;
    return random_.uniform() * kDim <= left ? kDim / left : 0;
  }

 private:
  // Light from above adds alike from all azimuths.
  void add(const Deposit& deposit) {
    const Vec3 moved_mm = deposit.entry_mm - begin_mm_;
    for (std::size_t i = 0; i < kept_.size(); ++i)
      sums_[i] += deposit.weight * kept_[i] * wave(i, moved_mm, may_turn_ && is_lit_from_above_);
  }

  std::complex<double> wave(std::size_t freq, const Vec3& moved_mm, bool may_turn) const {
    const double per_mm = 2 * std::numbers::pi * freqs_per_mm_[freq];
    if (per_mm == 0) return 1;
    if (may_turn) return ::j0(per_mm * std::hypot(moved_mm[0], moved_mm[1]));
    return std::polar(1.0, per_mm * moved_mm[0]);
  }

  bool is_lit_from_above_, is_seen_from_everywhere_;
  std::span<const double> freqs_per_mm_, importance_;
  PhotonRandom& random_;
  const std::vector<Deposit>* deposits_ = nullptr;
  std::size_t used_ = 0;   // of them
  Vec3 begin_mm_;          // where the azimuth was last forgotten
  bool may_turn_ = false;  // what goes on from there
  Values kept_;            // of each wave, by what lies before
  Values sums_;
};

// [batch][frequency].
std::vector<Values> trace_batches(const VolumeOptics& optics, const FlatView& view,
                                  std::span<const double> freqs_per_mm,
                                  std::span<const double> importance, int paths,
                                  std::uint64_t seed) {
  const UniformMatter matter(optics);
  const AdjointWalk walk(half_space(), matter, sunlight(view.towards_lamp));
  std::vector<Values> batches(kBatches);
  tbb::parallel_for(0, kBatches, [&](int batch) {
    PhotonRandom random(seed * kBatches + static_cast<std::uint64_t>(batch));
    std::vector<Deposit> deposits;
    StripeWatcher watcher(view, freqs_per_mm, importance, random);
    for (int path = 0; path < paths / kBatches; ++path) {
      deposits.clear();
      watcher.begin(deposits);
      const Vec3 eye = view.towards_eye ? *view.towards_eye : lambertian_direction(random);
      const auto start = seen_path(half_space(), {0, 0, 0}, eye);
      if (start) walk.trace(*start, random, deposits, &watcher);
    }
    Values& sums = batches[static_cast<std::size_t>(batch)];
    sums = watcher.sums();
    for (auto& sum : sums) sum /= -view.towards_lamp[2] * (paths / kBatches);
  });
  return batches;
}

Harmonic harmonic_of(const std::vector<Values>& batches, std::size_t freq) {
  std::vector<double> real, imaginary;
  for (const Values& batch : batches) {
    real.push_back(batch[freq].real());
    imaginary.push_back(batch[freq].imag());
  }
  const Estimate re = estimate_of(real), im = estimate_of(imaginary);
  return {{re.value, im.value}, std::max(re.standard_error, im.standard_error)};
}

// A path counts as much as the harmonic of which it is the largest share; what each reflects is
// roughly known from a few paths, none thinned.
std::vector<double> importance_of(const VolumeOptics& optics, const FlatView& view,
                                  std::span<const double> freqs_per_mm, std::uint64_t seed) {
  constexpr int kPaths = 40 * kBatches;
  const std::vector<double> all_count(freqs_per_mm.size(), 1e9);
  const auto batches = trace_batches(optics, view, freqs_per_mm, all_count, kPaths, ~seed);
  std::vector<double> importance;
  double least = 1e9;
  for (std::size_t i = 0; i < freqs_per_mm.size(); ++i) {
    const Harmonic found = harmonic_of(batches, i);
    const double size = std::max(std::abs(found.value), found.standard_error);
    least = std::min(least, size);
    importance.push_back((freqs_per_mm[i] == 0 ? kCountsOfTotal : 1) / size);
  }
  for (double& one : importance) one = std::min(1.0, one * least);
  return importance;
}

}  // namespace

std::vector<Harmonic> flat_harmonics(const VolumeOptics& optics, const FlatView& view,
                                     std::span<const double> freqs_per_mm, int paths,
                                     std::uint64_t seed) {
  const auto importance = importance_of(optics, view, freqs_per_mm, seed);
  const auto batches = trace_batches(optics, view, freqs_per_mm, importance, paths, seed);
  std::vector<Harmonic> harmonics;
  for (std::size_t i = 0; i < freqs_per_mm.size(); ++i)
    harmonics.push_back(harmonic_of(batches, i));
  return harmonics;
}

}  // namespace hw_sim
