#include "hw_sim/usb/usb_trigger_box.h"

#include <algorithm>
#include <utility>

#include "rig/trigger_box_protocol.h"

namespace hw_sim {
namespace {

using rig::HostClock;
using rig::HostTime;
using rig::tb1::Request;

// What a small microcontroller would keep for a host that does not read: 128 records.
constexpr std::size_t kQueuedPacketLimit = 64;
constexpr int kMiddle_adc = 512;
constexpr int kDark_adc = 100, kLight_adc = 900;
// A flash in the room, beyond the debounce time; chatter of an edge, within it.
constexpr std::chrono::microseconds kFlashDelay{5000}, kFlashDuration{1000};
constexpr std::chrono::microseconds kBounceDelay{200}, kBounceDuration{100};

}  // namespace

UsbTriggerBox::UsbTriggerBox(UsbTestbed& testbed, UsbTriggerBoxOptions options, OnPulse on_pulse)
    : testbed_(testbed),
      options_(std::move(options)),
      on_pulse_(std::move(on_pulse)),
      next_address_(options_.address),
      model_(HostClock::now(), options_.drift_ppm) {
  replug();
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

UsbTriggerBox::~UsbTriggerBox() {
  thread_.request_stop();
  thread_.join();  // before the devices that it sends to
}

void UsbTriggerBox::replug() {
  const std::lock_guard lock(mutex_);
  if (std::exchange(is_plugged_in_, true)) return;
  model_ = TriggerBoxModel(HostClock::now(), options_.drift_ppm);
  model_.light(HostClock::now(), level_adc_);
  plug_in();
  has_changed_ = true;
  changed_.notify_all();
}

void UsbTriggerBox::plug_in() {
  devices_.push_back(std::make_unique<UsbfsDevice>(
      testbed_, next_address_,
      UsbDescription{.vendor_id = options_.vendor_id,
                     .product_id = options_.product_id,
                     .endpoint_in = rig::tb1::kEndpointIn,
                     .packet_bytes = rig::tb1::kPacketBytes,
                     .manufacturer = "ssrig",
                     .product = "Trigger box (simulated)",
                     .serial = options_.serial},
      [this](const UsbSetup& setup, const std::vector<std::uint8_t>& data) {
        return control(setup, data);
      }));
  ++next_address_.device;
}

void UsbTriggerBox::unplug() {
  const std::lock_guard lock(mutex_);
  if (!std::exchange(is_plugged_in_, false)) return;
  devices_.back()->unplug();
}

void UsbTriggerBox::light(HostTime time, int level_adc) {
  const std::lock_guard lock(mutex_);
  coming_light_.emplace(time, level_adc);
  has_changed_ = true;
  changed_.notify_all();
}

void UsbTriggerBox::stall_in() {
  const std::lock_guard lock(mutex_);
  devices_.back()->stall_in();
}

void UsbTriggerBox::drop_next_record() {
  const std::lock_guard lock(mutex_);
  drops_next_record_ = true;
}

void UsbTriggerBox::set_mute(bool is_mute) {
  const std::lock_guard lock(mutex_);
  is_mute_ = is_mute;
}

void UsbTriggerBox::set_control_naked(bool is_naked) {
  const std::lock_guard lock(mutex_);
  is_control_naked_ = is_naked;
}

void UsbTriggerBox::corrupt_next_config() {
  const std::lock_guard lock(mutex_);
  corrupts_next_config_ = true;
}

void UsbTriggerBox::refuse_claims(bool is_refusing) {
  const std::lock_guard lock(mutex_);
  devices_.back()->refuse_claims(is_refusing);
}

UsbReply UsbTriggerBox::control(const UsbSetup& setup, const std::vector<std::uint8_t>& data) {
  const std::lock_guard lock(mutex_);
  if (is_control_naked_) return UsbNoAnswer{};
  const auto request = static_cast<Request>(setup.request);
  const bool sends_out = request == Request::kSetConfig || request == Request::kArm ||
                         request == Request::kDisarm || request == Request::kSoftTrigger;
  if (sends_out == setup.is_in()) return UsbStall{};
  const HostTime now = HostClock::now();
  see_light_until(now);
  auto reply = model_.control(setup.request, setup.value, data, now);
  if (!reply) return UsbStall{};
  if (request == Request::kArm) devices_.back()->discard_packets();
  if (options_.faults != nullptr && request == Request::kArm) options_.faults->armed();
  if (options_.faults != nullptr && request == Request::kDisarm) options_.faults->disarmed();
  if (request == Request::kGetConfig && std::exchange(corrupts_next_config_, false)) {
    reply->at(reply->size() - 1) ^= 0xFF;
  }
  has_changed_ = true;
  changed_.notify_all();
  return *std::move(reply);
}

void UsbTriggerBox::see_light_until(HostTime now) {
  const auto end = coming_light_.upper_bound(now);
  for (auto light = coming_light_.begin(); light != end; ++light) {
    level_adc_ = light->second;
    if (is_plugged_in_) model_.light(light->first, level_adc_);
  }
  coming_light_.erase(coming_light_.begin(), end);
}

void UsbTriggerBox::start_train(HostTime now) {
  FaultSchedule& faults = *options_.faults;
  faults.train_started();
  if (faults.take(FaultKind::kLightFlash)) disturb_light(now + kFlashDelay, kFlashDuration);
  if (faults.take(FaultKind::kEdgeBounced)) disturb_light(now + kBounceDelay, kBounceDuration);
  if (faults.take(FaultKind::kUsbGap)) drops_next_record_ = true;
  if (faults.take(FaultKind::kUsbStall)) devices_.back()->stall_in();
  if (const auto silent = faults.take(FaultKind::kUsbSilent))
    silent_until_ = now + silent->duration;
}

void UsbTriggerBox::disturb_light(HostTime start, std::chrono::microseconds duration) {
  coming_light_.emplace(start, level_adc_ > kMiddle_adc ? kDark_adc : kLight_adc);
  coming_light_.emplace(start + duration, level_adc_);
}

// Two records a packet; the last packet is a short one, else the host would wait for more.
void UsbTriggerBox::send(std::vector<rig::tb1::Record> records) {
  if (!records.empty() && std::exchange(drops_next_record_, false)) records.erase(records.begin());
  if (records.empty() || is_mute_ || HostClock::now() < silent_until_) return;
  std::vector<std::uint8_t> packet;
  for (const rig::tb1::Record& record : records) {
    const auto bytes = rig::tb1::encode(record);
    packet.insert(packet.end(), bytes.begin(), bytes.end());
    if (packet.size() == rig::tb1::kPacketBytes) {
      devices_.back()->send(std::exchange(packet, {}));
    }
  }
  devices_.back()->send(std::move(packet));
}

HostTime UsbTriggerBox::next_due() const {
  HostTime due = HostTime::max();
  if (is_plugged_in_) due = model_.next_due().value_or(due);
  if (!coming_light_.empty()) due = std::min(due, coming_light_.begin()->first);
  return due;
}

void UsbTriggerBox::run(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (!stop.stop_requested()) {
    has_changed_ = false;
    const HostTime now = HostClock::now();
    see_light_until(now);
    if (is_plugged_in_) {
      model_.set_queue_full(devices_.back()->waiting_packet_count() >= kQueuedPacketLimit);
      BoxOutput output = model_.advance(now);
      if (options_.faults != nullptr)
        for (const LinePulse& pulse : output.pulses)
          if (pulse.index == 0) start_train(pulse.start);
      send(std::move(output.records));
      lock.unlock();
      for (const LinePulse& pulse : output.pulses) {
        if (options_.faults != nullptr) options_.faults->pulse_started(pulse.index);
        on_pulse_(pulse);
      }
      lock.lock();
    }
    // Unplugged and in the dark there is nothing due; a day is then as good as for ever.
    const HostTime deadline = std::min(next_due(), now + std::chrono::hours(24));
    changed_.wait_until(lock, stop, deadline, [this] { return has_changed_; });
  }
}

}  // namespace hw_sim
