#include "tests/wire/rig/ledger_session.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "capture/plan.h"
#include "estimation/session/frame_io.h"
#include "estimation/session/manifest.h"
#include "hw_sim/devices/ledger_world.h"
#include "rig/rig_file.h"

namespace {

// Of every pattern, as the grabbed screen shows it: the square's place is black.
std::vector<std::uint64_t> picture_hashes(const std::filesystem::path& rig_file) {
  const auto rig = rig::read_rig_file(rig_file);
  if (!rig) return {};
  const auto plan = capture::make_plan("paper", rig->projector, rig->sequence);
  if (!plan) return {};
  std::vector<std::uint64_t> hashes;
  for (auto& picture : capture::render_pictures(*plan, rig->projector)) {
    const int size_px = rig->projector.sync_square.size_px;
    for (int row = picture.height_px() - size_px; row < picture.height_px(); ++row)
      for (int col = picture.width_px() - size_px; col < picture.width_px(); ++col)
        picture.at(row, col) = 0;
    hashes.push_back(hw_sim::content_hash(picture));
  }
  return hashes;
}

// Empty: nothing.
std::string what_is_wrong(const std::filesystem::path& session,
                          const estimation::Manifest& manifest,
                          const estimation::FrameRecord& frame,
                          const std::vector<std::uint64_t>& hashes) {
  const auto samples = estimation::read_frame(session, manifest, frame.file);
  if (!samples) return samples.error().text();
  const auto identity = hw_sim::decode_identity(samples->view());
  if (!identity) return "its identity cannot be read";
  if (std::abs(static_cast<double>(identity->exposure.count()) - frame.exposure_us) > 0.5)
    return "exposed for " + std::to_string(identity->exposure.count()) + " us";
  if (identity->light.size() != 1)
    return "lit by " + std::to_string(identity->light.size()) + " pictures";
  const auto pattern = static_cast<std::size_t>(frame.pattern);
  if (pattern >= hashes.size() || identity->light[0].content_hash != hashes[pattern])
    return "lit by another picture";
  return "";
}

}  // namespace

LedgerSession read_ledger_session(const std::filesystem::path& session,
                                  const std::filesystem::path& rig_file) {
  LedgerSession found;
  const auto manifest = estimation::read_manifest(session);
  if (!manifest) return found;
  found.state = estimation::to_string(manifest->state);
  found.frame_count = static_cast<int>(manifest->frames.size());
  const std::vector<std::uint64_t> hashes = picture_hashes(rig_file);
  for (const estimation::FrameRecord& frame : manifest->frames) {
    const std::string wrong = what_is_wrong(session, *manifest, frame, hashes);
    if (!wrong.empty()) found.wrong_frames.push_back(frame.file + ": " + wrong);
  }
  return found;
}
