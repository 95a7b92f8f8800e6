#include "rig/devices/block_id.h"

namespace rig {
namespace {

constexpr std::uint64_t kWirePeriod = 0xFFFF;  // 16 bit ids run 1 ... 65535

// Steps from one id to another; 0 or more than half a period is a step back.
std::uint64_t distance(std::uint64_t from, std::uint64_t to) {
  if (to > from) return to - from;
  return from <= kWirePeriod ? (to + kWirePeriod - from) % kWirePeriod : 0;
}

}  // namespace

std::optional<std::uint64_t> BlockIdCounter::advance(std::uint64_t wire_id) {
  if (wire_id == 0) return std::nullopt;
  if (latest_wire_id_ == 0) {
    latest_ = wire_id <= plausible_loss_ ? wire_id : 1;
  } else {
    const std::uint64_t step = distance(latest_wire_id_, wire_id);
    if (step == 0 || step > kWirePeriod / 2) return std::nullopt;
    latest_ += step;
  }
  latest_wire_id_ = wire_id;
  return latest_;
}

}  // namespace rig
