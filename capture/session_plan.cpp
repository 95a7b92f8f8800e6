#include "capture/session_plan.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <system_error>
#include <utility>

#include "estimation/calibration/calibration_file.h"
#include "estimation/session/file_reading.h"

namespace capture {
namespace {

using estimation::InputError;
using estimation::InputFault;
using estimation::Manifest;
using estimation::Result;

struct CalibrationFile {
  estimation::Calibration calibration;
  std::string extra_keys;  // when and from what it was made; the session carries it along
};

Result<CalibrationFile> read_calibration(const rig::RigFile& rig_file) {
  const std::string name = rig_file.calibration_file.string();
  if (name.empty())
    return tl::unexpected(InputError{InputFault::kInvalid, rig_file.path.string(), "calibration",
                                     "no calibration file; name one under [calibration] file"});
  const auto json = estimation::read_text(rig_file.calibration_file);
  if (!json)
    return tl::unexpected(InputError{json.error().fault, name, "",
                                     "the calibration cannot be read (" + json.error().expectation +
                                         "); correct [calibration] file in the rig file"});
  auto calibration = estimation::parse_calibration(*json, name);
  if (!calibration) return tl::unexpected(calibration.error());
  return CalibrationFile{std::move(*calibration), estimation::extra_calibration_keys(*json)};
}

estimation::SyncSquare place(const rig::ProjectorSettings& projector) {
  const rig::SyncSquareSettings& square = projector.sync_square;
  const bool is_right =
      square.corner == rig::Corner::kTopRight || square.corner == rig::Corner::kBottomRight;
  const bool is_bottom =
      square.corner == rig::Corner::kBottomLeft || square.corner == rig::Corner::kBottomRight;
  return {is_right ? projector.width_px - square.size_px : 0,
          is_bottom ? projector.height_px - square.size_px : 0, square.size_px, square.size_px};
}

Result<estimation::CameraInfo> describe_camera(const rig::RigFile& rig_file) {
  const auto format = estimation::parse_pixel_format(rig_file.camera.pixel_format);
  if (!format)
    return tl::unexpected(InputError{
        InputFault::kInvalid, rig_file.path.string(), "camera.pixel_format",
        "\"" + rig_file.camera.pixel_format + "\" is no format that a session can hold"});
  estimation::CameraInfo camera;
  camera.width_px = rig_file.camera.width_px;
  camera.height_px = rig_file.camera.height_px;
  camera.roi_x_px = rig_file.camera.offset_x_px;
  camera.roi_y_px = rig_file.camera.offset_y_px;
  camera.pixel_format = *format;
  camera.black_level_dn = rig_file.sensor.black_level_dn;
  camera.saturation_level_dn = rig_file.sensor.saturation_level_dn;
  camera.gain_e_per_dn = rig_file.sensor.gain_e_per_dn;
  camera.read_noise_e = rig_file.sensor.read_noise_e;
  return camera;
}

std::string frame_file(SlotId slot) {
  char name[64];
  std::snprintf(name, sizeof name, "frames/pattern_%03d_bracket_%d.tiff", slot.pattern,
                slot.bracket);
  return name;
}

std::vector<estimation::FrameRecord> plan_frames(const Plan& plan) {
  std::vector<estimation::FrameRecord> frames;
  for (int pattern = 0; pattern < static_cast<int>(plan.patterns.size()); ++pattern) {
    for (int bracket = 0; bracket < static_cast<int>(plan.exposures.size()); ++bracket) {
      estimation::FrameRecord frame;
      frame.pattern = pattern;
      frame.exposure_us =
          static_cast<double>(plan.exposures[static_cast<std::size_t>(bracket)].count());
      frame.file = frame_file({pattern, bracket});
      frames.push_back(std::move(frame));
    }
  }
  return frames;
}

}  // namespace

Result<Manifest> plan_manifest(const rig::RigFile& rig_file, const Plan& plan,
                               const SessionInfo& info) {
  auto calibration = read_calibration(rig_file);
  if (!calibration) return tl::unexpected(calibration.error());
  auto camera = describe_camera(rig_file);
  if (!camera) return tl::unexpected(camera.error());
  Manifest manifest;
  manifest.id = folder_name(info);
  manifest.created = estimation::date_text(info.created);
  manifest.subject = info.subject;
  manifest.software = "ssrig";
  manifest.plan = plan.name;
  manifest.state = estimation::SessionState::kCapturing;
  manifest.camera = std::move(*camera);
  manifest.projector = {rig_file.projector.width_px, rig_file.projector.height_px,
                        place(rig_file.projector)};
  manifest.calibration = std::move(calibration->calibration);
  manifest.other_keys = std::move(calibration->extra_keys);
  manifest.patterns = plan.patterns;
  manifest.frames = plan_frames(plan);
  return manifest;
}

std::vector<std::string*> auxiliary_files(estimation::Calibration& calibration) {
  std::vector<std::string*> files;
  if (calibration.irradiance && calibration.irradiance->vignetting_file)
    files.push_back(&*calibration.irradiance->vignetting_file);
  if (calibration.stripe_transfer)
    if (auto* transfer = std::get_if<estimation::TransferFile>(&*calibration.stripe_transfer))
      files.push_back(&transfer->file);
  return files;
}

std::string folder_name(const SessionInfo& info) {
  std::string name = estimation::date_stamp(info.created);
  std::string subject;
  for (const char c : info.subject) {
    const bool is_plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                          (c >= '0' && c <= '9') || c == '-' || c == '_';
    subject += is_plain ? c : '_';
  }
  constexpr std::size_t kSubjectLimit = 64;  // a file name has at most 255 bytes
  if (!subject.empty()) name.append("-").append(subject, 0, kSubjectLimit);
  return name;
}

std::uintmax_t needed_bytes(const Manifest& manifest) {
  const auto pixel_count = static_cast<std::uintmax_t>(manifest.camera.width_px) *
                           static_cast<std::uintmax_t>(manifest.camera.height_px);
  const auto channel_count = static_cast<std::uintmax_t>(
      estimation::sample_channel_count(manifest.camera.pixel_format.filter));
  const std::uintmax_t sample_bytes = manifest.camera.pixel_format.bit_depth == 8 ? 1 : 2;
  constexpr std::uintmax_t kTiffOverheadBytes = 4096;
  // 5 maps of 3 bands, 3 + 3 + 2 of geometry, 3 of validity, 18 of uncertainty: 32-bit floats
  // before compression; and the report.
  constexpr std::uintmax_t kMapBytesPerPixel = 4 * std::uintmax_t{15 + 8 + 3 + 18};
  constexpr std::uintmax_t kReportBytes = 16'000'000;
  return manifest.frames.size() *
             (pixel_count * channel_count * sample_bytes + kTiffOverheadBytes) +
         pixel_count * kMapBytesPerPixel + kReportBytes;
}

Result<void> check_storage(const std::filesystem::path& directory, std::uintmax_t byte_count) {
  const auto unwritable = [&directory](const std::string& expectation) {
    return tl::unexpected(InputError{InputFault::kUnwritable, directory.string(), "", expectation});
  };
  std::error_code error;
  std::filesystem::create_directories(directory, error);
  if (error)
    return unwritable("the folder cannot be made (" + error.message() + "); choose another");
  if (::access(directory.c_str(), W_OK | X_OK) != 0)
    return unwritable("the folder cannot be written to; change its permissions or choose another");
  const auto space = std::filesystem::space(directory, error);
  if (error) return unwritable("its free space is unknown: " + error.message());
  if (space.available < byte_count) {
    constexpr std::uintmax_t kMegabyte = 1'000'000;
    return unwritable("a capture needs " + std::to_string(byte_count / kMegabyte) + " MB and " +
                      std::to_string(space.available / kMegabyte) +
                      " MB are free; make room or choose another folder");
  }
  return {};
}

}  // namespace capture
