#include "capture/results.h"

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <string>
#include <system_error>
#include <utility>

#include "estimation/base/image.h"
#include "estimation/geometry/mesh.h"
#include "estimation/report/quicklook.h"
#include "estimation/session/frame_io.h"
#include "estimation/session/maps.h"
#include "estimation/session/ply.h"

namespace capture {
namespace {

using estimation::Image;
using estimation::Manifest;
using estimation::Result;
namespace fs = std::filesystem;

struct SampleFrame {
  std::string name, title;
  Image<std::uint16_t> dn;
};

// The first and the last of the patterns, and one between: stripes, coarse and fine code.
std::vector<int> sample_patterns(const Manifest& manifest) {
  std::vector<int> samples;
  const int count = static_cast<int>(manifest.patterns.size());
  for (const int position : {0, count / 2, count - 1}) {
    const int index = manifest.patterns[static_cast<std::size_t>(position)].index;
    if (std::find(samples.begin(), samples.end(), index) == samples.end()) samples.push_back(index);
  }
  return samples;
}

// The longest exposure of each, where there is a frame.
Result<std::vector<SampleFrame>> read_sample_frames(const fs::path& session,
                                                    const Manifest& manifest) {
  std::vector<SampleFrame> samples;
  for (const int index : sample_patterns(manifest)) {
    const estimation::FrameRecord* longest = nullptr;
    for (const auto& frame : manifest.frames)
      if (frame.pattern == index && (!longest || frame.exposure_us > longest->exposure_us))
        longest = &frame;
    if (!longest) continue;
    auto dn = estimation::read_frame(session, manifest, longest->file);
    if (!dn) return tl::unexpected(dn.error());
    char exposure[32];
    std::snprintf(exposure, sizeof exposure, ", %.1f ms", longest->exposure_us / 1000);
    samples.push_back({"frame_pattern_" + std::to_string(index),
                       estimation::describe(manifest.find_pattern(index)->kind) + exposure,
                       std::move(*dn)});
  }
  return samples;
}

// The surface's mesh beside its maps; the mesh of an earlier run goes where this one has none.
Result<void> write_mesh(const fs::path& path, const estimation::Maps& maps,
                        const Manifest& manifest) {
  const auto mesh =
      estimation::make_mesh(maps, {.color_matrix = manifest.calibration.color_matrix});
  if (!mesh.triangles.empty()) return estimation::write_ply(path, mesh);
  std::error_code not_there;
  fs::remove(path, not_there);
  return {};
}

}  // namespace

Result<std::vector<fs::path>> write_results(const estimation::SessionEstimate& estimate,
                                            const Manifest& manifest, const fs::path& session,
                                            const fs::path& maps_folder,
                                            const fs::path& report_folder) {
  if (const auto written = estimation::write_maps(maps_folder, estimate.maps); !written)
    return tl::unexpected(written.error());
  if (const auto written = write_mesh(maps_folder / "surface.ply", estimate.maps, manifest);
      !written)
    return tl::unexpected(written.error());
  if (report_folder.empty()) return std::vector<fs::path>{};
  const auto samples = read_sample_frames(session, manifest);
  if (!samples) return tl::unexpected(samples.error());
  std::vector<estimation::QuicklookFrame> frames;
  for (const SampleFrame& sample : *samples)
    frames.push_back({sample.name, sample.title, sample.dn.view()});
  return estimation::write_quicklook(report_folder, estimate.maps, manifest.camera, frames,
                                     estimate.profiles);
}

}  // namespace capture
