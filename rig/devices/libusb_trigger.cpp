#include "rig/devices/libusb_trigger.h"

#include <libusb-1.0/libusb.h>

#include <algorithm>
#include <cstdio>
#include <utility>

namespace rig {
namespace {

using std::chrono::milliseconds;
using tb1::RecordType;
using tb1::Request;

constexpr unsigned kInterface = 0;
constexpr unsigned kRequestTimeout_ms = 500;
constexpr milliseconds kRunEndDeadline{500};  // from DISARM to the last record of the run
constexpr milliseconds kTeardownDeadline{1000};
// How long the event thread sleeps without an event: it also looks after the heartbeat.
constexpr milliseconds kEventPoll{50};
// Three missed, and the fourth is due.
constexpr milliseconds kSilenceLimit = 4 * tb1::kHeartbeatPeriod;
constexpr int kClockRoundTripCount = 8;
// Reads that fail without a good one between them, all eight in flight twice: then it is no glitch.
constexpr int kFailedReadLimit = 16;

std::string usb_id(const TriggerSettings& settings) {
  std::array<char, 16> text{};
  std::snprintf(text.data(), text.size(), "%04x:%04x", unsigned{settings.vendor_id},
                unsigned{settings.product_id});
  return text.data();
}

std::string place_of(libusb_device* device) {
  return "bus " + std::to_string(libusb_get_bus_number(device)) + " device " +
         std::to_string(libusb_get_device_address(device));
}

std::string to_string(Request request) {
  switch (request) {
    case Request::kGetInfo:
      return "GET_INFO";
    case Request::kSetConfig:
      return "SET_CONFIG";
    case Request::kGetConfig:
      return "GET_CONFIG";
    case Request::kArm:
      return "ARM";
    case Request::kDisarm:
      return "DISARM";
    case Request::kGetStatus:
      return "GET_STATUS";
    case Request::kGetTime:
      return "GET_TIME";
    case Request::kSoftTrigger:
      return "SOFT_TRIGGER";
    case Request::kGetLevel:
      return "GET_LEVEL";
  }
  return "unknown request";
}

Error access_denied(libusb_device* device, const TriggerSettings& settings) {
  return {Fault::kAccessDenied,
          "trigger box " + usb_id(settings) + " at " + place_of(device) +
              " may not be opened by this user: copy config/60-ssrig-trigger-box.rules to "
              "/etc/udev/rules.d, run 'udevadm control --reload', and plug it in again"};
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

// Frees the list of libusb_get_device_list(), devices with it.
class DeviceList {
 public:
  explicit DeviceList(libusb_context* context)
      : count_(libusb_get_device_list(context, &devices_)) {}
  ~DeviceList() {
    if (devices_ != nullptr) libusb_free_device_list(devices_, 1);
  }
  DeviceList(const DeviceList&) = delete;
  DeviceList& operator=(const DeviceList&) = delete;

  std::vector<libusb_device*> of(const TriggerSettings& settings) const {
    std::vector<libusb_device*> found;
    for (ssize_t i = 0; i < count_; ++i) {
      libusb_device_descriptor descriptor{};
      const bool is_readable = libusb_get_device_descriptor(devices_[i], &descriptor) == 0;
      if (is_readable && descriptor.idVendor == settings.vendor_id &&
          descriptor.idProduct == settings.product_id) {
        found.push_back(devices_[i]);
      }
    }
    return found;
  }

 private:
  libusb_device** devices_ = nullptr;
  ssize_t count_;
};

std::string serial_of(libusb_device_handle* handle) {
  libusb_device_descriptor descriptor{};
  if (libusb_get_device_descriptor(libusb_get_device(handle), &descriptor) != 0) return {};
  std::array<unsigned char, 128> text{};
  const int size = libusb_get_string_descriptor_ascii(handle, descriptor.iSerialNumber, text.data(),
                                                      static_cast<int>(text.size()));
  return size > 0 ? std::string(text.begin(), text.begin() + size) : std::string();
}

}  // namespace

void LibusbTrigger::ContextExit::operator()(libusb_context* context) const { libusb_exit(context); }
void LibusbTrigger::HandleClose::operator()(libusb_device_handle* handle) const {
  libusb_close(handle);
}
void LibusbTrigger::TransferFree::operator()(libusb_transfer* transfer) const {
  libusb_free_transfer(transfer);
}

// ---- Opening ----

Result<std::unique_ptr<LibusbTrigger>> LibusbTrigger::open(const TriggerSettings& settings,
                                                           EventSink& sink) {
  Result<Context> context = start_libusb();
  if (!context) return tl::unexpected(context.error());
  Result<Found> found = find(context->get(), settings);
  if (!found) return tl::unexpected(found.error());
  std::unique_ptr<LibusbTrigger> trigger(
      new LibusbTrigger(settings, sink, *std::move(context), *std::move(found)));
  const Result<void> started = trigger->start();
  if (!started) return tl::unexpected(started.error());
  return trigger;
}

Result<LibusbTrigger::Context> LibusbTrigger::start_libusb() {
  libusb_context* context = nullptr;
  const int code = libusb_init(&context);
  if (code != 0) {
    return failure(Fault::kNotFound, std::string("no USB on this computer: ") +
                                         libusb_strerror(code) +
                                         "; are /dev/bus/usb and /sys mounted?");
  }
  return Context(context);
}

Result<LibusbTrigger::Found> LibusbTrigger::find(libusb_context* context,
                                                 const TriggerSettings& settings) {
  const DeviceList list(context);
  const std::vector<libusb_device*> devices = list.of(settings);
  if (devices.empty()) {
    return failure(Fault::kNotFound, "no trigger box " + usb_id(settings) +
                                         " on USB: check its cable and power, and that 'lsusb -d " +
                                         usb_id(settings) + "' lists it");
  }
  std::vector<std::string> serials;
  std::optional<Error> open_error;
  Found match;
  for (libusb_device* device : devices) {
    libusb_device_handle* raw = nullptr;
    const int code = libusb_open(device, &raw);
    if (code != 0) {
      open_error = code == LIBUSB_ERROR_ACCESS
                       ? access_denied(device, settings)
                       : Error{Fault::kDeviceLost, "trigger box at " + place_of(device) +
                                                       " does not open: " + libusb_strerror(code) +
                                                       "; plug it in again"};
      continue;
    }
    Found found{Handle(raw), serial_of(raw)};
    serials.push_back(found.serial.empty() ? "(none)" : found.serial);
    if (settings.serial.empty() || settings.serial == found.serial) match = std::move(found);
  }
  if (settings.serial.empty() && devices.size() > 1) {
    return failure(Fault::kConfiguration,
                   std::to_string(devices.size()) + " trigger boxes " + usb_id(settings) +
                       " on USB (serials " + joined(serials) +
                       "): say in the rig file which one, as trigger.serial");
  }
  if (!match.handle && open_error) return tl::unexpected(*open_error);
  if (!match.handle) {
    return failure(Fault::kNotFound, "no trigger box with serial " + settings.serial +
                                         " on USB, but " + joined(serials) +
                                         ": plug in the right one, or correct trigger.serial in "
                                         "the rig file");
  }
  return match;
}

LibusbTrigger::LibusbTrigger(const TriggerSettings& settings, EventSink& sink, Context context,
                             Found found)
    : settings_(settings),
      sink_(sink),
      context_(std::move(context)),
      handle_(std::move(found.handle)) {
  identity_.serial = std::move(found.serial);
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

Result<void> LibusbTrigger::request_out(Request request, std::uint16_t value,
                                        std::span<const std::uint8_t> data) {
  const auto asked = ask(tb1::kRequestTypeOut, request, value, data, data.size());
  if (!asked) return tl::unexpected(asked.error());
  if (*asked != data.size()) {
    return failure(Fault::kProtocol, "trigger box " + identity_.serial + " took only " +
                                         std::to_string(*asked) + " bytes of " +
                                         to_string(request));
  }
  return {};
}

Result<std::vector<std::uint8_t>> LibusbTrigger::request_in(Request request,
                                                            std::size_t size_bytes) {
  const auto asked = ask(tb1::kRequestTypeIn, request, 0, {}, size_bytes);
  if (!asked) return tl::unexpected(asked.error());
  const auto answer = std::span(question_.buffer).subspan(LIBUSB_CONTROL_SETUP_SIZE, *asked);
  return std::vector<std::uint8_t>(answer.begin(), answer.end());
}

Result<std::size_t> LibusbTrigger::ask(std::uint8_t request_type, Request request,
                                       std::uint16_t value, std::span<const std::uint8_t> data,
                                       std::size_t size_bytes) {
  std::unique_lock lock(mutex_);
  // A box that only stopped to be readable can still be disarmed.
  if (is_lost_ && request != Request::kDisarm) return tl::unexpected(gone());
  if (question_.is_in_flight) {
    return tl::unexpected(transfer_error(request, LIBUSB_TRANSFER_TIMED_OUT));
  }
  libusb_fill_control_setup(question_.buffer.data(), request_type,
                            static_cast<std::uint8_t>(request), value, 0,
                            static_cast<std::uint16_t>(size_bytes));
  std::copy(data.begin(), data.end(), question_.buffer.begin() + LIBUSB_CONTROL_SETUP_SIZE);
  libusb_fill_control_transfer(question_.transfer.get(), handle_.get(), question_.buffer.data(),
                               &on_answer, this, kRequestTimeout_ms);
  question_.is_in_flight = true;
  lock.unlock();
  const int code = libusb_submit_transfer(question_.transfer.get());
  lock.lock();
  if (code != 0) {
    question_.is_in_flight = false;
    lock.unlock();
    return tl::unexpected(submit_error(request, code));
  }
  // libusb keeps the time; ours is for an event thread that does not come back at all.
  const bool is_answered = answered_.wait_for(lock, 4 * milliseconds(kRequestTimeout_ms),
                                              [this] { return !question_.is_in_flight; });
  lock.unlock();
  const int status =
      is_answered ? static_cast<int>(question_.transfer->status) : LIBUSB_TRANSFER_TIMED_OUT;
  if (status != LIBUSB_TRANSFER_COMPLETED) return tl::unexpected(transfer_error(request, status));
  return static_cast<std::size_t>(question_.transfer->actual_length);
}

Error LibusbTrigger::submit_error(Request request, int code) {
  if (code == LIBUSB_ERROR_NO_DEVICE) {
    lose_device();
    return gone();
  }
  return {Fault::kProtocol, "trigger box " + identity_.serial + ": " + to_string(request) +
                                " was not sent: " + libusb_strerror(code)};
}

Error LibusbTrigger::transfer_error(Request request, int status) {
  const std::string box = "trigger box " + identity_.serial;
  switch (status) {
    case LIBUSB_TRANSFER_NO_DEVICE:
      lose_device();
      return gone();
    case LIBUSB_TRANSFER_TIMED_OUT:
      return {Fault::kTimeout,
              box + " does not answer " + to_string(request) + ": plug it in again"};
    case LIBUSB_TRANSFER_STALL:
      return {Fault::kProtocol, box + " refuses " + to_string(request)};
    default:
      return {Fault::kProtocol, box + ": " + to_string(request) + " failed: check the cable"};
  }
}

Error LibusbTrigger::gone() {
  return {Fault::kDeviceLost, "trigger box " + identity_.serial +
                                  " is gone from USB: check its cable, and open it anew"};
}

// ---- Event thread ----

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

void LibusbTrigger::on_answer(libusb_transfer* transfer) {
  auto& self = *static_cast<LibusbTrigger*>(transfer->user_data);
  {
    const std::lock_guard lock(self.mutex_);
    self.question_.is_in_flight = false;
    self.question_.answered = HostClock::now();
  }
  self.answered_.notify_all();
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
