#include "capture/stored_take.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <iterator>
#include <system_error>
#include <utility>

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

std::optional<std::vector<std::byte>> read_bytes(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::error_code unknown;
  if (!file || fs::is_directory(path, unknown)) return std::nullopt;  // reading a folder throws
  const std::string content{std::istreambuf_iterator<char>(file), {}};
  std::vector<std::byte> bytes(content.size());
  std::memcpy(bytes.data(), content.data(), content.size());
  return bytes;
}

// The record of a slot whose file is good, else nullopt.
std::optional<estimation::FrameRecord> check_slot(const fs::path& session,
                                                  const estimation::Manifest& manifest,
                                                  const estimation::FrameRecord& planned,
                                                  const Journal& journal) {
  const auto bytes = read_bytes(session / planned.file);
  if (!bytes) return std::nullopt;
  const std::string found_hash = estimation::sha256_hex(*bytes);
  const auto told = journal.frames.find(planned.file);
  if (told != journal.frames.end() && told->second.record.sha256) {
    if (*told->second.record.sha256 != found_hash) return std::nullopt;
    return told->second.record;
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
  std::error_code unknown;
  if (!fs::is_regular_file(path, unknown)) return {};  // reading a folder throws
  std::ifstream file(path, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  return parse_journal(text);
}

bool is_under_way(const fs::path& session) {
  const int journal = ::open((session / "journal.jsonl").c_str(), O_RDONLY | O_CLOEXEC);
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
    if (!take.slots.back() && fs::exists(session / slot.file, error))
      take.damaged_files.push_back(slot.file);
  }
  return take;
}

}  // namespace capture
