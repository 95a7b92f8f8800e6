#include "capture/resumption.h"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <system_error>
#include <utility>

#include "capture/journal.h"
#include "capture/session_plan.h"
#include "capture/stored_pictures.h"
#include "capture/stored_take.h"
#include "estimation/session/file_reading.h"
#include "estimation/session/frame_io.h"
#include "nlohmann/json.hpp"

namespace capture {
namespace {

using estimation::InputError;
using estimation::InputFault;
using estimation::Manifest;
using estimation::Result;
using Json = nlohmann::json;
namespace fs = std::filesystem;

tl::unexpected<InputError> cannot_resume(const fs::path& session, const std::string& why) {
  return tl::unexpected(InputError{InputFault::kInvalid, session.string(), "", why});
}

// Empty for what cannot be read.
std::vector<std::byte> content_of(const fs::path& path) {
  constexpr std::uint64_t kLargestBytes = std::uint64_t{1} << 30U;
  return estimation::read_file(path, kLargestBytes).value_or(std::vector<std::byte>());
}

// Gathers what differs, each a clause, and says no more than a few.
class Differences {
 public:
  void compare(const std::string& name, const std::string& then, const std::string& now) {
    if (then == now) return;
    ++count_;
    if (count_ > kMostNamed) return;
    text_ += (text_.empty() ? "" : "; ") + name + " was " + shortened(then) + " and is now " +
             shortened(now);
  }
  // Member by member, so that the place is named.
  void compare(const std::string& name, const Json& then, const Json& now) {
    if (!then.is_object() || !now.is_object()) return compare(name, then.dump(), now.dump());
    for (const auto& [key, value] : then.items())
      compare(std::string(name).append("/").append(key), value,
              now.contains(key) ? now[key] : Json());
    for (const auto& [key, value] : now.items())
      if (!then.contains(key)) compare(std::string(name).append("/").append(key), Json(), value);
  }
  bool empty() const { return count_ == 0; }
  std::string text() const {
    return count_ <= kMostNamed ? text_
                                : text_ + "; and " + std::to_string(count_ - kMostNamed) + " more";
  }

 private:
  static std::string shortened(const std::string& value) {
    constexpr std::size_t kMostBytes = 60;
    if (value.empty()) return "not there";
    return value.size() <= kMostBytes ? value : value.substr(0, kMostBytes) + "...";
  }
  static constexpr int kMostNamed = 5;
  int count_ = 0;
  std::string text_;
};

// Files of the calibration by what they hold: a session's have other names.
void compare_auxiliary_files(const fs::path& session, const fs::path& calibration_file,
                             Manifest& then, Manifest& now, Differences& differences) {
  const auto before = auxiliary_files(then.calibration), after = auxiliary_files(now.calibration);
  for (std::size_t i = 0; i < std::min(before.size(), after.size()); ++i) {
    const fs::path current = calibration_file.parent_path() / *after[i];
    if (content_of(session / *before[i]) != content_of(current))
      differences.compare(current.string(), std::string("other content"), "this");
    *after[i] = *before[i];
  }
}

// As a reader of sessions has it: a mono camera's three equal bands are one there.
Json comparable(const Manifest& manifest) {
  const auto read = estimation::parse_manifest(estimation::format_manifest(manifest), "");
  Json json = Json::parse(estimation::format_manifest(read.value_or(manifest)), nullptr, false);
  Json kept;
  for (const char* key : {"plan", "camera", "projector", "calibration", "patterns"})
    kept[key] = json.contains(key) ? json[key] : Json();
  return kept;
}

void append_word(const std::string& word, std::string& text) {
  if (!text.empty()) text.append(" ");
  text.append(word);
}

std::string in_words(const std::vector<std::chrono::microseconds>& exposures) {
  std::string text;
  for (const auto exposure : exposures) append_word(std::to_string(exposure.count()), text);
  return text;
}

std::string in_words(const std::vector<int>& order) {
  std::string text;
  for (const int pattern : order) append_word(std::to_string(pattern), text);
  return text;
}

// Everything that makes frames of now frames of then.
Differences find_differences(const rig::RigFile& rig_file, const Plan& plan,
                             const fs::path& session, const Manifest& then,
                             const TakeBeginning& beginning, const Manifest& planned) {
  Differences differences;
  Manifest before = then, now = planned;
  compare_auxiliary_files(session, rig_file.calibration_file, before, now, differences);
  differences.compare("", comparable(before), comparable(now));
  differences.compare("sequence.exposures_us", in_words(beginning.exposures),
                      in_words(plan.exposures));
  differences.compare("the order of projection", in_words(beginning.order), in_words(plan.order));
  for (const auto& [name, value] : journalled_settings(rig_file)) {
    const auto was = beginning.settings.find(name);
    differences.compare(name, was == beginning.settings.end() ? "" : was->second, value);
  }
  return differences;
}

// Frames that do not show their pattern are none of the take.
Result<void> set_wrong_open(const Plan& plan, Resumption& resumption) {
  std::vector<estimation::FrameRecord> stored;
  for (std::size_t i = 0; i < resumption.is_good.size(); ++i)
    if (resumption.is_good[i]) stored.push_back(resumption.manifest.frames[i]);
  auto pictures = read_pictures(resumption.session, resumption.manifest, stored);
  if (!pictures) return tl::unexpected(pictures.error());
  const auto check =
      check_pictures(resumption.manifest.camera, resumption.manifest.patterns, *pictures);
  const std::size_t bracket_count = plan.exposures.size();
  for (const estimation::WrongPicture& wrong : check.wrong) {
    const std::size_t slot = static_cast<std::size_t>(wrong.pattern) * bracket_count +
                             static_cast<std::size_t>(wrong.bracket);
    resumption.is_good[slot] = false;
    resumption.wrong_files.push_back(resumption.manifest.frames[slot].file);
    std::erase_if(*pictures, [&wrong](const estimation::SeenPicture& each) {
      return each.pattern == wrong.pattern && each.bracket == wrong.bracket;
    });
  }
  resumption.pictures = std::move(*pictures);
  return {};
}

std::size_t good_bracket_count(const Resumption& resumption, int pattern) {
  const std::size_t bracket_count = resumption.is_good.size() / resumption.manifest.patterns.size();
  const auto first = resumption.is_good.begin() +
                     static_cast<std::ptrdiff_t>(static_cast<std::size_t>(pattern) * bracket_count);
  return static_cast<std::size_t>(
      std::count(first, first + static_cast<std::ptrdiff_t>(bracket_count), true));
}

}  // namespace

int Resumption::good_count() const {
  return static_cast<int>(std::count(is_good.begin(), is_good.end(), true));
}

std::vector<bool> Resumption::is_open() const {
  std::vector<bool> open = is_good;
  open.flip();
  return open;
}

Manifest Resumption::lacking() const {
  Manifest rest = manifest;
  rest.frames.clear();
  for (std::size_t i = 0; i < is_good.size(); ++i)
    if (!is_good[i]) rest.frames.push_back(manifest.frames[i]);
  return rest;
}

std::optional<int> Resumption::known_pattern(const Plan& plan) const {
  for (const int pattern : plan.order)
    if (good_bracket_count(*this, pattern) > 0) return pattern;
  return std::nullopt;
}

Result<Resumption> prepare_resumption(const rig::RigFile& rig_file, const Plan& plan,
                                      const Manifest& planned, const fs::path& session) {
  if (is_under_way(session))
    return cannot_resume(session, "is being captured at this moment; let that capture end");
  std::error_code none;  // then it does not say how the take was begun, see below
  const std::uintmax_t journal_byte_count = fs::file_size(session / "journal.jsonl", none);
  auto take = read_take(session, planned.frames);
  if (!take) return tl::unexpected(take.error());
  if (take->manifest.state == estimation::SessionState::kComplete)
    return cannot_resume(session, "is complete: there is nothing to resume");
  if (!take->journal.beginning)
    return cannot_resume(session,
                         "its journal does not say how it was begun, so nobody can tell whether "
                         "frames of now would fit; capture anew");
  const Differences differences =
      find_differences(rig_file, plan, session, take->manifest, *take->journal.beginning, planned);
  if (!differences.empty())
    return cannot_resume(session, "was taken otherwise than " + rig_file.path.string() +
                                      " says now: " + differences.text() +
                                      "; put that back or capture anew");
  Resumption resumption;
  resumption.session = session;
  resumption.journal_byte_count = journal_byte_count;
  resumption.manifest = take->manifest;
  resumption.manifest.state = estimation::SessionState::kCapturing;
  resumption.manifest.failure.reset();
  resumption.manifest.frames = planned.frames;
  resumption.damaged_files = std::move(take->damaged_files);
  for (std::size_t i = 0; i < take->slots.size(); ++i) {
    resumption.is_good.push_back(take->slots[i].has_value());
    if (take->slots[i]) resumption.manifest.frames[i] = *take->slots[i];
  }
  if (const auto checked = set_wrong_open(plan, resumption); !checked)
    return tl::unexpected(checked.error());
  return resumption;
}

Result<void> set_damaged_aside(const Resumption& resumption) {
  Manifest known = resumption.manifest;
  known.frames.clear();
  for (std::size_t i = 0; i < resumption.is_good.size(); ++i)
    if (resumption.is_good[i]) known.frames.push_back(resumption.manifest.frames[i]);
  if (const auto stored = store_manifest(resumption.session, known); !stored) return stored;
  for (const auto& [files, suffix] : {std::pair(&resumption.damaged_files, ".damaged"),
                                      std::pair(&resumption.wrong_files, ".wrong_picture")})
    for (const std::string& file : *files)
      if (const auto aside = set_aside(resumption.session / file, suffix); !aside)
        return tl::unexpected(aside.error());
  return {};
}

Result<void> show_first(const Resumption& resumption, int pattern, MotionWatch& watch) {
  const std::size_t bracket_count = resumption.is_good.size() / resumption.manifest.patterns.size();
  for (std::size_t bracket = 0; bracket < bracket_count; ++bracket) {
    const std::size_t slot = static_cast<std::size_t>(pattern) * bracket_count + bracket;
    if (!resumption.is_good[slot]) continue;
    const estimation::FrameRecord& record = resumption.manifest.frames[slot];
    auto dn = estimation::read_frame(resumption.session, resumption.manifest, record.file);
    if (!dn) return tl::unexpected(dn.error());
    const std::chrono::nanoseconds edge(record.edge_timestamp_ns.value_or(0));
    watch.add_first(static_cast<int>(bracket),
                    rig::HostTime(std::chrono::duration_cast<rig::HostTime::duration>(edge)),
                    std::move(*dn));
  }
  return {};
}

}  // namespace capture
