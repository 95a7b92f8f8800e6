#include "rig/devices/libusb_trigger.h"

#include <libusb-1.0/libusb.h>

#include <algorithm>
#include <utility>

namespace rig {
namespace {

using std::chrono::milliseconds;
using tb1::Request;

constexpr unsigned kInterface = 0;
constexpr milliseconds kRunEndDeadline{500};  // from DISARM to the last record of the run
constexpr int kClockRoundTripCount = 8;

}  // namespace

// ---- Opening ----

Result<std::unique_ptr<LibusbTrigger>> LibusbTrigger::open(const TriggerSettings& settings,
                                                           EventSink& sink) {
  Result<UsbContext> context = start_libusb();
  if (!context) return tl::unexpected(context.error());
  Result<UsbBox> box = find_usb_box(context->get(), settings);
  if (!box) return tl::unexpected(box.error());
  std::unique_ptr<LibusbTrigger> trigger(
      new LibusbTrigger(settings, sink, *std::move(context), *std::move(box)));
  const Result<void> started = trigger->start();
  if (!started) return tl::unexpected(started.error());
  return trigger;
}

LibusbTrigger::LibusbTrigger(const TriggerSettings& settings, EventSink& sink, UsbContext context,
                             UsbBox box)
    : settings_(settings),
      sink_(sink),
      context_(std::move(context)),
      handle_(std::move(box.handle)) {
  identity_.serial = std::move(box.serial);
}

Result<void> LibusbTrigger::start() {
  libusb_set_auto_detach_kernel_driver(handle_.get(), 1);
  const int code = libusb_claim_interface(handle_.get(), kInterface);
  if (code != 0) {
    return failure(Fault::kAccessDenied,
                   "trigger box " + identity_.serial + " is in use by another program (" +
                       libusb_strerror(code) + "): is a second ssrig running?");
  }
  prepare_transfers();
  event_thread_ = std::jthread([this] { run_events(); });
  return greet();
}

void LibusbTrigger::prepare_transfers() {
  for (std::size_t i = 0; i < kReadCount; ++i) {
    auto read = std::make_unique<Read>();
    read->transfer.reset(libusb_alloc_transfer(0));
    libusb_fill_bulk_transfer(read->transfer.get(), handle_.get(), tb1::kEndpointIn,
                              read->buffer.data(), static_cast<int>(kReadBytes), &on_read, this, 0);
    reads_.push_back(std::move(read));
  }
  time_query_.transfer.reset(libusb_alloc_transfer(0));
  libusb_fill_control_setup(time_query_.buffer.data(), tb1::kRequestTypeIn,
                            static_cast<std::uint8_t>(Request::kGetTime), 0, 0, tb1::kTimeBytes);
  libusb_fill_control_transfer(time_query_.transfer.get(), handle_.get(), time_query_.buffer.data(),
                               &on_time, this, kRequestTimeout_ms);
  question_.transfer.reset(libusb_alloc_transfer(0));
}

Result<void> LibusbTrigger::greet() {
  const auto info_bytes = request_in(Request::kGetInfo, tb1::kInfoBytes);
  if (!info_bytes) return tl::unexpected(info_bytes.error());
  const auto info = tb1::decode_info(*info_bytes);
  if (!info) return tl::unexpected(info.error());
  identity_.protocol_version = info->protocol_version;
  identity_.firmware_version = info->firmware_version;
  if (info->protocol_version != tb1::kProtocolVersion) {
    return failure(Fault::kUnsupported,
                   "trigger box " + identity_.serial + " speaks TB1 version " +
                       std::to_string(info->protocol_version) + ", this program version " +
                       std::to_string(tb1::kProtocolVersion) + ": update its firmware");
  }
  // A program that crashed may have left it armed.
  if (const auto disarmed = request_out(Request::kDisarm, 0, {}); !disarmed) return disarmed;
  return synchronise_clock();
}

LibusbTrigger::~LibusbTrigger() {
  disarm();
  {
    const std::lock_guard lock(mutex_);
    is_stopping_ = true;
  }
  if (event_thread_.joinable()) {
    libusb_interrupt_event_handler(context_.get());
    event_thread_.join();
  }
}

// ---- Session thread ----

Result<void> LibusbTrigger::arm(const std::vector<std::chrono::microseconds>& pulse_widths,
                                std::uint32_t run_id) {
  if (is_armed_) {
    return failure(Fault::kBusy, "trigger box " + identity_.serial + " is armed already");
  }
  if (const auto configured = configure(pulse_widths); !configured) return configured;
  if (const auto synchronised = synchronise_clock(); !synchronised) return synchronised;
  const auto wire_id = fresh_wire_id(run_id);
  if (!wire_id) return tl::unexpected(wire_id.error());
  {
    const std::lock_guard lock(mutex_);
    run_.emplace(*wire_id);
    run_id_ = *wire_id;
  }
  const auto armed = request_out(Request::kArm, *wire_id, {});
  is_armed_ = armed.has_value();
  if (armed) return {};
  // It may have come through all the same.
  const auto disarmed = request_out(Request::kDisarm, 0, {});
  const std::lock_guard lock(mutex_);
  run_.reset();
  Error error = armed.error();
  if (!disarmed) error.detail += "; until then it may be armed";
  return tl::unexpected(std::move(error));
}

// Another program, killed while armed, may have used the same id: the last records of its run,
// still under way, would pass for this one's, and its end for ours.
Result<std::uint16_t> LibusbTrigger::fresh_wire_id(std::uint32_t run_id) {
  const auto bytes = request_in(Request::kGetStatus, tb1::kStatusBytes);
  if (!bytes) return tl::unexpected(bytes.error());
  const auto status = tb1::decode_status(*bytes);
  if (!status) return tl::unexpected(status.error());
  const std::uint16_t wire_id = tb1::wire_run_id(run_id);
  if (wire_id != status->run_id) return wire_id;
  return static_cast<std::uint16_t>(wire_id % 0xFFFF + 1);  // never 0, which is no run
}

Result<void> LibusbTrigger::configure(const std::vector<std::chrono::microseconds>& pulse_widths) {
  const auto config = tb1::make_config(settings_, pulse_widths);
  if (!config) return tl::unexpected(config.error());
  const auto wanted = tb1::encode(*config);
  // Armed by an arming or left so by a disarming whose answer was lost, it would refuse.
  if (const auto disarmed = request_out(Request::kDisarm, 0, {}); !disarmed) return disarmed;
  if (const auto set = request_out(Request::kSetConfig, 0, wanted); !set) return set;
  const auto present = request_in(Request::kGetConfig, tb1::kConfigBytes);
  if (!present) return tl::unexpected(present.error());
  if (!std::equal(wanted.begin(), wanted.end(), present->begin(), present->end())) {
    return failure(Fault::kReadBackMismatch,
                   "trigger box " + identity_.serial +
                       " reads back another configuration than was written: plug it in again, "
                       "and check its cable");
  }
  return {};
}

void LibusbTrigger::disarm() noexcept {
  if (!std::exchange(is_armed_, false)) return;
  const auto disarmed = request_out(Request::kDisarm, 0, {});
  std::unique_lock lock(mutex_);
  if (disarmed) {
    run_ended_.wait_for(lock, kRunEndDeadline, [this] { return !run_ || is_lost_; });
  }
  run_.reset();
  const bool is_lost = is_lost_;
  lock.unlock();
  if (!disarmed && !is_lost) post_fault(disarmed.error().fault, disarmed.error().detail);
}

Result<TriggerCounters> LibusbTrigger::counters() {
  const auto bytes = request_in(Request::kGetStatus, tb1::kStatusBytes);
  if (!bytes) return tl::unexpected(bytes.error());
  const auto status = tb1::decode_status(*bytes);
  if (!status) return tl::unexpected(status.error());
  return TriggerCounters{status->edge_count, status->pulse_count, status->ignored_edge_count,
                         status->dropped_record_count};
}

Result<tb1::Levels> LibusbTrigger::levels() {
  const auto bytes = request_in(Request::kGetLevel, tb1::kLevelsBytes);
  if (!bytes) return tl::unexpected(bytes.error());
  return tb1::decode_levels(*bytes);
}

double LibusbTrigger::clock_drift_ppm() const {
  const std::lock_guard lock(mutex_);
  return clock_.drift_ppm();
}

std::chrono::nanoseconds LibusbTrigger::clock_uncertainty() const {
  const std::lock_guard lock(mutex_);
  return clock_.best_uncertainty();
}

Result<void> LibusbTrigger::synchronise_clock() {
  for (int i = 0; i < kClockRoundTripCount; ++i) {
    const HostTime sent = HostClock::now();
    const auto bytes = request_in(Request::kGetTime, tb1::kTimeBytes);
    if (!bytes) return tl::unexpected(bytes.error());
    const auto time_us = tb1::decode_time(*bytes);
    if (!time_us) return tl::unexpected(time_us.error());
    const std::lock_guard lock(mutex_);
    const auto half = (question_.answered - sent) / 2;
    clock_.add(tb1::to_time_point(*time_us), sent + half, half);
  }
  return {};
}

}  // namespace rig
