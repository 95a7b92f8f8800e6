// Writing session.json, and keeping what somebody else put into it.
#include <algorithm>
#include <array>
#include <map>

#include "estimation/session/manifest_parts.h"

namespace estimation {
namespace {

Json json_of(const Mat3& matrix) {
  Json rows = Json::array();
  for (int row = 0; row < 3; ++row) {
    rows.push_back({matrix(row, 0), matrix(row, 1), matrix(row, 2)});
  }
  return rows;
}

template <typename T>
void put(Json& object, const char* key, const std::optional<T>& value) {
  if (value) object[key] = *value;
}

Json json_of(const CameraInfo& camera) {
  Json object{{"width", camera.width_px},
              {"height", camera.height_px},
              {"roi", {camera.roi_x_px, camera.roi_y_px}},
              {"pixel_format", to_string(camera.pixel_format)}};
  put(object, "black_level", camera.black_level_dn);
  for (const DarkFrame& dark : camera.dark_frames) {
    object["dark_frames"].push_back({{"exposure_us", dark.exposure_us}, {"file", dark.file}});
  }
  put(object, "saturation_level", camera.saturation_level_dn);
  put(object, "gain_e_per_dn", camera.gain_e_per_dn);
  put(object, "read_noise_e", camera.read_noise_e);
  put(object, "flat_field", camera.flat_field_file);
  return object;
}

Json json_of(const ProjectorInfo& projector) {
  Json object{{"width", projector.width_px}, {"height", projector.height_px}};
  if (const auto& square = projector.sync_square) {
    object["sync_square"] = {square->x_px, square->y_px, square->width_px, square->height_px};
  }
  return object;
}

Json json_of(const Lens& lens) { return {{"K", json_of(lens.K)}, {"distortion", lens.distortion}}; }

Json json_of(const Irradiance& irradiance) {
  Json object{{"signal_per_us", irradiance.signal_per_us}};
  put(object, "reference_distance_mm", irradiance.reference_distance_mm);
  put(object, "vignetting", irradiance.vignetting_file);
  return object;
}

Json json_of(const TransferByBand& transfer) {
  const auto& [red, green, blue] = transfer.harmonics;
  const bool is_same_for_all = (green.empty() || green == red) && (blue.empty() || blue == red);
  if (is_same_for_all) return red;
  return {{"R", red}, {"G", green}, {"B", blue}};
}

Json json_of(const TransferByDepth& by_depth) {
  Json list = Json::array();
  for (const TransferByDepth::Entry& entry : by_depth.entries) {
    list.push_back({{"distance_mm", entry.distance_mm}, {"transfer", json_of(entry.transfer)}});
  }
  return list;
}

Json json_of(const TransferFile& transfer) { return transfer.file; }

Json json_of(const Calibration& calibration) {
  Json projector = json_of(calibration.projector);
  projector["R"] = json_of(calibration.projector_from_camera);
  const Vec3& t = calibration.projector_from_camera_mm;
  projector["t"] = {t[0], t[1], t[2]};
  Json object{{"camera", json_of(calibration.camera)}, {"projector", std::move(projector)}};
  if (calibration.irradiance) object["irradiance"] = json_of(*calibration.irradiance);
  if (!calibration.projector_black_dn_per_us.empty()) {
    object["projector_black"] = calibration.projector_black_dn_per_us;
  }
  if (calibration.stripe_transfer) {
    object["stripe_transfer"] = std::visit([](const auto& transfer) { return json_of(transfer); },
                                           *calibration.stripe_transfer);
  }
  if (calibration.color_matrix) object["color_matrix"] = json_of(*calibration.color_matrix);
  return object;
}

const char* name(Axis axis) { return axis == Axis::kColumn ? "column" : "row"; }

Json json_of(const Stripes& k) {
  return {{"kind", "stripes"},
          {"axis", name(k.axis)},
          {"period_px", k.period_px},
          {"width_px", k.width_px},
          {"shift_px", k.shift_px}};
}
Json json_of(const GrayCode& k) {
  return {{"kind", "gray_code"}, {"axis", name(k.axis)}, {"bit", k.bit}, {"inverted", k.inverted}};
}
Json json_of(const Fringe& k) {
  return {{"kind", "fringe"},
          {"axis", name(k.axis)},
          {"period_px", k.period_px},
          {"shift_px", k.shift_px}};
}
Json json_of(const White&) { return {{"kind", "white"}}; }
Json json_of(const Black&) { return {{"kind", "black"}}; }
Json json_of(const ImageFile& k) { return {{"kind", "image"}, {"file", k.file}}; }

Json json_of(const Pattern& pattern) {
  Json object{{"index", pattern.index}};
  object.update(std::visit([](const auto& kind) { return json_of(kind); }, pattern.kind));
  return object;
}

Json json_of(const FrameRecord& frame) {
  Json object{{"pattern", frame.pattern}, {"exposure_us", frame.exposure_us}, {"file", frame.file}};
  put(object, "frame_id", frame.frame_id);
  put(object, "camera_timestamp_ns", frame.camera_timestamp_ns);
  put(object, "edge_timestamp_ns", frame.edge_timestamp_ns);
  put(object, "sha256", frame.sha256);
  return object;
}

Json json_of(const SessionFailure& failure) {
  return {{"code", failure.code}, {"slots", failure.slots}, {"text", failure.text}};
}

template <typename T>
Json list_of(const std::vector<T>& elements) {
  Json list = Json::array();
  for (const T& element : elements) list.push_back(json_of(element));
  return list;
}

// Which key tells the elements of a list of objects apart; "" where none does.
std::string identity_key(const std::string& list_name) {
  if (list_name == "patterns") return "index";
  if (list_name == "frames" || list_name == "dark_frames") return "file";
  if (list_name == "stripe_transfer") return "distance_mm";
  return "";
}

// Elements of `list` by the value of their identity key; of several equal ones the first counts.
std::map<std::string, const Json*> by_identity(const Json& list, const std::string& key) {
  std::map<std::string, const Json*> elements;
  for (const Json& element : list) {
    if (element.is_object() && element.contains(key)) {
      // Numbers as doubles: 100 and 100.0 are the same distance.
      const Json& value = element[key];
      elements.emplace(value.is_number() ? Json(value.get<double>()).dump() : value.dump(),
                       &element);
    }
  }
  return elements;
}

Json unknown_in_list(const Json& list, const Json& known, const std::string& key) {
  Json unknown = Json::array();
  const auto known_elements = by_identity(known, key);
  for (const auto& [identity, element] : by_identity(list, key)) {
    const auto match = known_elements.find(identity);
    if (match == known_elements.end()) continue;
    Json rest = unknown_keys(*element, *match->second);
    if (rest.empty()) continue;
    rest[key] = (*element)[key];
    unknown.push_back(std::move(rest));
  }
  return unknown;
}

void add_unknown(Json& known, const Json& unknown);

void add_unknown_to_list(Json& list, const Json& unknown, const std::string& key) {
  const auto unknown_elements = by_identity(unknown, key);
  for (auto& [identity, element] : by_identity(list, key)) {
    const auto match = unknown_elements.find(identity);
    if (match == unknown_elements.end()) continue;
    const std::ptrdiff_t position = element - &list.front();
    add_unknown(list[static_cast<std::size_t>(position)], *match->second);
  }
}

// Known values win over unknown ones of the same name.
void add_unknown(Json& known, const Json& unknown) {
  for (const auto& [key, value] : unknown.items()) {
    const auto it = known.find(key);
    if (it == known.end()) {
      known[key] = value;
    } else if (it->is_object() && value.is_object()) {
      add_unknown(*it, value);
    } else if (it->is_array() && value.is_array() && !identity_key(key).empty()) {
      add_unknown_to_list(*it, value, identity_key(key));
    }
  }
}

// A list or object without objects in it takes one line if it is short: a matrix, a pattern, a
// frame.
bool fits_one_line(const Json& value) {
  constexpr std::size_t kMostElements = 64;
  if (value.size() > kMostElements) return false;
  return std::ranges::all_of(value, [](const Json& element) {
    return !element.is_object() && (!element.is_array() || fits_one_line(element));
  });
}

// Text that came from elsewhere (a subject's name) may not be UTF-8: the file must be.
std::string dump(const Json& value) {
  return value.dump(-1, ' ', false, Json::error_handler_t::replace);
}

void print(const Json& value, const std::string& indent, std::string& text) {
  if (!value.is_structured() || fits_one_line(value)) {
    text += dump(value);
    return;
  }
  text += value.is_object() ? "{" : "[";
  const std::string inner = indent + "  ";
  std::string_view separator = "\n";
  for (const auto& [key, element] : value.items()) {
    text += separator;
    text += inner;
    if (value.is_object()) text += dump(Json(key)) + ": ";
    print(element, inner, text);
    separator = ",\n";
  }
  text += "\n" + indent + (value.is_object() ? "}" : "]");
}

}  // namespace

Json known_document(const Manifest& manifest) {
  Json document{{"format", kManifestFormat},   {"id", manifest.id},
                {"created", manifest.created}, {"subject", manifest.subject},
                {"notes", manifest.notes},     {"software", manifest.software},
                {"plan", manifest.plan},       {"state", to_string(manifest.state)}};
  if (manifest.failure) document["failure"] = json_of(*manifest.failure);
  document["camera"] = json_of(manifest.camera);
  document["projector"] = json_of(manifest.projector);
  document["calibration"] = json_of(manifest.calibration);
  document["patterns"] = list_of(manifest.patterns);
  document["frames"] = list_of(manifest.frames);
  return document;
}

Json unknown_keys(const Json& document, const Json& known) {
  Json unknown = Json::object();
  for (const auto& [key, value] : document.items()) {
    const auto it = known.find(key);
    Json rest;
    if (it == known.end()) {
      rest = value;
      unknown[key] = std::move(rest);
      continue;
    }
    if (it->is_object() && value.is_object()) {
      rest = unknown_keys(value, *it);
    } else if (it->is_array() && value.is_array() && !identity_key(key).empty()) {
      rest = unknown_in_list(value, *it, identity_key(key));
    }
    if (!rest.empty()) unknown[key] = std::move(rest);
  }
  return unknown;
}

std::string format_manifest(const Manifest& manifest) {
  Json document = known_document(manifest);
  if (!manifest.other_keys.empty()) {
    const Result<Json> unknown = parse_json(manifest.other_keys, "other_keys");
    check(unknown && unknown->is_object(), "Manifest::other_keys is not a JSON object");
    add_unknown(document, *unknown);
  }
  std::string text;
  print(document, "", text);
  return text + "\n";
}

}  // namespace estimation
