#include "capture/stored_take.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <system_error>
#include <utility>

#include "estimation/session/file_reading.h"
#include "estimation/session/frame_io.h"
#include "nlohmann/json.hpp"

namespace capture {
namespace {

using Json = nlohmann::json;
namespace fs = std::filesystem;

// A whole number that the type holds.
template <typename Number>
std::optional<Number> integer(const Json& value) {
  if (value.is_number_unsigned()) {
    const auto number = value.get<std::uint64_t>();
    if (std::in_range<Number>(number)) return static_cast<Number>(number);
  } else if (value.is_number_integer()) {
    const auto number = value.get<std::int64_t>();
    if (std::in_range<Number>(number)) return static_cast<Number>(number);
  }
  return std::nullopt;
}

template <typename Number>
std::optional<Number> integer(const Json& line, const char* key) {
  const auto found = line.find(key);
  return found == line.end() ? std::nullopt : integer<Number>(*found);
}

std::optional<std::string> text(const Json& line, const char* key) {
  const auto found = line.find(key);
  if (found == line.end() || !found->is_string()) return std::nullopt;
  return found->get<std::string>();
}

template <typename Number>
std::vector<Number> integers(const Json& line, const char* key) {
  std::vector<Number> values;
  const auto found = line.find(key);
  if (found == line.end() || !found->is_array()) return values;
  for (const Json& value : *found)
    if (const auto number = integer<Number>(value)) values.push_back(*number);
  return values;
}

std::optional<TakeBeginning> read_beginning(const Json& line) {
  TakeBeginning beginning;
  for (const auto exposure_us : integers<std::int64_t>(line, "exposures_us"))
    beginning.exposures.emplace_back(exposure_us);
  beginning.order = integers<int>(line, "order");
  const auto settings = line.find("settings");
  if (beginning.exposures.empty() || settings == line.end() || !settings->is_object())
    return std::nullopt;
  for (const auto& [key, value] : settings->items())
    if (value.is_string()) beginning.settings[key] = value.get<std::string>();
  return beginning;
}

std::optional<JournalledFrame> read_stored_frame(const Json& line) {
  const auto file = text(line, "file");
  const auto pattern = integer<int>(line, "pattern");
  const auto exposure = line.find("exposure_us");
  if (!file || !pattern || *pattern < 0 || exposure == line.end() || !exposure->is_number())
    return std::nullopt;
  JournalledFrame frame;
  frame.record.file = *file;
  frame.record.pattern = *pattern;
  frame.record.exposure_us = exposure->get<double>();
  frame.record.frame_id = integer<std::uint64_t>(line, "frame_id");
  frame.record.camera_timestamp_ns = integer<std::int64_t>(line, "camera_timestamp_ns");
  frame.record.edge_timestamp_ns = integer<std::int64_t>(line, "edge_timestamp_ns");
  frame.record.sha256 = text(line, "sha256");
  frame.byte_count = integer<std::uintmax_t>(line, "byte_count");
  return frame;
}

void read_line(const Json& line, Journal& journal) {
  const auto event = text(line, "event");
  if (event == "take begun") {
    journal.beginning = read_beginning(line);
  } else if (event == "frame stored") {
    if (auto frame = read_stored_frame(line))
      journal.frames[frame->record.file] = std::move(*frame);
  }
}

// What was written down of a slot when its frame was stored: in the journal, else in the manifest
// of a take that came to an end.
std::optional<estimation::FrameRecord> find_record(const estimation::Manifest& manifest,
                                                   const std::string& file,
                                                   const Journal& journal) {
  const auto told = journal.frames.find(file);
  if (told != journal.frames.end() && told->second.record.sha256) return told->second.record;
  for (const estimation::FrameRecord& record : manifest.frames)
    if (record.file == file && record.sha256) return record;
  return std::nullopt;
}

// The record of a slot whose file is good, else nullopt.
std::optional<estimation::FrameRecord> check_slot(const fs::path& session,
                                                  const estimation::Manifest& manifest,
                                                  const estimation::FrameRecord& planned,
                                                  const Journal& journal) {
  const auto path = estimation::resolve_in_session(session, planned.file, "");
  if (!path) return std::nullopt;
  constexpr std::uint64_t kLargestFrameBytes = std::uint64_t{2} << 30U;
  const auto bytes = estimation::read_file(*path, kLargestFrameBytes);
  if (!bytes) return std::nullopt;
  const std::string found_hash = estimation::sha256_hex(*bytes);
  if (auto told = find_record(manifest, planned.file, journal)) {
    const bool is_of_slot =
        told->pattern == planned.pattern && told->exposure_us == planned.exposure_us;
    if (!is_of_slot || told->sha256 != found_hash) return std::nullopt;
    return told;
  }
  // Killed between the frame and its line: the file is whole or absent, but see it decoded.
  if (!estimation::read_frame(session, manifest, planned.file)) return std::nullopt;
  estimation::FrameRecord record = planned;
  record.sha256 = found_hash;
  return record;
}

}  // namespace

Journal parse_journal(std::string_view text) {
  Journal journal;
  while (!text.empty()) {
    const std::size_t length = std::min(text.find('\n'), text.size());
    const Json line = Json::parse(text.substr(0, length), nullptr, false);
    text.remove_prefix(std::min(length + 1, text.size()));
    if (line.is_object()) read_line(line, journal);
  }
  return journal;
}

Journal read_journal(const fs::path& session) {
  const fs::path path = session / "journal.jsonl";
  return parse_journal(estimation::read_text(path).value_or(""));
}

bool is_under_way(const fs::path& session) {
  const int journal =
      ::open((session / "journal.jsonl").c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (journal < 0) return false;
  const bool is_locked = ::flock(journal, LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
  ::close(journal);
  return is_locked;
}

int StoredTake::good_count() const {
  return static_cast<int>(
      std::count_if(slots.begin(), slots.end(), [](const auto& slot) { return slot.has_value(); }));
}

estimation::Result<fs::path> set_aside(const fs::path& file, const std::string& suffix) {
  fs::path aside = file.string() + suffix;
  std::error_code error;
  for (int number = 2; fs::exists(aside, error); ++number)
    aside = file.string() + suffix + std::to_string(number);
  fs::rename(file, aside, error);
  if (error)
    return tl::unexpected(
        estimation::InputError{estimation::InputFault::kUnwritable, file.string(), "",
                               "the file cannot be set aside: " + error.message()});
  return aside;
}

estimation::Result<void> store_manifest(const fs::path& session,
                                        const estimation::Manifest& manifest) {
  const std::string json = estimation::format_manifest(manifest);
  std::vector<std::byte> bytes(json.size());
  std::memcpy(bytes.data(), json.data(), json.size());
  return estimation::write_file_atomically(session / "session.json", bytes);
}

estimation::Result<StoredTake> read_take(const fs::path& session,
                                         const std::vector<estimation::FrameRecord>& planned) {
  auto manifest = estimation::read_manifest(session);
  if (!manifest) return tl::unexpected(manifest.error());
  StoredTake take;
  take.manifest = std::move(*manifest);
  take.journal = read_journal(session);
  for (const estimation::FrameRecord& slot : planned) {
    take.slots.push_back(check_slot(session, take.manifest, slot, take.journal));
    std::error_code error;
    // Of a link to nothing too: it has the slot's name.
    const auto there = fs::symlink_status(session / slot.file, error);
    if (!take.slots.back() && fs::exists(there)) take.damaged_files.push_back(slot.file);
  }
  return take;
}

}  // namespace capture
