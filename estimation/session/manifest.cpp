// Reading session.json.
#include "estimation/session/manifest.h"

#include <algorithm>
#include <array>
#include <climits>
#include <cstdio>
#include <sstream>
#include <unordered_set>
#include <utility>

#include "estimation/base/check.h"
#include "estimation/session/file_reading.h"
#include "estimation/session/manifest_parts.h"

namespace estimation {
namespace {

constexpr std::array<std::pair<SessionState, std::string_view>, 5> kStateNames{{
    {SessionState::kCapturing, "capturing"},
    {SessionState::kComplete, "complete"},
    {SessionState::kFailed, "failed"},
    {SessionState::kInterrupted, "interrupted"},
    {SessionState::kAborted, "aborted"},
}};

void read_format(const JsonValue& value) {
  const std::string what = std::to_string(kManifestFormat) +
                           ", the one format this program reads (a newer session needs a newer "
                           "ssrig)";
  if (value.integer(0, INT_MAX, what) != kManifestFormat) value.fail(what);
}

bool is_digit(char c) { return c >= '0' && c <= '9'; }

// "2026-01-31T23:59:59.25Z"; "+00:00" for Z, as RFC 3339 allows.
bool is_rfc3339_utc(const std::string& text) {
  constexpr std::string_view kShape = "dddd-dd-ddTdd:dd:dd";
  if (text.size() <= kShape.size()) return false;
  for (std::size_t i = 0; i < kShape.size(); ++i) {
    const bool matches = kShape[i] == 'd'   ? is_digit(text[i])
                         : kShape[i] == 'T' ? text[i] == 'T' || text[i] == 't' || text[i] == ' '
                                            : text[i] == kShape[i];
    if (!matches) return false;
  }
  const auto two_digits = [&](std::size_t at) {
    return 10 * (text[at] - '0') + text[at + 1] - '0';
  };
  const int month = two_digits(5);
  const int day = two_digits(8);
  if (month < 1 || month > 12 || day < 1 || day > 31) return false;
  if (two_digits(11) > 23 || two_digits(14) > 59 || two_digits(17) > 60) return false;
  std::string_view rest = std::string_view(text).substr(kShape.size());
  if (rest.starts_with('.')) {
    rest.remove_prefix(1);
    const std::size_t digit_count = std::min(rest.find_first_not_of("0123456789"), rest.size());
    if (digit_count == 0) return false;
    rest.remove_prefix(digit_count);
  }
  return rest == "Z" || rest == "z" || rest == "+00:00" || rest == "-00:00";
}

std::string read_created(const JsonValue& value) {
  const std::string what = "when the capture began, RFC 3339 in UTC: 2026-01-31T23:59:59Z";
  std::string created = value.text(what);
  if (!is_rfc3339_utc(created)) value.fail(what);
  return created;
}

std::string read_id(const JsonValue& value) {
  std::string id = value.text("the session's name");
  if (id.empty()) value.fail("a text that is not empty: the session's name");
  return id;
}

std::string read_optional_text(const JsonValue& object, const std::string& key) {
  const auto value = object.find(key);
  return value ? value->text(key) : std::string{};
}

SessionState read_state(const JsonValue& object) {
  const auto value = object.find("state");
  if (!value) return SessionState::kComplete;
  const std::string what = "capturing, complete, failed, interrupted or aborted";
  const std::string name = value->text(what);
  const std::optional<SessionState> state = parse_session_state(name);
  if (!state) value->fail(what);
  return state.value_or(SessionState::kComplete);
}

SessionFailure read_failure(const JsonValue& object) {
  SessionFailure failure;
  failure.code = read_optional_text(object, "code");
  failure.text = read_optional_text(object, "text");
  if (const auto slots = object.find("slots")) {
    // The contract leaves open how a slot is named: by text, number or object.
    for (const JsonValue& slot : slots->elements("the slots not filled")) {
      failure.slots.push_back(slot.as_text());
    }
  }
  return failure;
}

struct SizePx {
  int width = 0, height = 0;
};

SizePx read_size(const JsonValue& object, const std::string& of_what) {
  const JsonValue height = object.at("height");
  const SizePx size{
      .width = object.at("width").whole(1, kLargestSidePx, "width of " + of_what + ", px"),
      .height = height.whole(1, kLargestSidePx, "height of " + of_what + ", px")};
  if (std::int64_t{size.width} * size.height > kLargestAreaPx) {
    height.fail("a width times height of at most " + std::to_string(kLargestAreaPx) + " px");
  }
  return size;
}

PixelFormat read_pixel_format(const JsonValue& value) {
  const std::string what =
      "Mono8, Mono12, Mono16, BayerRG8, BayerRG12, BayerRG16 (or GR, GB, BG), RGB8 or RGB16";
  const std::string name = value.text(what);
  const std::optional<PixelFormat> format = parse_pixel_format(name);
  if (!format) value.fail(what);
  return format.value_or(PixelFormat{});
}

void read_roi(const JsonValue& value, CameraInfo& camera) {
  const std::string what = "[x, y] of the frames' top-left pixel on the sensor, px";
  const std::vector<JsonValue> corner = value.exactly(2, what);
  camera.roi_x_px = corner[0].whole(0, kLargestSidePx, what);
  camera.roi_y_px = corner[1].whole(0, kLargestSidePx, what);
}

// The levels are samples, so they lie in the pixel format's range.
void read_levels(const JsonValue& object, CameraInfo& camera) {
  const double largest_dn = largest_sample(camera.pixel_format.bit_depth);
  if (const auto black = object.find("black_level")) {
    camera.black_level_dn = black->number_in(0, largest_dn, "DN at zero light");
  }
  if (const auto saturation = object.find("saturation_level")) {
    const std::string what = "DN from which a sample is clipped, above the black level";
    camera.saturation_level_dn = saturation->positive(what);
    if (*camera.saturation_level_dn <= camera.black_level_dn.value_or(0)) saturation->fail(what);
  }
}

std::vector<DarkFrame> read_dark_frames(const JsonValue& list) {
  std::vector<DarkFrame> dark_frames;
  for (const JsonValue& object : list.elements("dark frames")) {
    dark_frames.push_back(
        {.exposure_us = object.at("exposure_us").positive("the dark frame's exposure, us"),
         .file = object.at("file").file_name("the dark frame, TIFF or PNG")});
  }
  return dark_frames;
}

CameraInfo read_camera(const JsonValue& object) {
  CameraInfo camera;
  const SizePx size = read_size(object, "the frames");
  camera.width_px = size.width;
  camera.height_px = size.height;
  camera.pixel_format = read_pixel_format(object.at("pixel_format"));
  if (const auto roi = object.find("roi")) read_roi(*roi, camera);
  read_levels(object, camera);
  if (const auto list = object.find("dark_frames")) camera.dark_frames = read_dark_frames(*list);
  if (const auto gain = object.find("gain_e_per_dn")) {
    camera.gain_e_per_dn = gain->positive("electrons per DN");
  }
  if (const auto noise = object.find("read_noise_e")) {
    camera.read_noise_e = noise->non_negative("electrons rms");
  }
  if (const auto file = object.find("flat_field")) {
    camera.flat_field_file = file->file_name("an EXR of one channel on the camera's px");
  }
  return camera;
}

SyncSquare read_sync_square(const JsonValue& value, const ProjectorInfo& projector) {
  const std::string what = "[x, y, w, h] inside the projector's picture, px";
  const std::vector<JsonValue> values = value.exactly(4, what);
  const SyncSquare square{.x_px = values[0].whole(0, kLargestSidePx, what),
                          .y_px = values[1].whole(0, kLargestSidePx, what),
                          .width_px = values[2].whole(1, kLargestSidePx, what),
                          .height_px = values[3].whole(1, kLargestSidePx, what)};
  const bool is_inside = square.x_px + square.width_px <= projector.width_px &&
                         square.y_px + square.height_px <= projector.height_px;
  if (!is_inside) value.fail(what);
  return square;
}

ProjectorInfo read_projector(const JsonValue& object) {
  ProjectorInfo projector;
  const SizePx size = read_size(object, "the projector");
  projector.width_px = size.width;
  projector.height_px = size.height;
  if (const auto square = object.find("sync_square")) {
    projector.sync_square = read_sync_square(*square, projector);
  }
  return projector;
}

Axis read_axis(const JsonValue& value) {
  const std::string what = "\"column\" or \"row\", the coordinate the pattern varies along";
  const std::string name = value.text(what);
  if (name != "column" && name != "row") value.fail(what);
  return name == "row" ? Axis::kRow : Axis::kColumn;
}

Stripes read_stripes(const JsonValue& object) {
  Stripes stripes;
  stripes.axis = read_axis(object.at("axis"));
  stripes.period_px = object.at("period_px").whole(1, kLargestSidePx, "the stripes' period, px");
  stripes.width_px =
      object.at("width_px").whole(1, stripes.period_px, "the lit width, at most period_px, px");
  stripes.shift_px = object.at("shift_px").whole(INT_MIN, INT_MAX, "the stripes' shift, px");
  return stripes;
}

GrayCode read_gray_code(const JsonValue& object) {
  GrayCode gray;
  gray.axis = read_axis(object.at("axis"));
  gray.bit = object.at("bit").whole(0, 30, "the Gray code's bit, 0 the least significant");
  gray.inverted = object.at("inverted").boolean("whether the bit's zeros are lit");
  return gray;
}

Fringe read_fringe(const JsonValue& object) {
  Fringe fringe;
  fringe.axis = read_axis(object.at("axis"));
  fringe.period_px = object.at("period_px").positive("the fringe's period, px");
  fringe.shift_px = object.at("shift_px").number("the fringe's shift, px");
  return fringe;
}

PatternKind read_pattern_kind(const JsonValue& object) {
  const JsonValue value = object.at("kind");
  const std::string what = "stripes, gray_code, fringe, white, black or image";
  const std::string kind = value.text(what);
  if (kind == "stripes") return read_stripes(object);
  if (kind == "gray_code") return read_gray_code(object);
  if (kind == "fringe") return read_fringe(object);
  if (kind == "white") return White{};
  if (kind == "black") return Black{};
  if (kind == "image") {
    return ImageFile{object.at("file").file_name("the projected picture, PNG or TIFF")};
  }
  value.fail(what);
  return White{};
}

std::vector<Pattern> read_patterns(const JsonValue& list) {
  std::vector<Pattern> patterns;
  std::unordered_set<int> used;
  for (const JsonValue& object : list.elements("the projected patterns")) {
    const JsonValue index = object.at("index");
    patterns.push_back({.index = index.whole(0, INT_MAX, "the pattern's number"),
                        .kind = read_pattern_kind(object)});
    if (!used.insert(patterns.back().index).second) {
      index.fail("a number no other pattern of the session has");
    }
  }
  return patterns;
}

std::string read_sha256(const JsonValue& value) {
  const std::string what = "the SHA-256 of the file, 64 hexadecimal digits";
  std::string hash = value.text(what);
  std::ranges::transform(hash, hash.begin(), [](char c) {
    return c >= 'A' && c <= 'F' ? static_cast<char>(c - 'A' + 'a') : c;
  });
  const bool is_hex = hash.find_first_not_of("0123456789abcdef") == std::string::npos;
  if (hash.size() != 64 || !is_hex) value.fail(what);
  return hash;
}

FrameRecord read_frame_record(const JsonValue& object, const std::unordered_set<int>& indices) {
  FrameRecord frame;
  const JsonValue pattern = object.at("pattern");
  frame.pattern = pattern.whole(0, INT_MAX, "the index of the frame's pattern");
  if (!indices.contains(frame.pattern)) pattern.fail("the index of one of /patterns");
  frame.exposure_us = object.at("exposure_us").positive("the frame's exposure, us");
  frame.file = object.at("file").file_name("the frame, TIFF or PNG");
  if (const auto id = object.find("frame_id")) frame.frame_id = id->counter("the camera's number");
  const auto nanoseconds = [&](const std::string& key) -> std::optional<std::int64_t> {
    const auto value = object.find(key);
    if (!value) return std::nullopt;
    return value->integer(INT64_MIN, INT64_MAX, "a time, ns");
  };
  frame.camera_timestamp_ns = nanoseconds("camera_timestamp_ns");
  frame.edge_timestamp_ns = nanoseconds("edge_timestamp_ns");
  if (const auto hash = object.find("sha256")) frame.sha256 = read_sha256(*hash);
  return frame;
}

std::vector<FrameRecord> read_frames(const JsonValue& list, const std::vector<Pattern>& patterns) {
  std::unordered_set<int> indices;
  for (const Pattern& pattern : patterns) indices.insert(pattern.index);
  std::vector<FrameRecord> frames;
  for (const JsonValue& object : list.elements("the frames")) {
    frames.push_back(read_frame_record(object, indices));
  }
  return frames;
}

// A mono camera's list has one element or three equal ones, any other camera's has three.
void fit_bands(std::vector<double>& bands, int band_count, const JsonValue& place) {
  if (bands.size() == 3 && band_count == 1) {
    if (bands[0] != bands[1] || bands[1] != bands[2]) {
      place.fail("1 number, or 3 equal ones, for a mono camera");
    }
    bands.resize(1);
  } else if (bands.size() == 1 && band_count == 3) {
    place.fail("a list of 3 for this camera's pixel_format");
  }
}

void fit_transfer(const TransferByBand& transfer, int band_count, const JsonValue& place) {
  const auto& bands = transfer.harmonics;
  if (band_count == 1 && (bands[0] != bands[1] || bands[1] != bands[2])) {
    place.fail("one transfer, or three equal ones, for a mono camera");
  }
}

// White adds more than black has, or the two are not of one reflector and unit.
void check_contrast(const Calibration& calibration, const JsonValue& place) {
  if (!calibration.irradiance) return;
  const std::vector<double>& signal = calibration.irradiance->signal_per_us;
  const std::vector<double>& black = calibration.projector_black_dn_per_us;
  const std::vector<JsonValue> values = place.elements("projector black by band");
  for (std::size_t band = 0; band < std::min(signal.size(), black.size()); ++band) {
    if (black[band] < signal[band]) continue;
    std::ostringstream text;
    text << "a number below irradiance.signal_per_us (" << signal[band]
         << " DN per microsecond, what white adds): what a black pattern gives on the same "
            "reflector; measure it there, in DN per microsecond without the camera's black level";
    values[band].fail(text.str());
  }
}

// What only the camera's kind decides about a calibration.
void fit_to_camera(Calibration& calibration, const CameraInfo& camera, const JsonValue& object) {
  const int bands = band_count(camera.pixel_format.filter);
  if (calibration.irradiance) {
    fit_bands(calibration.irradiance->signal_per_us, bands,
              object.at("irradiance").at("signal_per_us"));
  }
  if (!calibration.projector_black_dn_per_us.empty()) {
    fit_bands(calibration.projector_black_dn_per_us, bands, object.at("projector_black"));
    check_contrast(calibration, object.at("projector_black"));
  }
  if (!calibration.stripe_transfer) return;
  const JsonValue place = object.at("stripe_transfer");
  if (const auto* all = std::get_if<TransferByBand>(&*calibration.stripe_transfer)) {
    fit_transfer(*all, bands, place);
  } else if (const auto* depths = std::get_if<TransferByDepth>(&*calibration.stripe_transfer)) {
    for (const auto& entry : depths->entries) fit_transfer(entry.transfer, bands, place);
  }
}

Manifest read_document(const JsonValue& root) {
  Manifest manifest;
  read_format(root.at("format"));
  manifest.id = read_id(root.at("id"));
  manifest.created = read_created(root.at("created"));
  manifest.subject = read_optional_text(root, "subject");
  manifest.notes = read_optional_text(root, "notes");
  manifest.software = read_optional_text(root, "software");
  manifest.plan = read_optional_text(root, "plan");
  manifest.state = read_state(root);
  if (const auto failure = root.find("failure")) manifest.failure = read_failure(*failure);
  manifest.camera = read_camera(root.at("camera"));
  manifest.projector = read_projector(root.at("projector"));
  manifest.calibration = read_calibration(root.at("calibration"));
  fit_to_camera(manifest.calibration, manifest.camera, root.at("calibration"));
  manifest.patterns = read_patterns(root.at("patterns"));
  manifest.frames = read_frames(root.at("frames"), manifest.patterns);
  return manifest;
}

}  // namespace

std::string to_string(SessionState state) {
  for (const auto& [candidate, name] : kStateNames) {
    if (candidate == state) return std::string(name);
  }
  check(false, "a session state without a name");
  return {};
}

std::optional<SessionState> parse_session_state(std::string_view name) {
  for (const auto& [state, state_name] : kStateNames) {
    if (state_name == name) return state;
  }
  return std::nullopt;
}

const Pattern* Manifest::find_pattern(int index) const {
  const auto it = std::ranges::find(patterns, index, &Pattern::index);
  return it == patterns.end() ? nullptr : &*it;
}

Result<Manifest> parse_manifest(std::string_view json, const std::string& file) {
  const Result<Json> document = parse_json(json, file);
  if (!document) return tl::unexpected(document.error());
  JsonErrors errors(file);
  Manifest manifest = read_document(JsonValue(*document, errors));
  if (errors.first()) return tl::unexpected(*errors.first());
  const Json others = unknown_keys(*document, known_document(manifest));
  if (!others.empty()) manifest.other_keys = others.dump();
  return manifest;
}

Result<Manifest> read_manifest(const std::filesystem::path& session) {
  const std::filesystem::path path = session / "session.json";
  const Result<std::string> text = read_text(path);
  if (!text) return tl::unexpected(text.error());
  return parse_manifest(*text, path.string());
}

}  // namespace estimation
