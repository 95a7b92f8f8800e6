// Session folders of simulated targets: frames as files, as a capture would leave them.
#pragma once

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "estimation/session/frame_io.h"
#include "estimation/session/manifest.h"
#include "tests/estimation/calibration/rendered_board.h"

namespace capture::testing {

inline constexpr double kBlackDn = 64, kSaturationDn = 4000;
inline constexpr double kGain = 4.88, kReadNoise = 10;

struct SessionFrame {
  estimation::PatternKind kind;
  double exposure_us = 0;
  estimation::Image<float> signal_dn;  // above black
  bool is_dark_frame = false;          // of manifest.camera.dark_frames
};

inline estimation::Image<std::uint16_t> digitised(const estimation::Image<float>& signal_dn) {
  estimation::Image<std::uint16_t> dn(signal_dn.height_px(), signal_dn.width_px());
  for (std::size_t i = 0; i < dn.samples().size(); ++i)
    dn.samples()[i] = static_cast<std::uint16_t>(
        std::clamp(std::lround(kBlackDn + static_cast<double>(signal_dn.samples()[i])), 0L, 4095L));
  return dn;
}

// Equal kinds become one pattern with several frames.
inline void write_session(const std::filesystem::path& folder,
                          const estimation::testing::SyntheticRig& rig,
                          const std::vector<SessionFrame>& frames) {
  std::filesystem::create_directories(folder / "frames");
  estimation::Manifest manifest;
  manifest.id = folder.filename().string();
  manifest.created = "2026-01-31T14:25:01Z";
  manifest.camera = rig.camera;
  manifest.camera.pixel_format.bit_depth = 12;
  manifest.camera.black_level_dn = kBlackDn;
  manifest.camera.saturation_level_dn = kSaturationDn;
  manifest.camera.gain_e_per_dn = kGain;
  manifest.camera.read_noise_e = kReadNoise;
  manifest.projector = rig.projector;
  manifest.calibration = rig.calibration;
  for (const SessionFrame& frame : frames) {
    const std::string file = "frames/" + std::to_string(manifest.frames.size()) + "_" +
                             std::to_string(manifest.camera.dark_frames.size()) + ".tiff";
    const auto tiff = estimation::encode_frame_tiff(digitised(frame.signal_dn).view(), 12);
    std::ofstream(folder / file, std::ios::binary)
        .write(reinterpret_cast<const char*>(tiff->data()),
               static_cast<std::streamsize>(tiff->size()));
    if (frame.is_dark_frame) {
      manifest.camera.dark_frames.push_back({frame.exposure_us, file});
      continue;
    }
    const auto same = std::ranges::find_if(
        manifest.patterns, [&](const auto& pattern) { return pattern.kind == frame.kind; });
    int index = static_cast<int>(same - manifest.patterns.begin());
    if (same == manifest.patterns.end()) manifest.patterns.push_back({index, frame.kind});
    estimation::FrameRecord record;
    record.pattern = index;
    record.exposure_us = frame.exposure_us;
    record.file = file;
    manifest.frames.push_back(record);
  }
  std::ofstream(folder / "session.json") << estimation::format_manifest(manifest);
}

// A plane whose light falls by cosine and distance, rendered as an albedo on the board's plane.
inline estimation::testing::Albedo lit_by_projector(const estimation::testing::SyntheticRig& rig,
                                                    const estimation::testing::RigidPlace& place,
                                                    double reflectance) {
  const estimation::Vec3 centre =
      -(rig.calibration.projector_from_camera.t() * rig.calibration.projector_from_camera_mm);
  const estimation::Vec3 normal(-place.rotation(0, 2), -place.rotation(1, 2),
                                -place.rotation(2, 2));
  return [=](double x_mm, double y_mm) {
    const estimation::Vec3 point =
        place.rotation * estimation::Vec3(x_mm, y_mm, 0) + place.translation_mm;
    const estimation::Vec3 to = centre - point;
    const double distance = cv::norm(to);
    return reflectance * normal.dot(to) / distance * std::pow(1000 / distance, 2);
  };
}

// A flat target with that reflectance, under these patterns, at one exposure; noise of the sensor.
inline std::vector<SessionFrame> expose_target(const estimation::testing::SyntheticRig& rig,
                                               const estimation::testing::RigidPlace& place,
                                               const estimation::testing::Albedo& albedo,
                                               const std::vector<estimation::PatternKind>& kinds,
                                               estimation::testing::RenderSettings settings,
                                               double exposure_us) {
  // The renderer's noise, in DN.
  settings.shot = 1 / kGain;
  settings.read_sd = kReadNoise / kGain;
  estimation::testing::RenderedPose pose(rig, place, albedo, settings);
  std::vector<SessionFrame> frames;
  for (const estimation::PatternKind& kind : kinds)
    frames.push_back({kind, exposure_us, pose.frame(kind), false});
  return frames;
}

}  // namespace capture::testing
