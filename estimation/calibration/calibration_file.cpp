#include "estimation/calibration/calibration_file.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <ctime>
#include <nlohmann/json.hpp>
#include <system_error>
#include <vector>

#include "estimation/session/frame_io.h"

namespace estimation {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

constexpr const char* kRecords = "calibrated";
constexpr std::array kGeometryKeys{"camera", "projector"};
constexpr std::array kRadiometryKeys{"irradiance", "projector_black", "stripe_transfer",
                                     "color_matrix"};

std::tm utc(std::chrono::system_clock::time_point time) {
  const std::time_t seconds = std::chrono::system_clock::to_time_t(time);
  std::tm parts{};
  gmtime_r(&seconds, &parts);
  return parts;
}

// Discarded where the text is no JSON, or is nested deeper than a session's reader takes it inside
// of a session: printing is recursive.
Json parse(std::string_view text) {
  constexpr int kDeepestNesting = 60;
  bool is_too_deep = false;
  const auto watch = [&](int depth, Json::parse_event_t, Json&) {
    is_too_deep = is_too_deep || depth > kDeepestNesting;
    return !is_too_deep;
  };
  Json document = Json::parse(text, watch, false);
  return is_too_deep ? Json(Json::value_t::discarded) : document;
}

std::string in_line(const Json& value) {
  return value.dump(-1, ' ', false, Json::error_handler_t::replace);
}

// Objects a key a line, matrices a row a line, the rest in one: a person reads this too.
void print(const Json& value, const std::string& indent, std::string& text) {
  const bool has_parts = value.is_structured() && std::ranges::any_of(value, [](const Json& part) {
                           return part.is_structured();
                         });
  if (value.empty() || (!has_parts && !value.is_object())) {
    text += in_line(value);
    return;
  }
  const std::string deeper = indent + "  ";
  const bool is_object = value.is_object();
  text += is_object ? "{" : "[";
  const char* separator = "\n";
  for (const auto& [key, part] : value.items()) {
    text.append(separator).append(deeper);
    if (is_object) text.append(in_line(key)).append(": ");
    print(part, deeper, text);
    separator = ",\n";
  }
  text.append("\n").append(indent).append(is_object ? "}" : "]");
}

// The calibration's keys as a session writes them.
Json keys_of(const Calibration& calibration) {
  Manifest manifest;
  manifest.calibration = calibration;
  return parse(format_manifest(manifest))["calibration"];
}

bool is_key(std::string_view key) {
  const auto is_in = [key](const auto& keys) {
    for (const char* each : keys)
      if (key == each) return true;
    return false;
  };
  return is_in(kGeometryKeys) || is_in(kRadiometryKeys);
}

// A name that no file has, from the date at which `path` was last written.
fs::path dated_name(const fs::path& path) {
  std::error_code error;
  const auto written = fs::last_write_time(path, error);
  const auto time = error ? std::chrono::system_clock::now()
                          : std::chrono::time_point_cast<std::chrono::system_clock::duration>(
                                std::chrono::file_clock::to_sys(written));
  const std::string stem = path.stem().string() + "." + date_stamp(time);
  for (int number = 1;; ++number) {
    std::string name = stem;
    if (number > 1) name.append("-").append(std::to_string(number));
    fs::path dated = path.parent_path() / name.append(path.extension().string());
    if (!fs::exists(fs::symlink_status(dated, error))) return dated;
  }
}

tl::unexpected<InputError> unwritable(const fs::path& path, const std::string& cause) {
  return tl::unexpected(InputError{InputFault::kUnwritable, path.string(), "", cause});
}

}  // namespace

std::string date_stamp(std::chrono::system_clock::time_point time) {
  const std::tm parts = utc(time);
  char text[32];
  return {text, std::strftime(text, sizeof text, "%Y%m%d-%H%M%S", &parts)};
}

std::string date_text(std::chrono::system_clock::time_point time) {
  const std::tm parts = utc(time);
  char text[32];
  return {text, std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts)};
}

Result<std::string> format_calibration(std::string_view before, const Calibration& calibration,
                                       const PartRecord& record) {
  Json document = before.empty() ? Json::object() : parse(before);
  if (!document.is_object())
    return tl::unexpected(InputError{InputFault::kInvalid, "", "",
                                     "the older calibration is no JSON object; move it away"});
  if (document.contains(kRecords) && !document[kRecords].is_object())
    return tl::unexpected(
        InputError{InputFault::kInvalid, "", std::string("/").append(kRecords),
                   "is no object with what each part says of itself; take the key out of the older "
                   "calibration or move that file away"});
  const Json keys = keys_of(calibration);
  const auto replace = [&](const auto& names) {
    for (const char* name : names) {
      if (keys.contains(name))
        document[name] = keys[name];
      else
        document.erase(name);
    }
  };
  const bool is_geometry = record.part == CalibrationPart::kGeometry;
  if (is_geometry)
    replace(kGeometryKeys);
  else
    replace(kRadiometryKeys);
  document[kRecords][is_geometry ? "geometry" : "radiometry"] = parse(record.json);
  std::string text;
  print(document, "", text);
  return text + "\n";
}

Result<void> save_text(const fs::path& path, const std::string& text) {
  std::error_code error;
  if (path.has_parent_path()) fs::create_directories(path.parent_path(), error);
  if (error) return unwritable(path, "its folder cannot be made: " + error.message());
  std::vector<std::byte> bytes(text.size());
  std::memcpy(bytes.data(), text.data(), text.size());
  return write_file_atomically(path, bytes);
}

Result<fs::path> write_calibration(const fs::path& path, const std::string& text) {
  std::error_code error;
  fs::path kept;
  if (fs::exists(path, error)) {
    kept = dated_name(path);
    // A copy, so that at no moment the rig is without its calibration.
    fs::copy_file(path, kept, fs::copy_options::none, error);
    if (error) return unwritable(kept, "the older calibration cannot be kept: " + error.message());
  }
  if (const auto saved = save_text(path, text); !saved) return tl::unexpected(saved.error());
  return kept;
}

std::string extra_calibration_keys(std::string_view text) {
  const Json document = parse(text);
  if (!document.is_object()) return {};
  Json extra = Json::object();
  for (const auto& [key, value] : document.items())
    if (!is_key(key)) extra[key] = value;
  if (extra.empty()) return {};
  return Json{{"calibration", extra}}.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace estimation
