#include "rig/devices/aravis_chunks.h"

#include <arv.h>

#include <algorithm>
#include <array>
#include <optional>
#include <span>
#include <vector>

#include "rig/devices/camera_answers.h"

namespace rig {
namespace {

// A chunk under the names that cameras give it: what ChunkSelector calls it and the feature that
// reads it.
struct ChunkName {
  const char* selector;
  const char* feature;
};
constexpr std::array<ChunkName, 1> kExposureChunks{{{"ExposureTime", "ChunkExposureTime"}}};
constexpr std::array<ChunkName, 2> kTriggerChunks{
    {{"CounterValue", "ChunkCounterValue"},
     {"Triggerinputcounter", "ChunkTriggerinputcounter"}}};  // Basler ace, GigE
constexpr std::array<ChunkName, 2> kSetChunks{
    {{"SequencerSetActive", "ChunkSequencerSetActive"},
     {"SequenceSetIndex", "ChunkSequenceSetIndex"}}};  // Basler ace, GigE
// The level at the exposure's end (FLIR) is that at its begin, too: a change in between would be
// one more trigger in the camera's count.
constexpr std::array<ChunkName, 2> kLineChunks{
    {{"LineStatusAll", "ChunkLineStatusAll"},
     {"ExposureEndLineStatusAll", "ChunkExposureEndLineStatusAll"}}};
constexpr int kLineBitLimit = 63;

// The name of the first that this camera has; empty: none.
std::string enable_first(const AravisFeatures& features, std::span<const ChunkName> names) {
  for (const ChunkName& name : names)
    if (features.has(name.feature) &&
        features.set_entry_if_present("ChunkSelector", name.selector) &&
        features.set_flag("ChunkEnable", true))
      return name.feature;
  return "";
}

// Which bit of the lines' status is whose differs between cameras; they begin with the first line
// that there is. nullopt: the camera does not tell its lines.
std::optional<int> line_bit(const AravisFeatures& features, const std::string& line) {
  const std::vector<std::string> lines = features.entries("LineSelector");
  const auto bit = std::find(lines.begin(), lines.end(), line) - lines.begin();
  if (bit == std::ssize(lines) || bit > kLineBitLimit) return std::nullopt;
  return static_cast<int>(bit);
}

}  // namespace

bool ChunkFeatures::is_active() const {
  return !exposure.empty() || !trigger_count.empty() || !sequencer_set.empty() ||
         !line_status.empty();
}

Result<ChunkFeatures> enable_chunks(const AravisFeatures& features,
                                    const CameraSettings& settings) {
  ChunkFeatures chunks;
  if (!features.has("ChunkModeActive") || !features.has("ChunkSelector")) return chunks;
  if (auto set = features.set_flag("ChunkModeActive", true); !set)
    return tl::unexpected(set.error());
  chunks.exposure = enable_first(features, kExposureChunks);
  chunks.trigger_count = enable_first(features, kTriggerChunks);
  chunks.sequencer_set = enable_first(features, kSetChunks);
  if (settings.trigger_edge == TriggerEdge::kAny) {
    const std::optional<int> bit = line_bit(features, settings.trigger_line);
    if (bit) chunks.line_status = enable_first(features, kLineChunks);
    chunks.line_bit = bit.value_or(0);
  }
  if (!chunks.is_active())
    if (auto off = features.set_flag("ChunkModeActive", false); !off)
      return tl::unexpected(off.error());
  return chunks;
}

Result<void> ChunkReader::read(ArvBuffer* buffer, std::int64_t trigger_base, Frame& frame) const {
  GError* error = nullptr;
  ChunkAnswers answers;
  const auto integer = [&](const std::string& name) -> std::optional<std::int64_t> {
    if (name.empty() || error != nullptr) return std::nullopt;
    return arv_chunk_parser_get_integer_value(parser_.get(), buffer, name.c_str(), &error);
  };
  if (const std::string& name = chunks_.exposure; !name.empty())
    answers.exposure_us =
        arv_chunk_parser_get_float_value(parser_.get(), buffer, name.c_str(), &error);
  answers.trigger_count = integer(chunks_.trigger_count);
  answers.sequencer_set = integer(chunks_.sequencer_set);
  answers.line_status = integer(chunks_.line_status);
  if (error == nullptr) return take_chunks(answers, {trigger_base, chunks_.line_bit}, frame);
  const std::string cause = error->message;
  g_clear_error(&error);
  return failure(Fault::kFrameMalformed,
                 "block " + std::to_string(frame.block_id) + " lacks a chunk: " + cause);
}

}  // namespace rig
