#include "rig/rig_file.h"

#include <toml++/toml.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <numeric>
#include <set>
#include <sstream>
#include <string_view>
#include <utility>

#include "rig/toml_text.h"

namespace rig {
namespace {

// Edits (insert, delete, replace) that turn `a` into `b`: how near a mistyped key is to a known
// one.
std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (const char from : a) {
    std::size_t* cell = row.data();
    std::size_t diagonal = *cell;
    std::size_t left = ++*cell;
    for (const char to : b) {
      const std::size_t replaced = diagonal + (from == to ? 0 : 1);
      diagonal = *++cell;
      left = std::min(std::min(diagonal, left) + 1, replaced);
      *cell = left;
    }
  }
  return row.back();
}

// Collects everything wrong with the file, each with its line.
class Faults {
 public:
  explicit Faults(std::string file) : file_(std::move(file)) {}

  void add(const toml::source_region& where, const std::string& text) {
    lines_.push_back(file_ + ":" + std::to_string(where.begin.line) + ": " + text);
  }
  void add(const std::string& text) { lines_.push_back(file_ + ": " + text); }
  bool empty() const { return lines_.empty(); }
  std::string text() const {
    std::string all;
    for (const std::string& line : lines_) all += (all.empty() ? "" : "\n") + line;
    return all;
  }

 private:
  std::string file_;
  std::vector<std::string> lines_;
};

// One [section] of the file. Reading a key makes it known; report_unknown() names the rest.
class Section {
 public:
  Section(const toml::table* table, std::string name, Faults& faults)
      : table_(table), name_(std::move(name)), faults_(faults) {}

  void integer(std::string_view key, std::int64_t low, std::int64_t high,
               const std::function<void(std::int64_t)>& store) {
    const toml::node* node = find(key);
    if (node == nullptr) return;
    const auto value = node->value_exact<std::int64_t>();
    if (!value || *value < low || *value > high) {
      fault(*node, key,
            "expected a whole number from " + std::to_string(low) + " to " + std::to_string(high));
      return;
    }
    store(*value);
  }

  void number(std::string_view key, double low, double high,
              const std::function<void(double)>& store) {
    const toml::node* node = find(key);
    if (node == nullptr) return;
    const auto value = node->is_number() ? node->value<double>() : std::nullopt;
    if (!value || !std::isfinite(*value) || *value < low || *value > high) {
      std::ostringstream expected;
      expected << "expected a number from " << low << " to " << high;
      fault(*node, key, expected.str());
      return;
    }
    store(*value);
  }

  void text(std::string_view key, const std::function<void(const std::string&)>& store) {
    const toml::node* node = find(key);
    if (node == nullptr) return;
    const auto value = node->value_exact<std::string>();
    // A file's name would end at a zero byte.
    if (!value || value->find('\0') != std::string::npos) {
      fault(*node, key, "expected text in quotes, without a zero byte");
      return;
    }
    store(*value);
  }

  void boolean(std::string_view key, bool& target) {
    const toml::node* node = find(key);
    if (node == nullptr) return;
    const auto value = node->value_exact<bool>();
    if (!value) {
      fault(*node, key, "expected true or false");
      return;
    }
    target = *value;
  }

  // One of a few words.
  template <typename T>
  void choice(std::string_view key, const std::vector<std::pair<std::string_view, T>>& words,
              const std::function<void(T)>& store) {
    const toml::node* node = find(key);
    if (node == nullptr) return;
    const auto value = node->value_exact<std::string>();
    std::string expected;
    for (const auto& [word, meaning] : words) {
      if (value == word) {
        store(meaning);
        return;
      }
      expected += (expected.empty() ? "\"" : ", \"") + std::string(word) + "\"";
    }
    fault(*node, key, "expected one of " + expected);
  }

  // A list of whole numbers, as many as `count_low` to `count_high`.
  void integers(std::string_view key, std::size_t count_low, std::size_t count_high,
                std::int64_t low, std::int64_t high,
                const std::function<void(const std::vector<std::int64_t>&)>& store) {
    const toml::node* node = find(key);
    if (node == nullptr) return;
    std::vector<std::int64_t> values;
    bool is_good = node->is_array();
    if (is_good) {
      for (const toml::node& element : *node->as_array()) {
        const auto value = element.value_exact<std::int64_t>();
        is_good = is_good && value && *value >= low && *value <= high;
        values.push_back(value.value_or(0));
      }
    }
    if (!is_good || values.size() < count_low || values.size() > count_high) {
      fault(*node, key,
            "expected a list of " + std::to_string(count_low) + " to " +
                std::to_string(count_high) + " whole numbers from " + std::to_string(low) + " to " +
                std::to_string(high));
      return;
    }
    store(values);
  }

  void require(std::string_view key) {
    if (table_ != nullptr && table_->contains(key)) return;
    faults_.add("missing key " + full(key) + "; config/rig.example.toml says what it means");
  }

  void fault_at(std::string_view key, const std::string& text) {
    const toml::node* node = table_ == nullptr ? nullptr : table_->get(key);
    if (node != nullptr) {
      fault(*node, key, text);
    } else {
      faults_.add(full(key) + ": " + text);
    }
  }

  void report_unknown(const std::vector<std::string_view>& subsections = {}) const {
    if (table_ == nullptr) return;
    for (const auto& [key, node] : *table_) {
      const std::string_view word = key.str();
      if (known_.contains(std::string(word))) continue;
      if (std::find(subsections.begin(), subsections.end(), word) != subsections.end()) continue;
      // As much as tells which key is meant: a line of 8 kB may be one key.
      const std::string_view start = word.substr(0, 40);
      std::string nearest;
      std::size_t nearest_distance = std::numeric_limits<std::size_t>::max();
      const auto consider = [&](std::string_view candidate) {
        const std::size_t longer = std::max(start.size(), candidate.size());
        if (longer - std::min(start.size(), candidate.size()) >= nearest_distance) return;
        const std::size_t distance = edit_distance(start, candidate);
        if (distance >= nearest_distance) return;
        nearest = candidate;
        nearest_distance = distance;
      };
      for (const std::string& candidate : known_) consider(candidate);
      for (const std::string_view candidate : subsections) consider(candidate);
      faults_.add(key.source(),
                  "unknown key " + full(word) + "; the nearest known key is " + full(nearest));
    }
  }

 private:
  const toml::node* find(std::string_view key) {
    known_.emplace(key);
    return table_ == nullptr ? nullptr : table_->get(key);
  }
  std::string full(std::string_view key) const {
    return name_.empty() ? std::string(key) : name_ + "." + std::string(key);
  }
  void fault(const toml::node& node, std::string_view key, const std::string& text) {
    faults_.add(node.source(), full(key) + ": " + text);
  }

  const toml::table* table_;
  std::string name_;
  Faults& faults_;
  std::set<std::string> known_;
};

constexpr int kSizeLimit_px = 65535;
constexpr std::int64_t kDelayLimit_us = 1'000'000;

template <typename Duration>
std::function<void(std::int64_t)> into(Duration& target) {
  return [&target](std::int64_t count) { target = Duration(count); };
}

std::function<void(std::int64_t)> into(int& target) {
  return [&target](std::int64_t value) { target = static_cast<int>(value); };
}

std::function<void(std::int64_t)> into(std::uint16_t& target) {
  return [&target](std::int64_t value) { target = static_cast<std::uint16_t>(value); };
}

std::function<void(const std::string&)> into(std::string& target) {
  return [&target](const std::string& value) { target = value; };
}

void read_camera(Section& section, CameraSettings& camera, SensorSettings& sensor) {
  for (const char* key : {"address", "pixel_format", "width_px", "height_px", "black_level_dn",
                          "saturation_level_dn"})
    section.require(key);
  section.text("address", into(camera.address));
  section.text("serial", into(camera.serial));
  section.text("pixel_format", into(camera.pixel_format));
  section.integer("width_px", 1, kSizeLimit_px, into(camera.width_px));
  section.integer("height_px", 1, kSizeLimit_px, into(camera.height_px));
  section.integer("offset_x_px", 0, kSizeLimit_px, into(camera.offset_x_px));
  section.integer("offset_y_px", 0, kSizeLimit_px, into(camera.offset_y_px));
  section.integer("packet_size_bytes", 0, kSizeLimit_px, into(camera.packet_size_bytes));
  section.choice<Bracketing>(
      "bracketing",
      {{"sequencer", Bracketing::kSequencer}, {"trigger_width", Bracketing::kTriggerWidth}},
      [&](Bracketing value) { camera.bracketing = value; });
  section.text("trigger_line", into(camera.trigger_line));
  section.integer("line_debounce_us", 0, kDelayLimit_us, into(camera.line_debounce));
  section.number("black_level_dn", 0, 65535, [&](double value) { sensor.black_level_dn = value; });
  section.number("saturation_level_dn", 0, 65535,
                 [&](double value) { sensor.saturation_level_dn = value; });
  section.number("gain_e_per_dn", 1e-6, 1e6, [&](double value) { sensor.gain_e_per_dn = value; });
  section.number("read_noise_e", 0, 1e6, [&](double value) { sensor.read_noise_e = value; });
  if (sensor.saturation_level_dn != 0 && sensor.saturation_level_dn <= sensor.black_level_dn)
    section.fault_at("saturation_level_dn", "must lie above black_level_dn");
  section.report_unknown();
}

void read_projector(Section& section, ProjectorSettings& projector) {
  for (const char* key : {"monitor", "width_px", "height_px"}) section.require(key);
  section.text("monitor", into(projector.monitor));
  section.integer("width_px", 8, kSizeLimit_px, into(projector.width_px));
  section.integer("height_px", 8, kSizeLimit_px, into(projector.height_px));
  section.integer("timing_check_intervals", 50, 10000, into(projector.timing_check_intervals));
  section.integer("sync_square_px", 4, 4096, into(projector.sync_square.size_px));
  section.choice<Corner>("sync_corner",
                         {{"top_left", Corner::kTopLeft},
                          {"top_right", Corner::kTopRight},
                          {"bottom_left", Corner::kBottomLeft},
                          {"bottom_right", Corner::kBottomRight}},
                         [&](Corner value) { projector.sync_square.corner = value; });
  section.boolean("sync_inverted", projector.sync_square.is_inverted);
  if (projector.sync_square.size_px > std::min(projector.width_px, projector.height_px))
    section.fault_at("sync_square_px", "the sync square is larger than the projector");
  section.report_unknown();
}

void read_trigger(Section& section, TriggerSettings& trigger) {
  section.integer("vendor_id", 0, 0xffff, into(trigger.vendor_id));
  section.integer("product_id", 0, 0xffff, into(trigger.product_id));
  section.text("serial", into(trigger.serial));
  section.integer("delay_rise_us", 0, kDelayLimit_us, into(trigger.delay_rise));
  section.integer("delay_fall_us", 0, kDelayLimit_us, into(trigger.delay_fall));
  section.integer("gap_us", 0, kDelayLimit_us, into(trigger.gap));
  section.integer("debounce_us", 0, kDelayLimit_us, into(trigger.debounce));
  section.integer("threshold_high_adc", 1, 1023, into(trigger.threshold_high));
  section.integer("threshold_low_adc", 0, 1022, into(trigger.threshold_low));
  if (trigger.threshold_low >= trigger.threshold_high)
    section.fault_at("threshold_low_adc", "must lie below threshold_high_adc");
  section.report_unknown();
}

void read_sequence(Section& section, SequenceSettings& sequence) {
  constexpr std::int64_t kExposureLimit_us = 10'000'000;
  section.require("exposures_us");
  section.integers("exposures_us", 1, 8, 1, kExposureLimit_us,
                   [&](const std::vector<std::int64_t>& values) {
                     for (const std::int64_t value : values) sequence.exposures.emplace_back(value);
                   });
  const auto not_increasing = std::adjacent_find(sequence.exposures.begin(),
                                                 sequence.exposures.end(), std::greater_equal<>());
  if (not_increasing != sequence.exposures.end())
    section.fault_at("exposures_us", "list them from the shortest to the longest, each once");
  section.integer("edge_deadline_ms", 10, 60000, into(sequence.edge_deadline));
  section.integer("frame_deadline_ms", 10, 600000, into(sequence.frame_deadline));
  section.integer("retake_limit", 0, 100, into(sequence.retake_limit));
  section.integer("reopen_deadline_ms", 0, 600000, into(sequence.reopen_deadline));
  section.choice<SyncMode>("sync",
                           {{"trigger_box", SyncMode::kTriggerBox},
                            {"camera_line", SyncMode::kCameraLine},
                            {"software", SyncMode::kSoftware}},
                           [&](SyncMode value) { sequence.sync = value; });
  section.choice<Pace>("pace", {{"handshake", Pace::kHandshake}, {"paced", Pace::kPaced}},
                       [&](Pace value) { sequence.pace = value; });
  section.integer("readout_us", 0, kExposureLimit_us, into(sequence.readout));
  section.choice<bool>("order", {{"plan", false}, {"shuffled", true}},
                       [&](bool value) { sequence.is_shuffled = value; });
  section.integer("repeat_every", 0, 1000, into(sequence.repeat_every));
  section.report_unknown();
}

// What a rig without a trigger box cannot be told, and what its camera must be.
void read_sync(const toml::table& document, Section& camera, Section& sequence, RigFile& rig,
               Faults& faults) {
  if (rig.sequence.sync == SyncMode::kTriggerBox) return;
  const bool is_software = rig.sequence.sync == SyncMode::kSoftware;
  const std::string mode =
      is_software ? "sequence.sync = \"software\"" : "sequence.sync = \"camera_line\"";
  if (const toml::node* trigger = document.get("trigger"); trigger != nullptr)
    faults.add(trigger->source(), "trigger: a rig with " + mode +
                                      " has no trigger box; delete the section [trigger], or set "
                                      "sequence.sync to \"trigger_box\"");
  if (rig.camera.bracketing == Bracketing::kTriggerWidth)
    camera.fault_at("bracketing", "\"trigger_width\" needs a trigger box's pulses, and " + mode +
                                      " has none; set it to \"sequencer\"");
  if (!is_software) {
    rig.camera.trigger_edge = TriggerEdge::kAny;
    return;
  }
  if (rig.camera.trigger_line != CameraSettings{}.trigger_line)
    camera.fault_at("trigger_line", mode + " uses no line; delete the key");
  rig.camera.trigger_line = kSoftwareTrigger;
  if (rig.sequence.pace == Pace::kPaced)
    sequence.fault_at(
        "pace", "\"paced\" needs a photodiode, and " + mode + " has none; set it to \"handshake\"");
}

RigFile read_document(const toml::table& document, const std::filesystem::path& path,
                      Faults& faults) {
  constexpr std::array<std::string_view, 7> kSections{
      "camera", "projector", "trigger", "sequence", "storage", "daemon", "calibration"};
  RigFile rig;
  rig.path = path;
  Section top(&document, "", faults);
  top.text("name", into(rig.name));
  top.report_unknown({kSections.begin(), kSections.end()});

  const auto section = [&](std::string_view name) {
    const toml::node* node = document.get(name);
    if (node != nullptr && !node->is_table())
      faults.add(node->source(),
                 std::string(name) + ": expected a section [" + std::string(name) + "]");
    return Section(node == nullptr ? nullptr : node->as_table(), std::string(name), faults);
  };
  Section camera = section("camera");
  read_camera(camera, rig.camera, rig.sensor);
  Section projector = section("projector");
  read_projector(projector, rig.projector);
  Section trigger = section("trigger");
  read_trigger(trigger, rig.trigger);
  Section sequence = section("sequence");
  read_sequence(sequence, rig.sequence);
  read_sync(document, camera, sequence, rig, faults);
  Section storage = section("storage");
  storage.text("directory", [&](const std::string& value) { rig.storage.directory = value; });
  storage.report_unknown();
  Section daemon = section("daemon");
  daemon.integer("port", 1, 65535, into(rig.daemon.port));
  daemon.report_unknown();
  Section calibration = section("calibration");
  calibration.text(
      "file", [&](const std::string& value) { rig.calibration_file = path.parent_path() / value; });
  calibration.report_unknown();
  return rig;
}

}  // namespace

Result<RigFile> parse_rig_file(std::string_view toml, const std::filesystem::path& path) {
  const Result<toml::table> document = parse_toml(toml, path);
  if (!document) return tl::unexpected(document.error());
  Faults faults(path.string());
  RigFile rig = read_document(*document, path, faults);
  if (!faults.empty()) return failure(Fault::kConfiguration, faults.text());
  return rig;
}

Result<RigFile> read_rig_file(const std::filesystem::path& path) {
  const Result<std::string> text = read_text(
      path, "name an existing rig file, such as a copy of config/rig.example.toml, with --rig");
  if (!text) return tl::unexpected(text.error());
  return parse_rig_file(*text, path);
}

}  // namespace rig
