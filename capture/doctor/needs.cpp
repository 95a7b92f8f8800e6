#include "capture/doctor/needs.h"

#include "capture/plan.h"
#include "capture/session_plan.h"

namespace capture {

rig::Result<CaptureNeeds> needs_of(const rig::RigFile& rig_file) {
  const auto plan = make_plan("paper", rig_file.projector, rig_file.sequence);
  if (!plan) return tl::unexpected(plan.error());
  const auto format = estimation::parse_pixel_format(rig_file.camera.pixel_format);
  if (!format)
    return rig::failure(rig::Fault::kConfiguration,
                        rig_file.path.string() + ": camera.pixel_format \"" +
                            rig_file.camera.pixel_format + "\" is none that a session can hold");
  estimation::Manifest manifest;
  manifest.camera.width_px = rig_file.camera.width_px;
  manifest.camera.height_px = rig_file.camera.height_px;
  manifest.camera.pixel_format = *format;
  manifest.frames.resize(static_cast<std::size_t>(plan->slot_count()));
  const auto area_px = static_cast<std::uint64_t>(rig_file.camera.width_px) *
                       static_cast<std::uint64_t>(rig_file.camera.height_px);
  const int channel_count = estimation::sample_channel_count(format->filter);
  return CaptureNeeds{.frame_count = plan->slot_count(),
                      .frame_bytes = area_px * static_cast<std::uint64_t>(channel_count) *
                                     (format->bit_depth == 8 ? 1U : 2U),
                      .storage_bytes = needed_bytes(manifest)};
}

std::vector<std::string> host_warnings(const rig::RigFile& rig_file, const HostPlaces& places) {
  const auto needs = needs_of(rig_file);
  if (!needs) return {};
  const HostFacts host = read_host(rig_file, places);
  std::vector<std::string> warnings;
  for (const HostFinding& finding :
       {check_receive_buffer(host, *needs), check_camera_interface(host, rig_file.camera)})
    if (finding.health == Health::kWarning)
      warnings.push_back(finding.text + "; to put it right: " + finding.remedy);
  return warnings;
}

}  // namespace capture
