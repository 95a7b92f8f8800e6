// The parts of reading and writing a manifest, shared by this folder's .cpp files.
#pragma once

#include "estimation/session/json_reader.h"
#include "estimation/session/manifest.h"

namespace estimation {

inline constexpr int kManifestFormat = 1;
inline constexpr int kLargestSidePx = 65535;
// 2^28 samples hold every sensor made and bound what a broken header can make us allocate.
inline constexpr std::int64_t kLargestAreaPx = std::int64_t{1} << 28;

// The largest sample a format can hold.
inline int largest_sample(int bit_depth) { return (1 << bit_depth) - 1; }

std::optional<SessionState> parse_session_state(std::string_view name);

// The object under "calibration"; failures go to the value's errors.
Calibration read_calibration(const JsonValue& object);

// The manifest's known keys alone, in the order of session_format.md.
Json known_document(const Manifest& manifest);

// What `document` holds beside `known`, at its places. Elements of a list are kept with the key
// that identifies them (patterns by index, frames by file), so that the list may change meanwhile.
Json unknown_keys(const Json& document, const Json& known);

}  // namespace estimation
