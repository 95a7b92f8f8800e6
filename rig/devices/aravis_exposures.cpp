#include "rig/devices/aravis_exposures.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "rig/devices/aravis_setup.h"

namespace rig {
namespace {

constexpr double kExposureRoundingFrac = 0.01;  // cameras round to their line time
constexpr double kExposureRoundingMinUs = 5;
// SFNC, and the name of before SFNC 1.5 (Aravis' fake camera).
constexpr std::array<const char*, 2> kExposureNames{"ExposureTime", "ExposureTimeAbs"};

double exposure_us(std::chrono::microseconds exposure) {
  return static_cast<double>(exposure.count());
}

double exposure_tolerance_us(std::chrono::microseconds exposure) {
  return std::max(kExposureRoundingMinUs, exposure_us(exposure) * kExposureRoundingFrac);
}

class Bracketer {
 public:
  Bracketer(const AravisFeatures& features, const CameraSettings& settings, bool has_exposure_chunk)
      : features_(features), settings_(settings), has_exposure_chunk_(has_exposure_chunk) {}

  Result<void> check(const std::vector<std::chrono::microseconds>& exposures) const;
  Result<void> set(const std::vector<std::chrono::microseconds>& exposures);

 private:
  Result<void> set_single_exposure(std::chrono::microseconds exposure);
  Result<void> program_sequencer(const std::vector<std::chrono::microseconds>& exposures);
  Result<void> program_set(int set, int next_set, std::chrono::microseconds exposure);
  Result<void> verify_set(int set, int next_set, std::chrono::microseconds exposure);

  const AravisFeatures& features_;
  const CameraSettings& settings_;
  const bool has_exposure_chunk_;
  std::string exposure_name_;
};

Result<void> Bracketer::check(const std::vector<std::chrono::microseconds>& exposures) const {
  for (const char* name : kExposureNames) {
    if (!features_.has(name)) continue;
    const auto bounds = features_.number_bounds(name);
    if (!bounds) return tl::unexpected(bounds.error());
    for (const std::chrono::microseconds exposure : exposures)
      if (exposure_us(exposure) < bounds->first || exposure_us(exposure) > bounds->second)
        return failure(Fault::kOutOfRange,
                       name_of(settings_) + " exposes for " +
                           std::to_string(std::llround(bounds->first)) + " to " +
                           std::to_string(std::llround(bounds->second)) + " us, not for " +
                           std::to_string(exposure.count()) +
                           " us; correct sequence.exposures_us in the rig file");
    return {};
  }
  return failure(Fault::kUnsupported, "the camera has no feature ExposureTime");
}

Result<void> Bracketer::set(const std::vector<std::chrono::microseconds>& exposures) {
  exposure_name_ = features_.has(kExposureNames[0]) ? kExposureNames[0] : kExposureNames[1];
  if (auto off = features_.set_text_if_present("SequencerMode", "Off"); !off) return off;
  if (settings_.bracketing == Bracketing::kTriggerWidth)
    return features_.set_text("ExposureMode", "TriggerWidth");
  if (auto timed = features_.set_text_if_present("ExposureMode", "Timed"); !timed) return timed;
  if (exposures.size() == 1) return set_single_exposure(exposures.front());
  if (auto programmed = program_sequencer(exposures); !programmed) return programmed;
  if (has_exposure_chunk_) return {};
  return failure(
      Fault::kUnsupported,
      name_of(settings_) +
          " does not say with its frames how long it exposed, so a sequencer out of "
          "step would go unseen; set camera.bracketing to trigger_width in the rig file");
}

Result<void> Bracketer::set_single_exposure(std::chrono::microseconds exposure) {
  return features_.set_number(exposure_name_, exposure_us(exposure),
                              exposure_tolerance_us(exposure));
}

Result<void> Bracketer::program_sequencer(const std::vector<std::chrono::microseconds>& exposures) {
  const auto sets = features_.integer_bounds("SequencerSetSelector");
  if (!sets) return tl::unexpected(sets.error());
  const auto set_count = static_cast<int>(exposures.size());
  if (set_count - 1 > sets->second)
    return failure(Fault::kOutOfRange, "the camera's sequencer has " +
                                           std::to_string(sets->second + 1) + " sets, " +
                                           std::to_string(set_count) +
                                           " exposures were asked for; shorten "
                                           "sequence.exposures_us, or use trigger_width");
  const auto next = [&](int set) { return (set + 1) % set_count; };
  const auto exposure_of = [&](int set) { return exposures[static_cast<std::size_t>(set)]; };
  if (auto on = features_.set_text("SequencerConfigurationMode", "On"); !on) return on;
  for (int set = 0; set < set_count; ++set)
    if (auto done = program_set(set, next(set), exposure_of(set)); !done) return done;
  for (int set = 0; set < set_count; ++set)
    if (auto same = verify_set(set, next(set), exposure_of(set)); !same) return same;
  return in_order([&] { return features_.set_integer("SequencerSetStart", 0); },
                  [&] { return features_.set_text("SequencerConfigurationMode", "Off"); },
                  [&] { return features_.set_text("SequencerMode", "On"); });
}

Result<void> Bracketer::program_set(int set, int next_set, std::chrono::microseconds exposure) {
  return in_order(
      [&] { return features_.set_integer("SequencerSetSelector", set); },
      [&] { return set_single_exposure(exposure); },
      [&] {
        return features_.has("SequencerPathSelector")
                   ? features_.set_integer("SequencerPathSelector", 0)
                   : Result<void>{};
      },
      [&] { return features_.set_integer("SequencerSetNext", next_set); },
      [&] { return features_.set_text_if_present("SequencerTriggerSource", "FrameStart"); },
      [&] { return features_.execute("SequencerSetSave"); });
}

// A set is what it loads, not what was saved.
Result<void> Bracketer::verify_set(int set, int next_set, std::chrono::microseconds exposure) {
  if (auto loaded = in_order([&] { return features_.set_integer("SequencerSetSelector", set); },
                             [&] { return features_.execute("SequencerSetLoad"); });
      !loaded)
    return loaded;
  const Result<double> got_us = features_.number(exposure_name_);
  if (!got_us) return tl::unexpected(got_us.error());
  const Result<std::int64_t> got_next = features_.integer("SequencerSetNext");
  if (!got_next) return tl::unexpected(got_next.error());
  if (std::abs(*got_us - exposure_us(exposure)) <= exposure_tolerance_us(exposure) &&
      *got_next == next_set)
    return {};
  return failure(Fault::kReadBackMismatch,
                 "sequencer set " + std::to_string(set) + " was saved with ExposureTime " +
                     std::to_string(exposure.count()) + " us and SequencerSetNext " +
                     std::to_string(next_set) + " but holds " + std::to_string(*got_us) +
                     " us and " + std::to_string(*got_next));
}

}  // namespace

Result<void> set_exposures(const AravisFeatures& features, const CameraSettings& settings,
                           bool has_exposure_chunk,
                           const std::vector<std::chrono::microseconds>& exposures) {
  Bracketer bracketer(features, settings, has_exposure_chunk);
  return in_order([&] { return bracketer.check(exposures); },
                  [&] { return bracketer.set(exposures); });
}

}  // namespace rig
