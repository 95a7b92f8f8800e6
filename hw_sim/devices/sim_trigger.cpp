#include "hw_sim/devices/sim_trigger.h"

#include <utility>

namespace hw_sim {
namespace {

namespace tb1 = rig::tb1;
using std::chrono::microseconds;

// Photodiode levels far on either side of any sensible thresholds.
constexpr int kLightAdc = 900;
constexpr int kDarkAdc = 100;
constexpr std::chrono::nanoseconds kClockUncertainty{1000};  // the box's clock ticks in us
constexpr microseconds kFlashDelay{5000};                    // beyond the debounce time
constexpr microseconds kFlashDuration{1000};

int level_of(bool is_light) { return is_light ? kLightAdc : kDarkAdc; }

rig::Error lost() {
  return {rig::Fault::kDeviceLost, "the trigger box is gone; plug it in and start again"};
}

}  // namespace

SimTrigger::SimTrigger(rig::TriggerSettings settings, const SimFaults& faults, Timeline& timeline,
                       OnPulse on_pulse)
    : settings_(std::move(settings)),
      faults_(faults),
      timeline_(timeline),
      on_pulse_(std::move(on_pulse)),
      box_(timeline.now()) {
  photodiode(kDarkAdc);
}

rig::Result<void> SimTrigger::arm(const std::vector<microseconds>& pulse_widths,
                                  std::uint32_t run_id) {
  if (is_lost_) return tl::unexpected(lost());
  if (reader_) return rig::failure(rig::Fault::kBusy, "the trigger box is armed; disarm it first");
  const auto config = tb1::make_config(settings_, pulse_widths);
  if (!config) return tl::unexpected(config.error());
  const auto bytes = tb1::encode(*config);
  if (!request(tb1::Request::kSetConfig, 0, {bytes.begin(), bytes.end()}))
    return rig::failure(rig::Fault::kOutOfRange, "the trigger box refused its configuration");
  const auto read_back = request(tb1::Request::kGetConfig);
  const auto taken = read_back ? tb1::decode_config(*read_back) : tb1::decode_config({});
  if (!taken || *taken != *config)
    return rig::failure(rig::Fault::kReadBackMismatch, "the trigger box kept another setting");
  reader_.emplace(run_id);
  if (!request(tb1::Request::kArm, tb1::wire_run_id(run_id)))
    return rig::failure(rig::Fault::kProtocol, "the trigger box refused to arm");
  catch_up();
  return {};
}

void SimTrigger::disarm() noexcept {
  reader_.reset();
  if (is_lost_) return;
  request(tb1::Request::kDisarm);
  catch_up();
}

rig::Result<rig::TriggerCounters> SimTrigger::counters() {
  if (is_lost_) return tl::unexpected(lost());
  const auto status = tb1::decode_status(*request(tb1::Request::kGetStatus));
  if (!status) return tl::unexpected(status.error());
  return rig::TriggerCounters{status->edge_count, status->pulse_count, status->ignored_edge_count,
                              status->dropped_record_count};
}

std::optional<std::vector<std::uint8_t>> SimTrigger::request(
    tb1::Request request, std::uint16_t value, const std::vector<std::uint8_t>& data) {
  return box_.control(static_cast<std::uint8_t>(request), value, data, timeline_.now());
}

void SimTrigger::square(bool is_light) {
  const bool is_change = is_light != is_square_light_;
  is_square_light_ = is_light;
  if (is_change && faults_.missed_edges.contains(++change_count_)) return;
  photodiode(level_of(is_light));
}

void SimTrigger::photodiode(int level_adc) {
  if (is_lost_) return;
  box_.light(timeline_.now(), level_adc);
  catch_up();
}

void SimTrigger::catch_up() {
  if (is_lost_) return;
  const BoxOutput output = box_.advance(timeline_.now());
  for (const LinePulse& pulse : output.pulses)
    if (!faults_.dropped_pulses.contains(++pulse_count_)) on_pulse_(pulse);
  for (const tb1::Record& record : output.records) hear(record);
  const auto due = box_.next_due();
  if (!due) return;
  timeline_.schedule(*due, [this, number = ++wake_up_number_] {
    if (number == wake_up_number_) catch_up();
  });
}

void SimTrigger::hear(const tb1::Record& record) {
  if (is_lost_) return;
  if (record.type == tb1::RecordType::kHeartbeat || !clock_.is_ready())
    clock_.add(rig::BoxClock::time_point(microseconds(box_.time_us(timeline_.now()))),
               timeline_.now(), kClockUncertainty);
  if (!reader_) return;
  if (record.type == tb1::RecordType::kEdge) {
    if (faults_.trigger_lost_at_edge == ++edge_count_) return lose();
    if (faults_.light_flashes.contains(edge_count_)) flash();
  }
  for (rig::Event& event : reader_->read(record, clock_)) timeline_.post(std::move(event));
}

// Another light in the room: the photodiode sees the opposite of the square for a moment.
void SimTrigger::flash() {
  const rig::HostTime start = timeline_.now() + kFlashDelay;
  timeline_.schedule(start, [this] { photodiode(level_of(!is_square_light_)); });
  timeline_.schedule(start + kFlashDuration, [this] { photodiode(level_of(is_square_light_)); });
}

void SimTrigger::lose() {
  is_lost_ = true;
  timeline_.post(rig::DeviceFault{rig::Device::kTrigger, lost()});
}

}  // namespace hw_sim
