#include "capture/journal.h"

#include "nlohmann/json.hpp"

namespace capture {
namespace {

using Json = nlohmann::json;

void describe(const rig::PictureShown& shown, Json& line) { line["show_id"] = shown.show_id; }
void describe(const rig::EdgeSeen& edge, Json& line) {
  line["edge_number"] = edge.edge_number;
  line["is_light"] = edge.is_light;
}
void describe(const rig::EdgeIgnored& edge, Json& line) { line["is_light"] = edge.is_light; }
void describe(const rig::PulseEnded& pulse, Json& line) {
  line["pulse_number"] = pulse.pulse_number;
  line["bracket"] = pulse.pulse_index;
}
void describe(const FrameSeen& frame, Json& line) {
  line["frame_id"] = frame.facts.block_id;
  line["pulse_number"] = frame.facts.pulse_number();
}
void describe(const rig::FrameDamaged& damaged, Json& line) {
  line["frame_id"] = damaged.block_id;
  line["detail"] = damaged.error.detail;
}
void describe(const rig::DeviceFault& fault, Json& line) {
  line["device"] = to_string(fault.device);
  line["fault"] = to_string(fault.error.fault);
  line["detail"] = fault.error.detail;
}
void describe(const CommandRefused& refused, Json& line) {
  line["device"] = to_string(refused.device);
  line["fault"] = to_string(refused.error.fault);
  line["detail"] = refused.error.detail;
}
void describe(const Reopened& reopened, Json& line) { line["device"] = to_string(reopened.device); }
void describe(const ReopenRefused& refused, Json& line) {
  line["device"] = to_string(refused.device);
  line["fault"] = to_string(refused.error.fault);
  line["detail"] = refused.error.detail;
}
void describe(const StorageFailed& failed, Json& line) { line["detail"] = failed.text; }
void describe(const Start&, Json&) {}
void describe(const TimePassed&, Json&) {}
void describe(const AbortRequested&, Json&) {}
void describe(const Armed&, Json&) {}

Json positions_of_repeats(const Take& take) {
  Json positions = Json::array();
  for (std::size_t i = 0; i < take.entries.size(); ++i)
    if (take.entries[i].is_repeat) positions.push_back(i);
  return positions;
}

// Names and devices' texts may hold any bytes: replace what is not UTF-8 rather than throw.
std::string as_line(const Json& line) {
  return line.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace

std::map<std::string, std::string> journalled_settings(const rig::RigFile& rig_file) {
  const auto in_us = [](std::chrono::microseconds time) { return std::to_string(time.count()); };
  const auto name_of_sync = [](rig::SyncMode sync) {
    if (sync == rig::SyncMode::kTriggerBox) return "trigger_box";
    return sync == rig::SyncMode::kCameraLine ? "camera_line" : "software";
  };
  return {
      {"sequence.sync", name_of_sync(rig_file.sequence.sync)},
      {"camera.serial", rig_file.camera.serial},
      {"camera.bracketing",
       rig_file.camera.bracketing == rig::Bracketing::kSequencer ? "sequencer" : "trigger_width"},
      {"projector.monitor", rig_file.projector.monitor},
      {"trigger.delay_rise_us", in_us(rig_file.trigger.delay_rise)},
      {"trigger.delay_fall_us", in_us(rig_file.trigger.delay_fall)},
      {"trigger.gap_us", in_us(rig_file.trigger.gap)}};
}

std::string begin_line(const rig::RigFile& rig_file, const Plan& session_plan, const Take& take) {
  Json line{{"event", "take begun"},
            {"order", session_plan.order},
            {"repeats", positions_of_repeats(take)},
            {"settings", journalled_settings(rig_file)}};
  for (const auto exposure : session_plan.exposures)
    line["exposures_us"].push_back(exposure.count());
  return as_line(line);
}

std::string resume_line(int good_count, const Take& take) {
  Json line{{"event", "take resumed"},
            {"good_slots", good_count},
            {"open_slots", take.open_slot_count()},
            {"repeats", positions_of_repeats(take)},
            {"patterns", Json::array()}};
  // The run's positions are its own: here is what they stand for.
  for (const TakeEntry& entry : take.entries) line["patterns"].push_back(entry.pattern);
  return as_line(line);
}

std::string refusal_line(const std::string& text) {
  return as_line({{"event", "resume refused"}, {"detail", text}});
}

std::string latency_line(std::chrono::nanoseconds latency) {
  return as_line(
      {{"event", "latency measured"},
       {"latency_us", std::chrono::duration_cast<std::chrono::microseconds>(latency).count()}});
}

std::string motion_line(const std::string& verdict, std::chrono::nanoseconds verdict_time) {
  return as_line({{"event", "motion judged"},
                  {"verdict", verdict},
                  {"verdict_ms", std::chrono::duration<double, std::milli>(verdict_time).count()}});
}

std::string picture_line(const estimation::PictureCheck& check) {
  Json line{{"event", "pictures checked"},
            {"checked", check.checked_count},
            {"unchecked", check.unchecked.size()},
            {"wrong", Json::array()},
            {"detail", check.text()}};
  for (const estimation::WrongPicture& wrong : check.wrong)
    line["wrong"].push_back({{"pattern", wrong.pattern}, {"bracket", wrong.bracket}});
  return as_line(line);
}

std::string retake_line(const Take& take) {
  Json line{{"event", "take goes on"},
            {"open_slots", take.open_slot_count()},
            {"patterns", Json::array()}};
  for (const TakeEntry& entry : take.entries) line["patterns"].push_back(entry.pattern);
  return as_line(line);
}

std::string journal_line(const Transition& transition, rig::HostTime start) {
  const SequenceState& state = transition.state;
  Json line{
      {"time_us",
       std::chrono::duration_cast<std::chrono::microseconds>(transition.time - start).count()},
      {"event", name_of(transition.event)},
      {"from", transition.from},
      {"to", name_of(state.phase)},
      {"pattern", state.ledger.showing_pattern()},
      {"run", state.run_id}};
  std::visit([&line](const auto& event) { describe(event, line); }, transition.event);
  for (const Reacted& reacted : transition.reacted)
    line["findings"].push_back({{"incident", to_string(reacted.finding.incident)},
                                {"pattern", reacted.finding.pattern},
                                {"bracket", reacted.finding.bracket},
                                {"detail", reacted.finding.detail},
                                {"reaction", to_string(reacted.reaction)}});
  return as_line(line);
}

}  // namespace capture
