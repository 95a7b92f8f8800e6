// Everything that comes over USB from the trigger box: a transfer of records, read as a run's, and
// the answers to control requests.
#include <span>

#include "rig/trigger_box_protocol.h"
#include "tests/fuzz/fuzz_target.h"

namespace {

using Bytes = std::span<const std::uint8_t>;

template <typename Decoded, typename Encode>
void require_same(const rig::Result<Decoded>& decoded, Bytes bytes, const Encode& encode) {
  if (!decoded) {
    fuzz::require_message(decoded.error().detail, "trigger box");
    return;
  }
  const auto again = encode(*decoded);
  estimation::check(std::equal(again.begin(), again.end(), bytes.begin(), bytes.end()),
                    "an accepted answer is written as it was");
}

void read_run(Bytes bytes) {
  const auto records = rig::tb1::decode_records(bytes);
  if (!records) return fuzz::require_message(records.error().detail, "trigger box");
  if (records->empty()) return;
  rig::ClockMap<rig::BoxClock> clock;
  rig::tb1::RecordReader reader(records->front().run_id);
  const rig::HostTime host(std::chrono::hours(1));
  clock.add(rig::tb1::to_time_point(records->front().time_us), host, std::chrono::microseconds(50));
  for (const rig::tb1::Record& record : *records) {
    if (record.type == rig::tb1::RecordType::kHeartbeat)
      clock.add(rig::tb1::to_time_point(record.time_us), host, std::chrono::microseconds(50));
    estimation::check(reader.read(record, clock).size() <= 3, "a record is few events");
  }
}

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  namespace tb1 = rig::tb1;
  const Bytes bytes(data, size);
  const auto encode = [](const auto& decoded) { return tb1::encode(decoded); };
  switch (size) {
    case tb1::kInfoBytes:
      require_same(tb1::decode_info(bytes), bytes, encode);
      break;
    case tb1::kConfigBytes:
      require_same(tb1::decode_config(bytes), bytes, encode);
      break;
    case tb1::kStatusBytes:
      require_same(tb1::decode_status(bytes), bytes, encode);
      break;
    case tb1::kLevelsBytes:
      require_same(tb1::decode_levels(bytes), bytes, encode);
      break;
    case tb1::kTimeBytes:
      require_same(tb1::decode_time(bytes), bytes,
                   [](std::uint64_t time_us) { return tb1::encode_time(time_us); });
      break;
    case tb1::kRecordBytes:
      require_same(tb1::decode_record(bytes), bytes, encode);
      break;
    default:
      break;
  }
  read_run(bytes);
  return 0;
}
