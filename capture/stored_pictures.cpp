#include "capture/stored_pictures.h"

#include <algorithm>
#include <numeric>
#include <set>

#include "estimation/motion/picture_samples.h"
#include "estimation/session/frame_io.h"

namespace capture {
namespace {

using estimation::FrameRecord;
using estimation::Result;

// Seconds of the best clock that stamped all frames.
std::vector<double> times_of(const std::vector<FrameRecord>& frames) {
  const auto all = [&frames](auto member) {
    return std::all_of(frames.begin(), frames.end(),
                       [member](const FrameRecord& frame) { return (frame.*member).has_value(); });
  };
  std::vector<double> times_s;
  const bool has_edges = all(&FrameRecord::edge_timestamp_ns);
  const bool has_stamps = all(&FrameRecord::camera_timestamp_ns);
  for (const FrameRecord& frame : frames) {
    constexpr double kNsPerS = 1e9;
    if (has_edges)
      times_s.push_back(static_cast<double>(*frame.edge_timestamp_ns) / kNsPerS);
    else if (has_stamps)
      times_s.push_back(static_cast<double>(*frame.camera_timestamp_ns) / kNsPerS);
    else
      times_s.push_back(static_cast<double>(times_s.size()));
  }
  return times_s;
}

// Dark frames know the black better than the level that the camera is said to have.
Result<estimation::CameraInfo> camera_with_black(const std::filesystem::path& session,
                                                 const estimation::Manifest& manifest) {
  estimation::CameraInfo camera = manifest.camera;
  if (camera.dark_frames.empty()) return camera;
  const auto dark = estimation::read_frame(session, manifest, camera.dark_frames.front().file);
  if (!dark) return tl::unexpected(dark.error());
  const auto samples = dark->samples();
  camera.black_level_dn =
      std::reduce(samples.begin(), samples.end(), 0.0) / static_cast<double>(samples.size());
  return camera;
}

}  // namespace

Result<std::vector<estimation::SeenPicture>> read_pictures(const std::filesystem::path& session,
                                                           const estimation::Manifest& manifest,
                                                           const std::vector<FrameRecord>& frames) {
  const estimation::PictureSampler sampler(manifest.camera);
  std::set<double> exposures_us;
  for (const FrameRecord& frame : manifest.frames) exposures_us.insert(frame.exposure_us);
  for (const FrameRecord& frame : frames) exposures_us.insert(frame.exposure_us);
  const std::vector<double> times_s = times_of(frames);
  std::vector<estimation::SeenPicture> pictures;
  for (const FrameRecord& frame : frames) {
    const auto dn = estimation::read_frame(session, manifest, frame.file);
    if (!dn) return tl::unexpected(dn.error());
    const auto bracket = std::distance(exposures_us.begin(), exposures_us.find(frame.exposure_us));
    pictures.push_back({frame.pattern, static_cast<int>(bracket), times_s[pictures.size()], true,
                        sampler.take(dn->view())});
  }
  return pictures;
}

Result<estimation::PictureCheck> check_stored_pictures(const std::filesystem::path& session) {
  const auto manifest = estimation::read_manifest(session);
  if (!manifest) return tl::unexpected(manifest.error());
  const auto camera = camera_with_black(session, *manifest);
  if (!camera) return tl::unexpected(camera.error());
  const auto pictures = read_pictures(session, *manifest, manifest->frames);
  if (!pictures) return tl::unexpected(pictures.error());
  return check_pictures(*camera, manifest->patterns, *pictures);
}

std::string name_patterns(const estimation::PictureCheck& check) {
  std::set<int> patterns;
  for (const estimation::WrongPicture& wrong : check.wrong) patterns.insert(wrong.pattern);
  std::string text = patterns.size() == 1 ? "pattern " : "patterns ";
  std::size_t named = 0;
  for (const int pattern : patterns) {
    if (named > 0) text += named + 1 == patterns.size() ? " and " : ", ";
    text += std::to_string(pattern);
    ++named;
  }
  return text;
}

}  // namespace capture
