// The vendor requests of LibusbTrigger, for which the session's thread waits.
#include <libusb-1.0/libusb.h>

#include <algorithm>
#include <chrono>
#include <span>
#include <string>
#include <vector>

#include "rig/devices/libusb_trigger.h"

namespace rig {
namespace {

using std::chrono::milliseconds;
using tb1::Request;

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

}  // namespace

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

void LibusbTrigger::on_answer(libusb_transfer* transfer) {
  auto& self = *static_cast<LibusbTrigger*>(transfer->user_data);
  {
    const std::lock_guard lock(self.mutex_);
    self.question_.is_in_flight = false;
    self.question_.answered = HostClock::now();
  }
  self.answered_.notify_all();
}

}  // namespace rig
