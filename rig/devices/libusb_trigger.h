// The trigger box over libusb: TB1 as in rig/trigger_box_protocol.h. Passes
// tests/contract/trigger_contract.h at the far end of a simulated wire (tests/wire/usb).
//
// Two threads. The session's thread makes the vendor requests (arm, disarm, counters), each with a
// time limit. The event thread below keeps eight reads in flight, turns records into events, asks
// the box for its time at every heartbeat, and watches that the heart beats. All of libusb's
// callbacks run on it: its synchronous calls, which would handle events on the caller's thread, are
// not used while it runs.
#pragma once

#include <array>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "rig/clock.h"
#include "rig/devices/usb_box.h"
#include "rig/event.h"
#include "rig/fault.h"
#include "rig/trigger.h"
#include "rig/trigger_box_protocol.h"

namespace rig {

// Threads, states and errors as in rig/trigger.h. Also posts, each once per incident, as
// DeviceFault{kTrigger}: kSequenceGap (records lost), kTimeout (three heartbeats missed, or DISARM
// not taken), kProtocol (a read failed and was repeated, or an answer makes no sense), kDeviceLost
// (unplugged; the only one that is terminal).
class LibusbTrigger final : public Trigger {
 public:
  // Finds the box, claims it, checks its version, disarms it and synchronises the clocks. Takes
  // some ms. Errors: kNotFound; kConfiguration (several boxes and no serial); kAccessDenied
  // (permissions, or another program has it); kUnsupported (another protocol version); kTimeout;
  // kDeviceLost.
  static Result<std::unique_ptr<LibusbTrigger>> open(const TriggerSettings& settings,
                                                     EventSink& sink);
  // Disarms and stops within some seconds, whatever the box does.
  ~LibusbTrigger() override;

  const TriggerIdentity& identity() const override { return identity_; }
  Result<void> arm(const std::vector<std::chrono::microseconds>& pulse_widths,
                   std::uint32_t run_id) override;
  // Waits until the box has reported the last of the run; nothing of it is posted afterwards.
  void disarm() noexcept override;
  Result<TriggerCounters> counters() override;

  // The lowest and highest photodiode level since the last call, for choosing thresholds. Errors
  // as counters().
  Result<tb1::Levels> levels();
  // How well the box's clock is known.
  double clock_drift_ppm() const;
  std::chrono::nanoseconds clock_uncertainty() const;

 private:
  static constexpr std::size_t kReadCount = 8;
  static constexpr std::size_t kReadBytes = 8 * tb1::kPacketBytes;
  static constexpr unsigned kRequestTimeout_ms = 500;
  struct Read {
    std::array<std::uint8_t, kReadBytes> buffer{};
    UsbTransfer transfer;
    bool is_in_flight = false;
    bool has_failed = false;  // to be submitted again when the endpoint is cleared
  };
  // GET_TIME without waiting.
  struct TimeQuery {
    std::array<std::uint8_t, 8 + tb1::kTimeBytes> buffer{};
    UsbTransfer transfer;
    bool is_in_flight = false;
    HostTime sent;
  };

  // A vendor request that the session's thread waits for.
  struct Question {
    std::array<std::uint8_t, 8 + tb1::kPacketBytes> buffer{};
    UsbTransfer transfer;
    bool is_in_flight = false;  // guarded by mutex_, as the next
    HostTime answered;
  };

  LibusbTrigger(const TriggerSettings& settings, EventSink& sink, UsbContext context, UsbBox box);

  Result<void> start();
  void prepare_transfers();
  Result<void> greet();

  // Vendor requests, session thread: libusb_requests.cpp.
  Result<void> request_out(tb1::Request request, std::uint16_t value,
                           std::span<const std::uint8_t> data);
  Result<std::vector<std::uint8_t>> request_in(tb1::Request request, std::size_t size_bytes);
  // The answer's size in bytes, in question_.buffer after the setup packet.
  Result<std::size_t> ask(std::uint8_t request_type, tb1::Request request, std::uint16_t value,
                          std::span<const std::uint8_t> data, std::size_t size_bytes);
  Error submit_error(tb1::Request request, int code);
  Error transfer_error(tb1::Request request, int status);
  Error gone();
  Result<std::uint16_t> fresh_wire_id(std::uint32_t run_id);
  Result<void> configure(const std::vector<std::chrono::microseconds>& pulse_widths);
  Result<void> synchronise_clock();

  // Event thread: libusb_events.cpp.
  void run_events();
  static void on_read(libusb_transfer* transfer);
  static void on_time(libusb_transfer* transfer);
  static void on_answer(libusb_transfer* transfer);
  void take_records(std::span<const std::uint8_t> bytes);
  void take_record(const tb1::Record& record);
  void submit(Read& read);
  void query_time();
  void repeat_failed_reads();
  void check_heartbeat();
  void cancel_transfers();
  bool has_transfer_in_flight() const;
  bool is_closing() const;
  bool is_stopping() const;
  void post_fault(Fault fault, std::string detail);
  void lose_device();

  const TriggerSettings settings_;
  EventSink& sink_;
  TriggerIdentity identity_;
  bool is_armed_ = false;  // session thread

  // Declared so that the handle closes before the transfers are freed: after closing no callback
  // comes, even for a transfer that never returned.
  UsbContext context_;
  std::vector<std::unique_ptr<Read>> reads_;  // event thread, as all below but question_
  TimeQuery time_query_;
  Question question_;
  int failed_read_count_ = 0;  // in a row
  std::string read_failure_;
  HostTime last_heartbeat_;
  bool has_reported_silence_ = false;
  UsbHandle handle_;

  mutable std::mutex mutex_;
  std::condition_variable run_ended_;
  std::condition_variable answered_;
  ClockMap<BoxClock> clock_;              // guarded by mutex_, as all below
  std::optional<tb1::RecordReader> run_;  // while armed
  std::uint16_t run_id_ = 0;              // as it travels
  bool is_stopping_ = false;
  bool is_lost_ = false;

  std::jthread event_thread_;
};

}  // namespace rig
