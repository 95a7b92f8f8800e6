// session.json: what was captured, with which rig, under which patterns. The public contract is
// design/session_format.md; this header is that page as types.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "estimation/base/linear.h"
#include "estimation/session/error.h"
#include "estimation/session/pattern.h"

namespace estimation {

enum class ColorFilter { kMono, kBayerRG, kBayerGR, kBayerGB, kBayerBG, kRgb };

struct PixelFormat {
  ColorFilter filter = ColorFilter::kMono;
  int bit_depth = 8;  // 8, 12 or 16; values are right-aligned
  bool operator==(const PixelFormat&) const = default;
};

// PFNC names: "Mono8", "BayerRG12", "RGB16", ...; nullopt if the name is none of the contract's.
std::optional<PixelFormat> parse_pixel_format(std::string_view name);
std::string to_string(PixelFormat format);

inline int band_count(ColorFilter filter) { return filter == ColorFilter::kMono ? 1 : 3; }
inline int sample_channel_count(ColorFilter filter) { return filter == ColorFilter::kRgb ? 3 : 1; }

struct DarkFrame {
  double exposure_us = 0;
  std::string file;
};

struct CameraInfo {
  int width_px = 0;  // of the frames and of the maps
  int height_px = 0;
  int roi_x_px = 0;  // where the frames' top-left pixel lies on the sensor
  int roi_y_px = 0;
  PixelFormat pixel_format;
  std::optional<double> black_level_dn;
  std::vector<DarkFrame> dark_frames;
  std::optional<double> saturation_level_dn;  // from which a sample counts as clipped
  std::optional<double> gain_e_per_dn;
  std::optional<double> read_noise_e;
  std::optional<std::string> flat_field_file;
};

// Band (0 R, 1 G, 2 B; mono 0) seen by the sample at (row, col) of a frame; the Bayer phase refers
// to the sensor's pixel (0, 0). For RGB frames every pixel sees all bands: returns `channel`.
int band_at(const CameraInfo& camera, int row, int col, int channel = 0);

struct SyncSquare {
  int x_px = 0, y_px = 0, width_px = 0, height_px = 0;
  bool contains(int row, int col) const {
    return col >= x_px && col < x_px + width_px && row >= y_px && row < y_px + height_px;
  }
};

struct ProjectorInfo {
  int width_px = 0;
  int height_px = 0;
  std::optional<SyncSquare> sync_square;
};

// OpenCV's pinhole with [k1, k2, p1, p2, k3]; pixel centres at integers; K in px of the sensor.
struct Lens {
  Mat3 K = Mat3::eye();
  std::array<double, 5> distortion{};
};

struct Irradiance {
  std::vector<double> signal_per_us;  // [band] DN/us, see session_format.md
  std::optional<double> reference_distance_mm;
  std::optional<std::string> vignetting_file;
};

// Transfer of n cycles per 40 projector px, n = 1, 2, ...
struct TransferByBand {
  std::array<std::vector<double>, 3> harmonics;  // [band][n - 1]; mono: the first
};
struct TransferByDepth {
  struct Entry {
    double distance_mm = 0;
    TransferByBand transfer;
  };
  std::vector<Entry> entries;  // at least one, increasing distance
};
struct TransferFile {
  std::string file;  // EXR on the camera grid, channels R.1 R.2 ...
};
using StripeTransfer = std::variant<TransferByBand, TransferByDepth, TransferFile>;

struct Calibration {
  Lens camera;
  Lens projector;
  Mat3 projector_from_camera = Mat3::eye();  // R: X_p = R X_c + t
  Vec3 projector_from_camera_mm{0, 0, 0};    // t
  std::optional<Irradiance> irradiance;
  std::vector<double> projector_black_dn_per_us;  // [band]; empty means 0
  std::optional<StripeTransfer> stripe_transfer;
  std::optional<Mat3> color_matrix;  // camera rgb to display rgb; never applied to frames
};

enum class SessionState { kCapturing, kComplete, kFailed, kInterrupted, kAborted };
std::string to_string(SessionState state);

struct SessionFailure {
  std::string code;
  std::vector<std::string> slots;  // "pattern 17 bracket 1", ...
  std::string text;
};

struct FrameRecord {
  int pattern = 0;  // Pattern::index
  double exposure_us = 0;
  std::string file;  // relative to the session folder
  std::optional<std::uint64_t> frame_id;
  std::optional<std::int64_t> camera_timestamp_ns;
  std::optional<std::int64_t> edge_timestamp_ns;
  std::optional<std::string> sha256;  // lower-case hex
};

struct Manifest {
  std::string id;
  std::string created;  // RFC 3339 UTC
  std::string subject, notes, software, plan;
  SessionState state = SessionState::kComplete;
  std::optional<SessionFailure> failure;
  CameraInfo camera;
  ProjectorInfo projector;
  Calibration calibration;
  std::vector<Pattern> patterns;
  std::vector<FrameRecord> frames;
  std::string other_keys;  // unknown keys as a JSON object, kept when the manifest is written again

  const Pattern* find_pattern(int index) const;  // nullptr if there is none
};

// Reads and checks SESSION/session.json; every error names the file, the JSON pointer and what was
// expected. Frame files are looked at by read_frame and verify_session, not here. Thread-safe.
Result<Manifest> read_manifest(const std::filesystem::path& session);

// The same from memory; `file` is the name for messages.
Result<Manifest> parse_manifest(std::string_view json, const std::string& file);

// The manifest as JSON text, required keys first, other_keys kept.
std::string format_manifest(const Manifest& manifest);

// The object under "calibration", alone in a file: what a rig file points to.
// Keys beside it that belong to `camera` (black_level, saturation_level, gain_e_per_dn,
// read_noise_e) are not here.
Result<Calibration> parse_calibration(std::string_view json, const std::string& file);

// SESSION/`name` for a relative name without ".." that stays inside after links are resolved; else
// an error.
Result<std::filesystem::path> resolve_in_session(const std::filesystem::path& session,
                                                 const std::string& name, const std::string& place);

}  // namespace estimation
