#include "estimation/session/frame_io.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>
#include <span>

#include "estimation/session/file_reading.h"
#include "estimation/session/frame_decode.h"
#include "estimation/session/image_file.h"
#include "estimation/session/manifest_parts.h"

namespace estimation {
namespace {

static_assert(std::endian::native == std::endian::little, "samples are copied as they lie");

// Little-endian bytes.
class ByteWriter {
 public:
  explicit ByteWriter(std::size_t capacity) { bytes_.reserve(capacity); }
  void u8(unsigned value) { bytes_.push_back(static_cast<std::byte>(value)); }
  void u16(unsigned value) {
    u8(value & 255U);
    u8(value >> 8U & 255U);
  }
  void u32(std::uint32_t value) {
    u16(value & 65535U);
    u16(value >> 16U);
  }
  void samples(std::span<const std::uint16_t> dn) {
    const std::size_t offset = bytes_.size();
    bytes_.resize(offset + dn.size_bytes());
    std::memcpy(bytes_.data() + offset, dn.data(), dn.size_bytes());
  }
  std::vector<std::byte> take() { return std::move(bytes_); }

 private:
  std::vector<std::byte> bytes_;
};

constexpr unsigned kShort = 3;  // TIFF's 16 bit type
constexpr unsigned kLong = 4;   // and its 32 bit type

void put_tag(ByteWriter& tiff, unsigned tag, unsigned type, std::uint32_t value,
             std::uint32_t count = 1) {
  tiff.u16(tag);
  tiff.u16(type);
  tiff.u32(count);
  tiff.u32(value);  // a lone 16 bit value comes first in its 4 bytes: the same, little-endian
}

// Header, tags and the three channels' depths: a single strip of samples follows at once.
constexpr std::uint32_t kTiffTagCount = 11;
constexpr std::uint32_t kTiffDepthsOffset = 8 + 2 + kTiffTagCount * 12 + 4;
constexpr std::uint32_t kTiffSamplesOffset = kTiffDepthsOffset + 6;

void put_tiff_header(ByteWriter& tiff, ImageView<const std::uint16_t> frame, unsigned stored_bits,
                     std::uint32_t byte_count) {
  const auto channel_count = static_cast<unsigned>(frame.channel_count);
  tiff.u16(0x4949);  // "II", little-endian
  tiff.u16(42);
  tiff.u32(8);  // the tags follow at once
  tiff.u16(kTiffTagCount);
  put_tag(tiff, 256, kLong, static_cast<std::uint32_t>(frame.width_px));
  put_tag(tiff, 257, kLong, static_cast<std::uint32_t>(frame.height_px));
  put_tag(tiff, 258, kShort, channel_count == 3 ? kTiffDepthsOffset : stored_bits, channel_count);
  put_tag(tiff, 259, kShort, 1);                           // not compressed
  put_tag(tiff, 262, kShort, channel_count == 3 ? 2 : 1);  // RGB, or zero is black
  put_tag(tiff, 273, kLong, kTiffSamplesOffset);
  put_tag(tiff, 277, kShort, channel_count);
  put_tag(tiff, 278, kLong, static_cast<std::uint32_t>(frame.height_px));
  put_tag(tiff, 279, kLong, byte_count);
  put_tag(tiff, 284, kShort, 1);  // channels interleaved
  put_tag(tiff, 339, kShort, 1);  // unsigned integers (one value stands for all channels)
  tiff.u32(0);                    // no further image
  for (int i = 0; i < 3; ++i) tiff.u16(stored_bits);
}

InputError cannot_encode(const std::string& what) { return {InputFault::kInvalid, "", "", what}; }

// (row, col) of a sample, for messages.
std::string pixel_place(std::ptrdiff_t sample, int width_px, int channel_count) {
  const std::ptrdiff_t pixel = sample / channel_count;
  return "pixel (row " + std::to_string(pixel / width_px) + ", column " +
         std::to_string(pixel % width_px) + ")";
}

std::string describe_size(std::int64_t width_px, std::int64_t height_px, int channel_count) {
  return std::to_string(width_px) + " x " + std::to_string(height_px) + " px with " +
         std::to_string(channel_count) + (channel_count == 1 ? " channel" : " channels");
}

Result<void> check_header(const ImageHeader& header, const CameraInfo& camera,
                          const std::string& file) {
  const auto refuse = [&](const std::string& what) {
    return tl::unexpected(InputError{InputFault::kInvalid, file, "", what});
  };
  const int channel_count = sample_channel_count(camera.pixel_format.filter);
  if (header.width_px != camera.width_px || header.height_px != camera.height_px ||
      header.channel_count != channel_count) {
    return refuse("is " + describe_size(header.width_px, header.height_px, header.channel_count) +
                  "; expected " + describe_size(camera.width_px, camera.height_px, channel_count) +
                  ", as /camera of session.json says");
  }
  if (camera.pixel_format.bit_depth > header.bit_depth) {
    return refuse("has " + std::to_string(header.bit_depth) + " bits a sample; expected 16, as " +
                  to_string(camera.pixel_format) + " needs");
  }
  return {};
}

Result<void> check_range(const Image<std::uint16_t>& frame, PixelFormat format,
                         const std::string& file) {
  const int largest = largest_sample(format.bit_depth);
  const auto samples = frame.samples();
  const auto over = std::ranges::find_if(samples, [&](std::uint16_t dn) { return dn > largest; });
  if (over == samples.end()) return {};
  return tl::unexpected(InputError{
      InputFault::kInvalid, file,
      pixel_place(over - samples.begin(), frame.width_px(), frame.channel_count()),
      "is " + std::to_string(*over) + " DN; expected at most " + std::to_string(largest) + " for " +
          to_string(format) +
          ": values are right-aligned, so shift left-aligned ones down or correct pixel_format"});
}

}  // namespace

Result<Image<std::uint16_t>> decode_frame(const std::vector<std::byte>& bytes,
                                          const CameraInfo& camera, const std::string& file) {
  const Result<ImageHeader> header = probe_image(bytes, file);
  if (!header) return tl::unexpected(header.error());
  if (const auto fits = check_header(*header, camera, file); !fits) {
    return tl::unexpected(fits.error());
  }
  Result<Image<std::uint16_t>> frame = decode_image(bytes, *header, file);
  if (!frame) return frame;
  if (const auto fits = check_range(*frame, camera.pixel_format, file); !fits) {
    return tl::unexpected(fits.error());
  }
  return frame;
}

std::uint64_t largest_frame_file(const CameraInfo& camera) {
  // Twice the samples at 16 bit, for a compression that failed; and tags a vendor may add.
  constexpr std::uint64_t kMetadataBytes = std::uint64_t{16} << 20U;
  return kMetadataBytes +
         std::uint64_t{4} * static_cast<std::uint64_t>(camera.width_px) *
             static_cast<std::uint64_t>(camera.height_px) *
             static_cast<std::uint64_t>(sample_channel_count(camera.pixel_format.filter));
}

Result<Image<std::uint16_t>> read_frame(const std::filesystem::path& session,
                                        const Manifest& manifest, const std::string& file) {
  const auto path = resolve_in_session(session, file, "");
  if (!path) return tl::unexpected(path.error());
  const auto bytes = read_file(*path, largest_frame_file(manifest.camera));
  if (!bytes) return tl::unexpected(bytes.error());
  return decode_frame(*bytes, manifest.camera, path->string());
}

Result<std::vector<std::byte>> encode_frame_tiff(ImageView<const std::uint16_t> frame,
                                                 int bit_depth) {
  if (bit_depth != 8 && bit_depth != 12 && bit_depth != 16) {
    return tl::unexpected(
        cannot_encode("a frame of " + std::to_string(bit_depth) + " bits; expected 8, 12 or 16"));
  }
  if (frame.empty() || (frame.channel_count != 1 && frame.channel_count != 3)) {
    return tl::unexpected(cannot_encode("a frame without pixels or of " +
                                        std::to_string(frame.channel_count) +
                                        " channels; expected 1 or 3"));
  }
  const unsigned stored_bits = bit_depth == 8 ? 8 : 16;
  const std::uint64_t byte_count =
      static_cast<std::uint64_t>(frame.height_px) * frame.row(0).size() * (stored_bits / 8U);
  if (byte_count > std::numeric_limits<std::uint32_t>::max() - kTiffSamplesOffset) {
    return tl::unexpected(cannot_encode("a frame of " + std::to_string(byte_count) +
                                        " bytes; expected less than the 4 GiB of a TIFF"));
  }
  const int largest = largest_sample(bit_depth);
  ByteWriter tiff(kTiffSamplesOffset + byte_count);
  put_tiff_header(tiff, frame, stored_bits, static_cast<std::uint32_t>(byte_count));
  for (int row = 0; row < frame.height_px; ++row) {
    const std::span<const std::uint16_t> samples = frame.row(row);
    if (const std::uint16_t brightest = std::ranges::max(samples); brightest > largest) {
      return tl::unexpected(cannot_encode("a sample of " + std::to_string(brightest) +
                                          " DN in row " + std::to_string(row) +
                                          "; expected at most " + std::to_string(largest)));
    }
    if (stored_bits == 16) {
      tiff.samples(samples);
    } else {
      for (const std::uint16_t dn : samples) tiff.u8(dn);
    }
  }
  return tiff.take();
}

}  // namespace estimation
