// A run of frames from a camera that may say anything: PayloadSize, block ids and chunks.
#include <optional>

#include "rig/devices/block_id.h"
#include "rig/devices/camera_answers.h"
#include "tests/fuzz/fuzz_target.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzz::Source source(data, size);
  const auto payload_bytes = source.take<std::uint32_t>();
  const auto image_bytes = source.take<std::uint32_t>();
  if (rig::check_payload(payload_bytes, image_bytes))
    estimation::check(payload_bytes >= image_bytes, "a buffer holds its image");
  constexpr std::uint64_t kFrameCount = 176;
  rig::BlockIdCounter block_ids(kFrameCount);
  const auto trigger_base = source.take<std::int64_t>();
  static_cast<void>(rig::counted_since(trigger_base, source.take<std::int64_t>()));
  while (!source.is_empty()) {
    const auto which = source.take<std::uint8_t>();
    const auto wire_id = (which & 1U) != 0 ? source.take<std::uint64_t>()
                                           : std::uint64_t{source.take<std::uint16_t>()};
    const std::uint64_t latest = block_ids.latest();
    const auto block_id = block_ids.advance(wire_id);
    estimation::check(!block_id || (*block_id > latest && *block_id - latest <= 0xFFFF),
                      "block numbers grow, and not by more than a wire's period");
    rig::ChunkAnswers answers;
    if ((which & 2U) != 0) answers.exposure_us = source.take<double>();
    if ((which & 4U) != 0) answers.trigger_count = source.take<std::int64_t>();
    if ((which & 8U) != 0) answers.sequencer_set = source.take<std::int64_t>();
    if ((which & 16U) != 0) answers.line_status = source.take<std::int64_t>();
    rig::Frame frame;
    frame.block_id = block_id.value_or(0);
    if (const auto taken = rig::take_chunks(answers, {.trigger_base = trigger_base}, frame);
        !taken) {
      fuzz::require_message(taken.error().detail, "block");
      continue;
    }
    estimation::check(frame.exposure.has_value() == answers.exposure_us.has_value() &&
                          frame.trigger_count.has_value() == answers.trigger_count.has_value() &&
                          frame.sequencer_set.has_value() == answers.sequencer_set.has_value() &&
                          frame.is_line_high.has_value() == answers.line_status.has_value(),
                      "each chunk is taken");
  }
  return 0;
}
