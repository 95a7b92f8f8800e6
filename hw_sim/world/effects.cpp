#include "hw_sim/world/effects.h"

#include <toml++/toml.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <string>
#include <system_error>

namespace hw_sim {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Key {
  double* value;
  double least, greatest;
};
using Keys = std::map<std::string, Key, std::less<>>;  // "section.key"

Keys keys_of(Effects& effects) {
  return {{"projector.blur_px", {&effects.blur_px, 0, 20}},
          {"projector.focus_mm", {&effects.focus_mm, 1, 1e5}},
          {"projector.defocus_px_per_mm", {&effects.defocus_px_per_mm, 0, 1}},
          {"projector.black_frac", {&effects.black_frac, 0, 0.5}},
          {"projector.vignetting_frac", {&effects.vignetting_frac, 0, 0.95}},
          {"camera.vignetting_frac", {&effects.camera_vignetting_frac, 0, 0.95}},
          {"room.ambient_frac", {&effects.ambient_frac, 0, 10}},
          {"room.flicker_frac", {&effects.flicker_frac, 0, 1}},
          {"room.mains_hz", {&effects.mains_hz, 1, 1000}}};
}

rig::Result<void> fault(const std::filesystem::path& file, const std::string& text) {
  return rig::failure(rig::Fault::kConfiguration, file.string() + ": " + text);
}

rig::Result<void> read_drift(const toml::node& node, const std::filesystem::path& file,
                             Effects& effects) {
  const toml::array* values = node.as_array();
  if (values == nullptr || values->size() != 3)
    return fault(file, "subject.drift_mm_per_s is not [x, y, z]");
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto value = values->get(axis)->value<double>();
    if (!value || !(std::abs(*value) < 1000))
      return fault(file, "subject.drift_mm_per_s holds no number below 1000 mm/s");
    effects.drift_mm_per_s[static_cast<int>(axis)] = *value;
  }
  return {};
}

rig::Result<void> read_value(const std::string& name, const toml::node& node,
                             const std::filesystem::path& file, Effects& effects) {
  if (name == "subject.drift_mm_per_s") return read_drift(node, file, effects);
  const Keys keys = keys_of(effects);
  const auto key = keys.find(name);
  if (key == keys.end()) {
    std::string known = "subject.drift_mm_per_s";
    for (const auto& [each, unused] : keys) known.append(", ").append(each);
    return fault(file, name + " is no effect; known are " + known);
  }
  const double value = node.value<double>().value_or(kInfinity);
  if (!(value >= key->second.least && value <= key->second.greatest))
    return fault(file, name + " is not a number from " + std::to_string(key->second.least) +
                           " to " + std::to_string(key->second.greatest));
  *key->second.value = value;
  return {};
}

}  // namespace

double Effects::blur_at(double distance_mm) const {
  return std::hypot(blur_px, defocus_px_per_mm * (distance_mm - focus_mm));
}

rig::Result<Effects> parse_effects(std::string_view toml, const std::filesystem::path& file) {
  toml::table document;
  try {
    document = toml::parse(toml, std::string_view(file.native()));
  } catch (const toml::parse_error& error) {
    return rig::failure(rig::Fault::kConfiguration, file.string() + ": line " +
                                                        std::to_string(error.source().begin.line) +
                                                        ": " + std::string(error.description()));
  }
  Effects effects;
  for (const auto& [section, node] : document) {
    const toml::table* table = node.as_table();
    if (table == nullptr)
      return rig::failure(rig::Fault::kConfiguration,
                          file.string() + ": " + std::string(section.str()) +
                              " is outside of [projector], [camera], [room] and [subject]");
    for (const auto& [key, value] : *table)
      if (auto read = read_value(std::string(section.str()) + "." + std::string(key.str()), value,
                                 file, effects);
          !read)
        return tl::unexpected(read.error());
  }
  return effects;
}

rig::Result<Effects> read_effects(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::error_code unknown;  // then reading says why
  if (!in || std::filesystem::is_directory(file, unknown))
    return rig::failure(rig::Fault::kConfiguration,
                        "cannot read the effects file " + file.string());
  const std::string text{std::istreambuf_iterator<char>(in), {}};
  return parse_effects(text, file);
}

}  // namespace hw_sim
