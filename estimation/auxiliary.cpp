#include "estimation/auxiliary.h"

#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "estimation/session/frame_io.h"
#include "estimation/session/maps.h"

namespace estimation {

namespace {

Result<std::map<std::string, Image<float>>> read_channels(const std::filesystem::path& session,
                                                          const std::string& name,
                                                          const std::string& place) {
  const auto path = resolve_in_session(session, name, place);
  if (!path) return tl::unexpected(path.error());
  auto channels = read_exr(*path);
  if (!channels) return tl::unexpected(named_by(place, channels.error()));
  return channels;
}

// A single-channel EXR of a required size; an empty image if no file is named.
Result<Image<float>> read_single(const std::filesystem::path& session,
                                 const std::optional<std::string>& name, const std::string& place,
                                 int height_px, int width_px) {
  if (!name) return Image<float>();
  auto channels = read_channels(session, *name, place);
  if (!channels) return tl::unexpected(channels.error());
  const auto wrong = [&](const std::string& expectation) {
    return tl::unexpected(
        InputError{InputFault::kInvalid, (session / *name).string(), place, expectation});
  };
  if (channels->size() != 1)
    return wrong("has " + std::to_string(channels->size()) + " channels; expected one");
  Image<float>& image = channels->begin()->second;
  if (image.height_px() != height_px || image.width_px() != width_px)
    return wrong("is " + std::to_string(image.width_px()) + " x " +
                 std::to_string(image.height_px()) + " px; expected " + std::to_string(width_px) +
                 " x " + std::to_string(height_px));
  return std::move(image);
}

// Dark frames know each pixel and exposure: where there are any, one level for all is not asked.
Result<CameraBlack> read_black(const Manifest& manifest, const std::filesystem::path& session) {
  if (manifest.camera.dark_frames.empty())  // geometry needs no black
    return CameraBlack(manifest.camera.black_level_dn.value_or(0));
  std::vector<CameraBlack::Dark> darks;
  for (const DarkFrame& dark : manifest.camera.dark_frames) {
    auto frame = read_frame(session, manifest, dark.file);
    if (!frame)
      return tl::unexpected(
          named_by("/camera/dark_frames/" + std::to_string(darks.size()) + "/file", frame.error()));
    darks.push_back({dark.exposure_us, std::move(*frame)});
  }
  return CameraBlack(std::move(darks));
}

// Where a flat field has no response to divide by, NaN: those pixels lose all their samples. How
// many.
std::size_t mark_damaged(Image<float>& flat_field) {
  std::size_t count = 0;
  for (float& response : flat_field.samples()) {
    if (response > 0 && std::isfinite(response)) continue;
    response = std::numeric_limits<float>::quiet_NaN();
    ++count;
  }
  return count;
}

Result<HarmonicTransfer> read_transfer(const Manifest& manifest,
                                       const std::filesystem::path& session) {
  const std::optional<StripeTransfer>& calibrated = manifest.calibration.stripe_transfer;
  const auto* file = calibrated ? std::get_if<TransferFile>(&*calibrated) : nullptr;
  if (file == nullptr) return HarmonicTransfer::create(calibrated, {}, manifest.camera);
  const auto channels = read_channels(session, file->file, "/calibration/stripe_transfer");
  if (!channels) return tl::unexpected(channels.error());
  auto transfer = HarmonicTransfer::create(calibrated, *channels, manifest.camera);
  if (!transfer) transfer.error().file = (session / file->file).string();
  return transfer;
}

}  // namespace

InputError named_by(const std::string& key, InputError error) {
  error.place = error.place.empty() ? key : key + ", " + error.place;
  return error;
}

Result<Auxiliary> read_auxiliary(const Manifest& manifest, const std::filesystem::path& session) {
  const CameraInfo& camera = manifest.camera;
  const Calibration& calibration = manifest.calibration;
  auto black = read_black(manifest, session);
  if (!black) return tl::unexpected(black.error());
  auto flat_field = read_single(session, camera.flat_field_file, "/camera/flat_field",
                                camera.height_px, camera.width_px);
  if (!flat_field) return tl::unexpected(flat_field.error());
  auto vignetting = read_single(
      session, calibration.irradiance ? calibration.irradiance->vignetting_file : std::nullopt,
      "/calibration/irradiance/vignetting", manifest.projector.height_px,
      manifest.projector.width_px);
  if (!vignetting) return tl::unexpected(vignetting.error());
  auto transfer = read_transfer(manifest, session);
  if (!transfer) return tl::unexpected(transfer.error());
  std::vector<std::string> notes;
  if (const std::size_t count = mark_damaged(*flat_field); count > 0)
    notes.push_back("camera.flat_field is not above 0 at " + std::to_string(count) +
                    " pixels: taken as damaged, their samples are lost (validity 2)");
  return Auxiliary{.black = std::move(*black),
                   .flat_field = std::move(*flat_field),
                   .vignetting = std::move(*vignetting),
                   .transfer = std::move(*transfer),
                   .notes = std::move(notes)};
}

}  // namespace estimation
