#include "hw_sim/world/effects.h"

#include <toml++/toml.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <optional>
#include <sstream>
#include <string>
#include <variant>

#include "rig/toml_text.h"

namespace hw_sim {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Key {
  std::variant<double*, int*, bool*, estimation::Vec3*> value;
  double least = 0, greatest = 0;  // of a number, or of a vector's members
};
using Keys = std::map<std::string, Key, std::less<>>;  // "section.key"

Keys keys_of(Effects& e) {
  return {{"projector.blur_px", {&e.blur_px, 0, 20}},
          {"projector.focus_mm", {&e.focus_mm, 1, 1e5}},
          {"projector.defocus_px_per_mm", {&e.defocus_px_per_mm, 0, 1}},
          {"projector.pixel_fill_frac", {&e.pixel_fill_frac, 0.1, 1}},
          {"projector.gamma", {&e.gamma, 0.2, 5}},
          {"projector.black_frac", {&e.black_frac, 0, 0.5}},
          {"projector.vignetting_frac", {&e.vignetting_frac, 0, 0.95}},
          {"projector.crosstalk_frac", {&e.crosstalk_frac, 0, 1.0 / 3}},
          {"projector.input_lag_refreshes", {&e.input_lag_refreshes, 0, 20}},
          {"projector.scanout_ms", {&e.scanout_ms, 0, 100}},
          {"projector.ripple_frac", {&e.ripple_frac, 0, 1}},
          {"projector.ripple_hz", {&e.ripple_hz, 1, 1e5}},
          {"camera.blur_px", {&e.camera_blur_px, 0, 20}},
          {"camera.focus_mm", {&e.camera_focus_mm, 1, 1e5}},
          {"camera.defocus_px_per_mm", {&e.camera_defocus_px_per_mm, 0, 1}},
          {"camera.vignetting_frac", {&e.camera_vignetting_frac, 0, 0.95}},
          {"camera.full_well_e", {&e.full_well_e, 0, 1e9}},
          {"camera.pixel_gain_sd_frac", {&e.pixel_gain_sd_frac, 0, 0.3}},
          {"camera.pixel_offset_sd_dn", {&e.pixel_offset_sd_dn, 0, 1000}},
          {"camera.hot_pixel_frac", {&e.hot_pixel_frac, 0, 1}},
          {"camera.hot_pixel_dn_per_s", {&e.hot_pixel_dn_per_s, 0, 1e7}},
          {"camera.is_cross_polarised", {&e.is_cross_polarised}},
          {"room.ambient_frac", {&e.ambient_frac, 0, 10}},
          {"room.flicker_frac", {&e.flicker_frac, 0, 1}},
          {"room.mains_hz", {&e.mains_hz, 1, 1000}},
          {"room.backdrop_reflectance_frac", {&e.backdrop_reflectance_frac, 0, 1}},
          {"room.backdrop_mm", {&e.backdrop_mm, 1, 1e5}},
          {"subject.drift_mm_per_s", {&e.drift_mm_per_s, -1000, 1000}},
          {"subject.breathing_mm", {&e.breathing_mm, -100, 100}},
          {"subject.breathing_hz", {&e.breathing_hz, 0, 10}},
          {"subject.blink_start_s", {&e.blink_start_s, 0, 1e6}},
          {"subject.blink_s", {&e.blink_s, 0, 1e6}},
          {"subject.blink_period_s", {&e.blink_period_s, 0, 1e6}},
          {"subject.skin_roughness_frac", {&e.skin_roughness_frac, 0.05, 1}}};
}

rig::Result<void> fault(const std::filesystem::path& file, const std::string& text) {
  return rig::failure(rig::Fault::kConfiguration, file.string() + ": " + text);
}

// "from 0 to 20", without a double's many digits.
std::string range_of(const Key& key) {
  std::ostringstream text;
  text << "from " << key.least << " to " << key.greatest;
  return text.str();
}

std::optional<double> number_in(const toml::node& node, const Key& key) {
  const double value = node.value<double>().value_or(kInfinity);
  if (!(value >= key.least && value <= key.greatest)) return std::nullopt;
  return value;
}

// What a key takes, for a message; empty when it took the node.
std::string take(const toml::node& node, const Key& key) {
  if (auto* flag = std::get_if<bool*>(&key.value)) {
    if (!node.is_boolean()) return "true or false";
    **flag = *node.value<bool>();
    return {};
  }
  if (auto* vector = std::get_if<estimation::Vec3*>(&key.value)) {
    const toml::array* values = node.as_array();
    if (values == nullptr || values->size() != 3) return "[x, y, z]";
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto value = number_in(*values->get(axis), key);
      if (!value) return "[x, y, z] with numbers " + range_of(key);
      (**vector)[static_cast<int>(axis)] = *value;
    }
    return {};
  }
  const auto value = number_in(node, key);
  if (auto* count = std::get_if<int*>(&key.value)) {
    if (!value || !node.is_integer()) return "a whole number " + range_of(key);
    **count = static_cast<int>(*value);
    return {};
  }
  if (!value) return "a number " + range_of(key);
  *std::get<double*>(key.value) = *value;
  return {};
}

rig::Result<void> read_value(const std::string& name, const toml::node& node, const Keys& keys,
                             const std::filesystem::path& file) {
  const auto key = keys.find(name);
  if (key == keys.end()) {
    std::string known;
    for (const auto& [each, unused] : keys) known.append(known.empty() ? "" : ", ").append(each);
    return fault(file, name + " is no effect; known are " + known);
  }
  if (const std::string wanted = take(node, key->second); !wanted.empty())
    return fault(file, name + " is not " + wanted);
  return {};
}

}  // namespace

double Effects::blur_at(double distance_mm) const {
  return std::hypot(blur_px, defocus_px_per_mm * (distance_mm - focus_mm));
}

double Effects::camera_blur_at(double distance_mm) const {
  return std::hypot(camera_blur_px, camera_defocus_px_per_mm * (distance_mm - camera_focus_mm));
}

bool Effects::drifts() const {
  const estimation::Vec3 still(0, 0, 0);
  return drift_mm_per_s != still || (breathing_mm != still && breathing_hz > 0);
}

estimation::Vec3 Effects::displacement_mm(double elapsed_s) const {
  return elapsed_s * drift_mm_per_s +
         std::sin(2 * std::numbers::pi * breathing_hz * elapsed_s) * breathing_mm;
}

double Effects::blink_frac(double begin_s, double end_s) const {
  if (!(blink_s > 0)) return 0;
  // Time with open eyes until `time_s`.
  const auto open_until = [&](double time_s) {
    const double since_s = time_s - blink_start_s;
    if (since_s <= 0) return 0.0;
    if (!(blink_period_s > blink_s)) return std::min(since_s, blink_s);
    const double periods = std::floor(since_s / blink_period_s);
    return periods * blink_s + std::min(since_s - periods * blink_period_s, blink_s);
  };
  if (end_s > begin_s) return (open_until(end_s) - open_until(begin_s)) / (end_s - begin_s);
  return open_until(begin_s + 1e-9) > open_until(begin_s) ? 1 : 0;
}

rig::Result<Effects> parse_effects(std::string_view toml, const std::filesystem::path& file) {
  const rig::Result<toml::table> document = rig::parse_toml(toml, file);
  if (!document) return tl::unexpected(document.error());
  Effects effects;
  const Keys keys = keys_of(effects);
  for (const auto& [section, node] : *document) {
    const toml::table* table = node.as_table();
    if (table == nullptr)
      return rig::failure(rig::Fault::kConfiguration,
                          file.string() + ": " + std::string(section.str()) +
                              " is outside of [projector], [camera], [room] and [subject]");
    for (const auto& [key, value] : *table)
      if (auto read = read_value(std::string(section.str()) + "." + std::string(key.str()), value,
                                 keys, file);
          !read)
        return tl::unexpected(read.error());
  }
  return effects;
}

rig::Result<Effects> read_effects(const std::filesystem::path& file) {
  const rig::Result<std::string> text = rig::read_text(file, "name an existing file of effects");
  if (!text) return tl::unexpected(text.error());
  return parse_effects(*text, file);
}

}  // namespace hw_sim
