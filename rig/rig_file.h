// The rig file: one TOML file that says which devices a rig is made of and how it is run. Every key
// is documented in config/rig.example.toml; an unknown key is an error with file, line and the
// nearest known key.
#pragma once

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "rig/camera.h"
#include "rig/fault.h"
#include "rig/projector.h"
#include "rig/trigger.h"

namespace rig {

// What the camera's numbers mean; copied into every session.
struct SensorSettings {
  double black_level_dn = 0;
  double saturation_level_dn = 0;
  std::optional<double> gain_e_per_dn;
  std::optional<double> read_noise_e;
};

// What tells the camera that a picture is shown, and the host that it was the right one.
enum class SyncMode {
  kTriggerBox,  // photodiode, trigger box on USB, one pulse a bracket
  kCameraLine,  // the photodiode on the camera's line; each bracket is a flip of its own
  kSoftware     // no photodiode: the host triggers, a measured time after the flip
};

// When the next picture is shown.
enum class Pace {
  kHandshake,  // when the last exposure of this one has ended
  kPaced       // a fixed number of refreshes after this one
};

struct SequenceSettings {
  SyncMode sync = SyncMode::kTriggerBox;
  Pace pace = Pace::kHandshake;
  std::vector<std::chrono::microseconds> exposures;  // brackets, shortest first, 1 to 8
  // From the end of an exposure until the camera takes the next trigger.
  std::chrono::microseconds readout{5000};
  std::chrono::milliseconds edge_deadline{500};    // from show() to the photodiode's edge
  std::chrono::milliseconds frame_deadline{1000};  // from the end of a pulse to its frame
  int retake_limit = 3;                            // per pattern; then the capture fails
  // For a lost device to come back during a capture; 0: the capture fails at once.
  std::chrono::milliseconds reopen_deadline{30'000};
  bool is_shuffled = false;  // order of the stripe shifts (estimation.md section 4)
  // The first pattern is shown again after every so many, and at the end, to see whether subject
  // and light have stayed as they were; 0: never. 22 costs 4 showings of the paper's 88.
  int repeat_every = 22;
};

struct StorageSettings {
  std::filesystem::path directory = "sessions";  // relative to the working directory
};

struct DaemonSettings {
  int port = 8640;
};

struct RigFile {
  std::filesystem::path path;  // as given
  std::string name;
  CameraSettings camera;
  SensorSettings sensor;
  ProjectorSettings projector;
  TriggerSettings trigger;
  SequenceSettings sequence;
  StorageSettings storage;
  DaemonSettings daemon;
  std::filesystem::path calibration_file;  // resolved against the rig file's folder; empty: none
};

// Everything wrong with the file at once: one Error (kConfiguration) whose detail has a line per
// fault, "FILE:LINE: ...". Thread-safe.
Result<RigFile> read_rig_file(const std::filesystem::path& path);

// The same from memory; `path` is for messages and relative names.
Result<RigFile> parse_rig_file(std::string_view toml, const std::filesystem::path& path);

}  // namespace rig
