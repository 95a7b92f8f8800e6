#include "estimation/sample_noise.h"

#include <algorithm>
#include <cstddef>
#include <map>

#include "estimation/stripe_signals.h"

namespace estimation {
namespace {

// Neighbouring shifts are so close that their differences are noise: fourth differences of 16
// shifts a period keep 0.3% of a sinusoid, those of 8 keep 4%, which would pass for a very noisy
// camera.
bool is_fine_sweep(const StripeSet& stripes) {
  constexpr int kLeastShiftsPerPeriod = 16;
  std::vector<int> gaps_px;
  for (std::size_t i = 1; i < stripes.shifts_px.size(); ++i)
    gaps_px.push_back(stripes.shifts_px[i] - stripes.shifts_px[i - 1]);
  if (gaps_px.empty()) return false;
  const auto middle = gaps_px.begin() + static_cast<std::ptrdiff_t>(gaps_px.size() / 2);
  std::nth_element(gaps_px.begin(), middle, gaps_px.end());
  return kLeastShiftsPerPeriod * *middle <= stripes.shape.period_px;
}

// What the stripes were taken with, and how often: a frame may be missing here and there.
std::map<std::vector<double>, int> exposures_us(const SignalStore::Signals& signals,
                                                const std::optional<StripeSet>& stripes) {
  if (!stripes) return {{signals.patterns.front().exposures_us, 1}};
  std::map<std::vector<double>, int> counts;
  for (const auto& sources : stripes->sources)
    for (const std::size_t source : sources) ++counts[signals.patterns[source].exposures_us];
  return counts;
}

}  // namespace

SampleNoise sample_noise(const CameraInfo& camera, const CameraBlack& black, double saturation_dn,
                         const SignalStore::Signals& signals,
                         const std::optional<StripeSet>& stripes) {
  const auto of_sensor = [&](const auto& sensor) {
    std::vector<SharedNoise> kinds;
    for (const auto& [exposures, count] : exposures_us(signals, stripes)) {
      const double headroom_dn = saturation_dn - black.mean_dn(exposures.back());
      kinds.push_back({merged_noise(exposures, sensor(headroom_dn), headroom_dn), double(count)});
    }
    return above_background(mean_noise(kinds), signals.background_dn_per_us);
  };
  if (camera.gain_e_per_dn.value_or(0) > 0 && camera.read_noise_e)
    return {of_sensor([&](double) {
              return SensorNoise{*camera.gain_e_per_dn, *camera.read_noise_e};
            }),
            true};
  if (stripes && is_fine_sweep(*stripes)) {
    const auto all = exposures_us(signals, stripes);
    const std::vector<double>& usual =
        std::max_element(all.begin(), all.end(), [](const auto& a, const auto& b) {
          return a.second < b.second;
        })->first;
    const double limit_dn_per_us =
        (saturation_dn - black.mean_dn(usual.back())) / usual.back() - signals.background_dn_per_us;
    const auto found =
        noise_from_stripes(signals_of(*stripes, signals.patterns).views, limit_dn_per_us);
    // Samples that lost their long exposures are noisier than those.
    const auto sensor = found ? sensor_of(*found, usual) : std::nullopt;
    if (sensor && signals.background_dn_per_us == 0)
      return {of_sensor([&](double) { return *sensor; }), false};
    if (found) return {{*found}, false};
  }
  // Nothing to tell it from: a 20 ke- full well and 10 e- read noise, as cameras of this class
  // have.
  return {of_sensor([](double headroom_dn) {
            return SensorNoise{20000 / std::max(headroom_dn, 1.0), 10};
          }),
          false};
}

double background_variance(const CameraInfo& camera, const CameraBlack& black, double saturation_dn,
                           const SignalStore::Signals& signals, const SampleNoise& noise) {
  double sum = 0;
  for (const std::vector<double>& exposures : signals.background_exposures_us) {
    // A camera that is not known has the stripes' own noise.
    const std::vector<MergedNoise> own =
        noise.is_measured ? merged_noise(exposures, {*camera.gain_e_per_dn, *camera.read_noise_e},
                                         saturation_dn - black.mean_dn(exposures.back()))
                          : noise.merged;
    sum += variance_at(own, noise.is_measured ? signals.background_dn_per_us : 0);
  }
  const double count = static_cast<double>(signals.background_exposures_us.size());
  return count > 0 ? sum / (count * count) : 0;
}

}  // namespace estimation
