// `ssrig-bench geometry`: what correspondence and geometry achieve, on sessions whose truth is
// known.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/geometry/correspondence.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"
#include "tests/bench/report.h"

namespace bench {

struct GeometryOptions {
  std::filesystem::path out = {};  // folder for pictures
  std::vector<std::filesystem::path> sessions =
      {};                              // as ssrig-sim run leaves them: truth beside maps
  std::vector<std::string> only = {};  // sections; empty: all
  int thread_count = 1;
  int repeats = 3;  // of what is timed; the least counts
};

// What the simulator knows of a session's pixels.
struct GeometryTruth {
  estimation::Maps maps;
  estimation::Image<float> border_distance_mm;
  estimation::Image<unsigned char> is_judged;  // skin, lit, both angles below 60 degrees
};

// A session's frames in memory, and its truth. Not thread-safe.
struct GeometrySession {
  std::filesystem::path folder;
  std::string name;
  estimation::Manifest manifest;
  std::vector<estimation::Image<std::uint16_t>> frames;  // as manifest.frames
  GeometryTruth truth;
};

estimation::Result<GeometrySession> read_geometry_session(const std::filesystem::path& folder);

// The least of `repeats` runs, wall time in ms.
double least_ms(int repeats, const std::function<void()>& work);

// Errors of maps against the truth, by the distance from the nearest border of material, surface or
// light; in pictures, too.
void show_geometry_accuracy(const GeometryOptions& options, Report& report);
// Signed column errors of several maps side by side, blue -0.3 px over white to red 0.3 px; grey is
// not decoded, black not judged.
struct ColumnErrors {
  std::string title;
  const estimation::Maps* maps;
};
bool write_error_picture(const std::filesystem::path& file, const GeometryTruth& truth,
                         const std::vector<ColumnErrors>& panels);
// OpenCV's Gray-code decoder and ours on the same frames.
void show_gray_decoders(const GeometryOptions& options, Report& report);
// Time and memory of frames to surface, in bare reads of the frames.
void show_geometry_cost(const GeometryOptions& options, Report& report);

// The merged signals of a session's patterns, and what their noise is.
struct GeometrySignals {
  std::vector<estimation::Image<float>> images;
  std::vector<const estimation::PatternKind*> kinds;
  estimation::CorrespondenceOptions options;

  std::vector<estimation::PatternSignal> views() const;
};
GeometrySignals merge_signals(const GeometrySession& session);

// A session's frames by pattern, as decode_correspondence merges them on the way. Borrows the
// session's.
struct PatternFrames {
  std::vector<const estimation::PatternKind*> kinds;
  std::vector<std::vector<estimation::ExposedFrame>> frames;  // [pattern]
  estimation::CameraBlack black{0};
  estimation::CorrespondenceOptions options;  // without black, see correspondence_options

  std::vector<estimation::PatternSignal> views() const;
  estimation::CorrespondenceOptions correspondence_options() const;
};
// Of patterns and exposures that `is_used` wants.
PatternFrames frames_by_pattern(
    const GeometrySession& session,
    const std::function<bool(const estimation::PatternKind&, double exposure_us)>& is_used);

}  // namespace bench
