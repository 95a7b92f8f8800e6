#include "hw_sim/devices/sim_trigger.h"

#include <utility>

namespace hw_sim {
namespace {

namespace tb1 = rig::tb1;
using std::chrono::microseconds;

constexpr std::chrono::nanoseconds kClockUncertainty{1000};  // the box's clock ticks in us
constexpr auto kSilenceLimit = 4 * tb1::kHeartbeatPeriod;    // of the driver

rig::Error lost() {
  return {rig::Fault::kDeviceLost, "the trigger box is gone; plug it in and start again"};
}

}  // namespace

SimTrigger::SimTrigger(rig::TriggerSettings settings, FaultSchedule& faults, Timeline& timeline,
                       OnPulse on_pulse)
    : settings_(std::move(settings)),
      faults_(faults),
      timeline_(timeline),
      on_pulse_(std::move(on_pulse)),
      box_(timeline.now()) {}

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
  faults_.armed();
  catch_up();
  return {};
}

void SimTrigger::disarm() noexcept {
  reader_.reset();
  faults_.disarmed();
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

void SimTrigger::silence_until(rig::HostTime end) {
  silent_until_ = end;
  if (end - timeline_.now() < kSilenceLimit) return;
  timeline_.schedule(timeline_.now() + kSilenceLimit, [this] {
    if (is_lost_) return;
    timeline_.post(rig::DeviceFault{
        rig::Device::kTrigger,
        {rig::Fault::kTimeout, "the trigger box sends no heartbeat; unplug it, plug it in again"}});
  });
}

void SimTrigger::take_train_faults() {
  if (faults_.take(FaultKind::kUsbGap)) drops_next_record_ = true;
  if (const auto silent = faults_.take(FaultKind::kUsbSilent))
    silence_until(timeline_.now() + silent->duration);
  if (faults_.take(FaultKind::kUsbStall))
    timeline_.post(rig::DeviceFault{
        rig::Device::kTrigger,
        {rig::Fault::kProtocol, "the trigger box's endpoint stalled and was read again"}});
}

void SimTrigger::photodiode(int level_adc) {
  level_adc_ = level_adc;
  if (is_lost_) return;
  box_.light(timeline_.now(), level_adc);
  catch_up();
}

void SimTrigger::catch_up() {
  if (is_lost_) return;
  const BoxOutput output = box_.advance(timeline_.now());
  for (const LinePulse& pulse : output.pulses) {
    if (pulse.index == 0) {
      faults_.train_started();
      take_train_faults();
    }
    faults_.pulse_started(pulse.index);
    on_pulse_(pulse);
    if (is_lost_) return;
  }
  for (const tb1::Record& record : output.records) hear(record);
  const auto due = box_.next_due();
  if (!due) return;
  timeline_.schedule(*due, [this, number = ++wake_up_number_] {
    if (number == wake_up_number_) catch_up();
  });
}

void SimTrigger::hear(const tb1::Record& record) {
  if (timeline_.now() < silent_until_ || std::exchange(drops_next_record_, false)) return;
  if (record.type == tb1::RecordType::kHeartbeat || !clock_.is_ready())
    clock_.add(rig::BoxClock::time_point(microseconds(box_.time_us(timeline_.now()))),
               timeline_.now(), kClockUncertainty);
  if (!reader_) return;
  for (rig::Event& event : reader_->read(record, clock_)) timeline_.post(std::move(event));
}

void SimTrigger::plug_in() {
  is_plugged_in_ = true;
  box_ = TriggerBoxModel(timeline_.now());
}

rig::Result<void> SimTrigger::open_again() {
  if (!is_plugged_in_)
    return rig::failure(rig::Fault::kNotFound, "no trigger box on USB; check its cable");
  disarm();
  is_lost_ = false;
  clock_ = {};
  photodiode(level_adc_);
  return {};
}

void SimTrigger::unplug() {
  is_plugged_in_ = false;
  if (std::exchange(is_lost_, true)) return;
  timeline_.post(rig::DeviceFault{rig::Device::kTrigger, lost()});
}

}  // namespace hw_sim
