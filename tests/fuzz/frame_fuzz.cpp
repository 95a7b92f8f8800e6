// A frame's TIFF or PNG. The camera is what the file says it holds as long as that is small, so
// that the decoders are reached.
#include "estimation/session/frame_decode.h"
#include "estimation/session/image_file.h"
#include "tests/fuzz/fuzz_target.h"

namespace {

estimation::CameraInfo camera_for(const std::vector<std::byte>& bytes) {
  estimation::CameraInfo camera;
  camera.width_px = 6;
  camera.height_px = 4;
  const auto header = estimation::probe_image(bytes, "frame");
  if (!header || header->width_px * header->height_px > 4096) return camera;
  camera.width_px = static_cast<int>(header->width_px);
  camera.height_px = static_cast<int>(header->height_px);
  camera.pixel_format = {
      header->channel_count == 3 ? estimation::ColorFilter::kRgb : estimation::ColorFilter::kMono,
      header->bit_depth};
  return camera;
}

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto* first = reinterpret_cast<const std::byte*>(data);
  const std::vector<std::byte> bytes(first, first + size);
  const estimation::CameraInfo camera = camera_for(bytes);
  const auto frame = estimation::decode_frame(bytes, camera, "frames/1.tiff");
  if (!frame) {
    fuzz::require_message(frame.error().text(), "frames/1.tiff");
    return 0;
  }
  estimation::check(frame->width_px() == camera.width_px && frame->height_px() == camera.height_px,
                    "a frame is as large as its camera says");
  return 0;
}
