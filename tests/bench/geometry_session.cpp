#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <limits>
#include <utility>

#include "estimation/radiometry/merge.h"
#include "estimation/session/frame_io.h"
#include "tests/bench/geometry_bench.h"

namespace bench {
namespace {

using estimation::Image;
using estimation::Manifest;
using estimation::Result;
namespace fs = std::filesystem;

constexpr float kCosine60 = 0.5F;

Result<GeometryTruth> read_truth(const fs::path& folder) {
  auto maps = estimation::read_maps(folder);
  if (!maps) return tl::unexpected(maps.error());
  auto scene = estimation::read_exr(folder / "scene.exr");
  if (!scene) return tl::unexpected(scene.error());
  GeometryTruth truth{std::move(*maps), std::move(scene->at("border_distance_mm")), {}};
  truth.is_judged = Image<unsigned char>(truth.maps.height_px, truth.maps.width_px);
  for (int row = 0; row < truth.maps.height_px; ++row)
    for (int col = 0; col < truth.maps.width_px; ++col) {
      const auto of = [&](const char* name) { return scene->at(name).at(row, col); };
      truth.is_judged.at(row, col) = of("region") != 0 && of("lit") != 0 &&
                                     of("cos_projector") >= kCosine60 &&
                                     of("cos_camera") >= kCosine60;
    }
  return truth;
}

}  // namespace

Result<GeometrySession> read_geometry_session(const fs::path& folder) {
  GeometrySession session;
  session.folder = folder;
  session.name = folder.parent_path().filename().string();
  auto manifest = estimation::read_manifest(folder);
  if (!manifest) return tl::unexpected(manifest.error());
  session.manifest = std::move(*manifest);
  auto truth = read_truth(folder / "truth");
  if (!truth) return tl::unexpected(truth.error());
  session.truth = std::move(*truth);
  for (const estimation::FrameRecord& record : session.manifest.frames) {
    auto frame = estimation::read_frame(folder, session.manifest, record.file);
    if (!frame) return tl::unexpected(frame.error());
    session.frames.push_back(std::move(*frame));
  }
  return session;
}

PatternFrames frames_by_pattern(
    const GeometrySession& session,
    const std::function<bool(const estimation::PatternKind&, double exposure_us)>& is_used) {
  const Manifest& manifest = session.manifest;
  const double black_dn = manifest.camera.black_level_dn.value_or(0);
  PatternFrames found;
  found.black = estimation::CameraBlack(black_dn);
  found.options.levels.saturation_dn = manifest.camera.saturation_level_dn.value_or(
      (1 << manifest.camera.pixel_format.bit_depth) - 1);
  std::vector<double> exposures_us;
  for (const estimation::Pattern& pattern : manifest.patterns) {
    std::vector<estimation::ExposedFrame> frames;
    for (std::size_t i = 0; i < manifest.frames.size(); ++i) {
      const estimation::FrameRecord& record = manifest.frames[i];
      if (record.pattern == pattern.index && is_used(pattern.kind, record.exposure_us))
        frames.push_back({record.exposure_us, session.frames[i].view()});
    }
    if (frames.empty()) continue;
    exposures_us.clear();
    for (const auto& frame : frames) exposures_us.push_back(frame.exposure_us);
    found.kinds.push_back(&pattern.kind);
    found.frames.push_back(std::move(frames));
  }
  std::sort(exposures_us.begin(), exposures_us.end());
  found.options.noise = estimation::merged_noise(
      exposures_us,
      {manifest.camera.gain_e_per_dn.value_or(5), manifest.camera.read_noise_e.value_or(10)},
      found.options.levels.saturation_dn - black_dn);
  return found;
}

std::vector<estimation::PatternSignal> PatternFrames::views() const {
  std::vector<estimation::PatternSignal> signals;
  for (std::size_t i = 0; i < frames.size(); ++i) signals.push_back({kinds[i], {}, frames[i]});
  return signals;
}

estimation::CorrespondenceOptions PatternFrames::correspondence_options() const {
  estimation::CorrespondenceOptions used = options;
  used.levels.black = &black;
  return used;
}

GeometrySignals merge_signals(const GeometrySession& session) {
  const PatternFrames by_pattern =
      frames_by_pattern(session, [](const auto&, double) { return true; });
  GeometrySignals signals;
  signals.kinds = by_pattern.kinds;
  signals.options = by_pattern.options;
  for (const auto& frames : by_pattern.frames)
    signals.images.push_back(estimation::merge_brackets(
        frames, by_pattern.black, by_pattern.options.levels.saturation_dn, {}));
  return signals;
}

std::vector<estimation::PatternSignal> GeometrySignals::views() const {
  std::vector<estimation::PatternSignal> signals;
  for (std::size_t i = 0; i < images.size(); ++i) signals.push_back({kinds[i], images[i].view()});
  return signals;
}

double least_ms(int repeats, const std::function<void()>& work) {
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < repeats; ++i) {
    const auto begin = std::chrono::steady_clock::now();
    work();
    const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - begin;
    least = std::min(least, took.count());
  }
  return least;
}

}  // namespace bench
