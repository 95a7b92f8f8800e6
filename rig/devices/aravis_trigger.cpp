#include "rig/devices/aravis_trigger.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

namespace rig {
namespace {

// SFNC, and Basler's of before it.
constexpr std::array<const char*, 2> kDelayNames{"TriggerDelay", "TriggerDelayAbs"};
constexpr double kDelayRounding_us = 1;
constexpr std::array<const char*, 2> kDebouncerNames{"LineDebouncerTime", "LineDebouncerTimeAbs"};
constexpr double kDebounceRoundingFrac = 0.1;  // to the ticks of some clock of the camera's

class TriggerSetting {
 public:
  TriggerSetting(const AravisFeatures& features, const CameraSettings& settings, AravisSetup& setup)
      : features_(features), settings_(settings), setup_(setup) {}

  Result<void> run() {
    return in_order([&] { return set_counters(); }, [&] { return set_line(); });
  }

 private:
  Result<void> set_counters();
  Result<void> set_line();
  Result<void> set_trigger_edge();
  Result<void> set_least(const std::string& name);
  Result<void> set_no_delay();
  Result<void> set_line_upright();
  bool is_line_told() const;
  void note_missing_level();
  Result<void> set_no_debounce();
  Result<void> set_line_debounce();
  void note(const std::string& text);

  const AravisFeatures& features_;
  const CameraSettings& settings_;
  AravisSetup& setup_;
};

// Counter0 counts pulses on the trigger line, where the camera has counters.
Result<void> TriggerSetting::set_counters() {
  if (!features_.has("CounterValue") || !features_.has("CounterSelector")) return {};
  if (auto set = features_.set_text("CounterSelector", "Counter0"); !set) return set;
  const std::string source = features_.text("CounterEventSource").value_or("");
  setup_.has_trigger_counter =
      source == "FrameTrigger" ||
      features_.set_entry_if_present("CounterEventSource", settings_.trigger_line);
  if (settings_.trigger_edge == TriggerEdge::kAny && source != "FrameTrigger")
    setup_.has_trigger_counter =
        setup_.has_trigger_counter &&
        features_.set_entry_if_present("CounterEventActivation", "AnyEdge");
  if (!setup_.has_trigger_counter && setup_.chunks.trigger_count == "ChunkCounterValue")
    setup_.chunks.trigger_count.clear();  // it counts something else
  return {};
}

Result<void> TriggerSetting::set_line() {
  if (features_.has("TriggerSource") &&
      !features_.has_entry("TriggerSource", settings_.trigger_line))
    return failure(Fault::kUnsupported, name_of(settings_) + " has no TriggerSource " +
                                            settings_.trigger_line +
                                            "; correct camera.trigger_line");
  return in_order([&] { return features_.set_text_if_present("TriggerSelector", "FrameStart"); },
                  [&] { return features_.set_text("TriggerMode", "On"); },
                  [&] { return features_.set_text("TriggerSource", settings_.trigger_line); },
                  [&] { return set_no_delay(); }, [&] { return set_line_upright(); },
                  [&] { return set_trigger_edge(); });
}

// A delay that another program has left displaces every exposure alike: no comparison of times
// shows it, and the frames may show the next picture.
Result<void> TriggerSetting::set_no_delay() {
  for (const char* name : kDelayNames)
    if (features_.has(name))
      if (auto set = set_least(name); !set) return set;
  return {};
}

// A number of us; it is zero already where it may not be written.
Result<void> TriggerSetting::set_least(const std::string& name) {
  if (!features_.is_number(name)) return {};
  const Result<double> present_us = features_.number(name);
  if (!present_us) return tl::unexpected(present_us.error());
  if (*present_us <= kDelayRounding_us) return {};
  const auto bounds = features_.number_bounds(name);
  if (!bounds) return tl::unexpected(bounds.error());
  const double least_us = std::max(bounds->first, 0.0);
  if (*present_us <= least_us + kDelayRounding_us) return {};
  return features_.set_number(name, least_us, kDelayRounding_us);
}

// An inverter that another program has left on makes the pulse's end the trigger, and turns what
// the frames tell of the line's level.
Result<void> TriggerSetting::set_line_upright() {
  if (!is_line_told()) return {};
  return in_order([&] { return features_.keep_text("LineSelector", settings_.trigger_line); },
                  [&] {
                    return features_.has("LineInverter")
                               ? features_.keep_flag("LineInverter", false)
                               : Result<void>{};
                  });
}

// A camera without LineSelector has one line.
bool TriggerSetting::is_line_told() const {
  return settings_.trigger_line != kSoftwareTrigger &&
         (!features_.has("LineSelector") ||
          features_.has_entry("LineSelector", settings_.trigger_line));
}

// A photodiode on the line makes an edge of either kind in turn, so the camera must take both; and
// only its own count of them proves that none was missed.
Result<void> TriggerSetting::set_trigger_edge() {
  if (settings_.trigger_edge == TriggerEdge::kRising)
    return in_order(
        [&] { return features_.set_text_if_present("TriggerActivation", "RisingEdge"); },
        [&] { return set_no_debounce(); });
  constexpr const char* kRemedy =
      "; put a trigger box between, and set sequence.sync to \"trigger_box\" in the rig file";
  if (!features_.has_entry("TriggerActivation", "AnyEdge"))
    return failure(Fault::kUnsupported,
                   name_of(settings_) + " has no TriggerActivation AnyEdge but " +
                       joined(features_.entries("TriggerActivation")) + kRemedy);
  if (setup_.chunks.trigger_count.empty())
    return failure(Fault::kUnsupported,
                   name_of(settings_) +
                       " does not say with its frames how many triggers it has seen" + kRemedy);
  return in_order([&] { return features_.set_text("TriggerActivation", "AnyEdge"); },
                  [&] {
                    note_missing_level();
                    return set_line_debounce();
                  });
}

void TriggerSetting::note_missing_level() {
  if (!setup_.identity.tells_line_level)
    note(name_of(settings_) + " does not say with its frames which level " +
         settings_.trigger_line +
         " had (chunk LineStatusAll): the display must keep time for a capture to be complete");
}

// A box's pulses do not bounce, and are as short as the shortest exposure. Those that a debouncer
// swallows are missed frames, which the ledger finds.
Result<void> TriggerSetting::set_no_debounce() {
  if (!is_line_told()) return {};
  for (const char* name : kDebouncerNames) {
    if (!features_.has(name)) continue;
    const Result<double> was_us = features_.number(name);
    const Result<void> set = set_least(name);
    if (!set && set.error().fault == Fault::kDeviceLost) return set;
    if (!set) note(set.error().detail + "; shorter pulses of the trigger box are lost");
    const Result<double> is_us = features_.number(name);
    if (was_us && is_us && *is_us < *was_us)
      note(name_of(settings_) + " had " + name + " " + shown(*was_us) + " us, now " +
           shown(*is_us) +
           " us: the trigger box's pulses are short and clean; if its line rings, " +
           "mend the cable");
  }
  return {};
}

void TriggerSetting::note(const std::string& text) {
  setup_.identity.note.append(setup_.identity.note.empty() ? "" : "; ").append(text);
}

// Each bounce of the photodiode would be a trigger.
Result<void> TriggerSetting::set_line_debounce() {
  const std::string remedy = "correct camera.line_debounce_us in the rig file";
  const auto wanted_us = static_cast<double>(settings_.line_debounce.count());
  if (features_.has("LineSelector"))
    if (auto set = features_.set_text("LineSelector", settings_.trigger_line); !set) return set;
  for (const char* name : kDebouncerNames) {
    if (!features_.has(name) || !features_.is_number(name)) continue;
    const double tolerance_us = std::max(1.0, kDebounceRoundingFrac * wanted_us);
    const Result<double> present_us = features_.number(name);
    if (present_us && std::abs(*present_us - wanted_us) <= tolerance_us) return {};
    const auto bounds = features_.number_bounds(name);
    if (!bounds) return tl::unexpected(bounds.error());
    if (wanted_us < bounds->first || wanted_us > bounds->second)
      return failure(Fault::kOutOfRange,
                     name_of(settings_) + " takes " + name + " from " +
                         std::to_string(std::llround(bounds->first)) + " to " +
                         std::to_string(std::llround(bounds->second)) + " us, not " +
                         std::to_string(settings_.line_debounce.count()) + " us; " + remedy);
    return advising(features_.set_number(name, wanted_us, tolerance_us), remedy);
  }
  if (settings_.line_debounce.count() > 0)
    note(name_of(settings_) + " has no LineDebouncerTime: an edge of " + settings_.trigger_line +
         " that bounces is several triggers; see that the photodiode's level is clean");
  return {};
}

}  // namespace

Result<void> set_trigger(const AravisFeatures& features, const CameraSettings& settings,
                         AravisSetup& setup) {
  return TriggerSetting(features, settings, setup).run();
}

}  // namespace rig
