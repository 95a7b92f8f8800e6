// The event thread of LibusbTrigger: eight reads in flight, records into events, the box's clock
// and heartbeat, and the loss of the device.
#include <libusb-1.0/libusb.h>

#include <algorithm>
#include <chrono>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rig/devices/libusb_trigger.h"

namespace rig {
namespace {

using std::chrono::milliseconds;
using tb1::RecordType;

constexpr milliseconds kTeardownDeadline{1000};
// How long the event thread sleeps without an event: it also looks after the heartbeat.
constexpr milliseconds kEventPoll{50};
// Three missed, and the fourth is due.
constexpr milliseconds kSilenceLimit = 4 * tb1::kHeartbeatPeriod;
// Reads that fail without a good one between them, all eight in flight twice: then it is no glitch.
constexpr int kFailedReadLimit = 16;

}  // namespace

void LibusbTrigger::run_events() {
  last_heartbeat_ = HostClock::now();
  for (const auto& read : reads_) submit(*read);
  std::optional<HostTime> give_up;
  while (true) {
    if (!give_up && is_stopping()) {
      give_up = HostClock::now() + kTeardownDeadline;
      cancel_transfers();
    }
    if (give_up && (!has_transfer_in_flight() || HostClock::now() > *give_up)) return;
    timeval poll{0, std::chrono::microseconds(kEventPoll).count()};
    libusb_handle_events_timeout_completed(context_.get(), &poll, nullptr);
    repeat_failed_reads();
    check_heartbeat();
  }
}

void LibusbTrigger::on_read(libusb_transfer* transfer) {
  auto& self = *static_cast<LibusbTrigger*>(transfer->user_data);
  const auto found = std::find_if(self.reads_.begin(), self.reads_.end(), [&](const auto& read) {
    return read->transfer.get() == transfer;
  });
  Read& read = **found;
  read.is_in_flight = false;
  switch (transfer->status) {
    case LIBUSB_TRANSFER_COMPLETED:
      self.failed_read_count_ = 0;
      self.take_records(
          std::span(read.buffer).first(static_cast<std::size_t>(transfer->actual_length)));
      self.submit(read);
      return;
    case LIBUSB_TRANSFER_CANCELLED:
      return;
    case LIBUSB_TRANSFER_NO_DEVICE:
      self.lose_device();
      return;
    case LIBUSB_TRANSFER_STALL:
      self.read_failure_ = "the endpoint stalled";
      break;
    case LIBUSB_TRANSFER_OVERFLOW:
      self.read_failure_ = "a packet was too long";
      break;
    case LIBUSB_TRANSFER_ERROR:
    case LIBUSB_TRANSFER_TIMED_OUT:
      self.read_failure_ = "a transfer failed";
      break;
  }
  read.has_failed = true;
  ++self.failed_read_count_;
}

// Outside the callbacks, where libusb allows a call that waits.
void LibusbTrigger::repeat_failed_reads() {
  const auto has_failed = [](const auto& read) { return read->has_failed; };
  if (std::none_of(reads_.begin(), reads_.end(), has_failed)) return;
  if (failed_read_count_ > kFailedReadLimit) {
    lose_device();
  } else {
    const int code = libusb_clear_halt(handle_.get(), tb1::kEndpointIn);
    if (code == LIBUSB_ERROR_NO_DEVICE) {
      lose_device();
    } else {
      post_fault(Fault::kProtocol, "reading from trigger box " + identity_.serial + " failed (" +
                                       read_failure_ + "); it was repeated: check the cable");
    }
  }
  for (const auto& read : reads_) {
    if (std::exchange(read->has_failed, false)) submit(*read);
  }
}

void LibusbTrigger::submit(Read& read) {
  if (is_closing()) return;
  const int code = libusb_submit_transfer(read.transfer.get());
  read.is_in_flight = code == 0;
  if (code == LIBUSB_ERROR_NO_DEVICE) {
    lose_device();
  } else if (code != 0) {
    read_failure_ = libusb_strerror(code);
    read.has_failed = true;
    ++failed_read_count_;
  }
}

// Looked at before each submission, and true before the transfers are cancelled: one that goes on
// by itself would outlive its cancelling.
bool LibusbTrigger::is_closing() const {
  const std::lock_guard lock(mutex_);
  return is_stopping_ || is_lost_;
}

bool LibusbTrigger::is_stopping() const {
  const std::lock_guard lock(mutex_);
  return is_stopping_;
}

void LibusbTrigger::take_records(std::span<const std::uint8_t> bytes) {
  const auto records = tb1::decode_records(bytes);
  if (!records) {
    post_fault(records.error().fault, records.error().detail);
    return;
  }
  for (const tb1::Record& record : *records) take_record(record);
}

void LibusbTrigger::take_record(const tb1::Record& record) {
  if (record.type == RecordType::kHeartbeat) {
    last_heartbeat_ = HostClock::now();
    query_time();
  }
  std::vector<Event> events;
  {
    const std::lock_guard lock(mutex_);
    if (!run_) return;
    events = run_->read(record, clock_);
    if (record.type == RecordType::kDisarmed && record.run_id == run_id_) {
      run_.reset();
      run_ended_.notify_all();
    }
  }
  for (Event& event : events) sink_.post(std::move(event));
}

void LibusbTrigger::query_time() {
  if (time_query_.is_in_flight || is_closing()) return;
  time_query_.sent = HostClock::now();
  time_query_.is_in_flight = libusb_submit_transfer(time_query_.transfer.get()) == 0;
}

void LibusbTrigger::on_time(libusb_transfer* transfer) {
  auto& self = *static_cast<LibusbTrigger*>(transfer->user_data);
  const HostTime received = HostClock::now();
  self.time_query_.is_in_flight = false;
  // One that fails is one sample less; the next heartbeat asks again.
  if (transfer->status != LIBUSB_TRANSFER_COMPLETED) return;
  const auto answer = std::span(self.time_query_.buffer).subspan(LIBUSB_CONTROL_SETUP_SIZE);
  const auto time_us =
      tb1::decode_time(answer.first(static_cast<std::size_t>(transfer->actual_length)));
  if (!time_us) return;
  const auto half = (received - self.time_query_.sent) / 2;
  const std::lock_guard lock(self.mutex_);
  self.clock_.add(tb1::to_time_point(*time_us), self.time_query_.sent + half, half);
}

void LibusbTrigger::check_heartbeat() {
  if (is_closing()) return;
  const auto silence = HostClock::now() - last_heartbeat_;
  const bool is_silent = silence > kSilenceLimit;
  if (is_silent == std::exchange(has_reported_silence_, is_silent) || !is_silent) return;
  post_fault(Fault::kTimeout, "trigger box " + identity_.serial + " sends no heartbeat since " +
                                  std::to_string(silence / milliseconds(1)) +
                                  " ms: plug it in again");
}

void LibusbTrigger::cancel_transfers() {
  for (const auto& read : reads_) {
    if (read->is_in_flight) libusb_cancel_transfer(read->transfer.get());
  }
  if (time_query_.is_in_flight) libusb_cancel_transfer(time_query_.transfer.get());
  const std::lock_guard lock(mutex_);
  if (question_.is_in_flight) libusb_cancel_transfer(question_.transfer.get());
}

bool LibusbTrigger::has_transfer_in_flight() const {
  const bool is_reading = std::any_of(reads_.begin(), reads_.end(),
                                      [](const auto& read) { return read->is_in_flight; });
  const std::lock_guard lock(mutex_);
  return is_reading || time_query_.is_in_flight || question_.is_in_flight;
}

void LibusbTrigger::post_fault(Fault fault, std::string detail) {
  sink_.post(DeviceFault{Device::kTrigger, {fault, std::move(detail)}});
}

void LibusbTrigger::lose_device() {
  {
    const std::lock_guard lock(mutex_);
    if (std::exchange(is_lost_, true)) return;
  }
  run_ended_.notify_all();
  sink_.post(DeviceFault{Device::kTrigger, gone()});
}

}  // namespace rig
