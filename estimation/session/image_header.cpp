// What the headers of a TIFF or PNG promise. OpenCV's decoders notice most truncated files but not
// all, print to stderr on the way, and allocate what a broken header asks for; so we look first.
#include <zlib.h>

#include <algorithm>
#include <array>
#include <map>
#include <optional>
#include <span>
#include <string_view>

#include "estimation/session/image_file.h"

namespace estimation {
namespace {

using Bytes = std::span<const std::byte>;

enum class ByteOrder { kLittle, kBig };

// `count` <= 8 bytes at `offset`; nullopt beyond the end.
std::optional<std::uint64_t> number_at(Bytes bytes, std::uint64_t offset, int count,
                                       ByteOrder order) {
  const auto byte_count = static_cast<std::uint64_t>(count);
  if (offset > bytes.size() || bytes.size() - offset < byte_count) return std::nullopt;
  std::uint64_t value = 0;
  for (std::uint64_t i = 0; i < byte_count; ++i) {
    const std::uint64_t position = order == ByteOrder::kBig ? i : byte_count - 1 - i;
    value = value << 8U | std::to_integer<std::uint64_t>(bytes[offset + position]);
  }
  return value;
}

InputError damaged(const std::string& file, const std::string& what) {
  return {InputFault::kUnreadable, file, "",
          what + "; expected a whole TIFF or PNG file: copy it again from its source"};
}

InputError unsupported(const std::string& file, const std::string& what) {
  return {InputFault::kInvalid, file, "",
          what +
              "; expected a TIFF or PNG with 8 or 16 bit unsigned samples, one channel or RGB, "
              "without palette, alpha, rotation or lossy compression"};
}

// PNG ---------------------------------------------------------------------------------------------

constexpr std::string_view kPngSignature = "\x89PNG\r\n\x1a\n";

bool starts_with(Bytes bytes, std::string_view prefix) {
  return bytes.size() >= prefix.size() &&
         std::equal(prefix.begin(), prefix.end(), bytes.begin(),
                    [](char c, std::byte b) { return static_cast<std::byte>(c) == b; });
}

// Every chunk up to IEND is there and its checksum right: nothing is truncated or altered.
std::optional<std::string> objection_to_chunks(Bytes bytes) {
  std::uint64_t offset = kPngSignature.size();
  while (true) {
    const auto length = number_at(bytes, offset, 4, ByteOrder::kBig);
    if (!length || bytes.size() - offset < 12 || bytes.size() - offset - 12 < *length) {
      return "is truncated: PNG chunks end without IEND";
    }
    const Bytes type_and_data = bytes.subspan(offset + 4, *length + 4);
    const auto sum = crc32_z(0, reinterpret_cast<const unsigned char*>(type_and_data.data()),
                             type_and_data.size());
    if (number_at(bytes, offset + 8 + *length, 4, ByteOrder::kBig) != sum) {
      return "is damaged: the checksum of a PNG chunk at byte " + std::to_string(offset) +
             " is wrong";
    }
    if (starts_with(type_and_data, "IEND")) return std::nullopt;
    offset += *length + 12;
  }
}

Result<ImageHeader> probe_png(Bytes bytes, const std::string& file) {
  if (const auto objection = objection_to_chunks(bytes)) {
    return tl::unexpected(damaged(file, *objection));
  }
  const auto field = [&](std::uint64_t offset, int count) {
    return number_at(bytes, offset, count, ByteOrder::kBig).value_or(0);
  };
  constexpr std::uint64_t kHeaderData = 16;
  if (field(8, 4) != 13 || !starts_with(bytes.subspan(12), "IHDR")) {
    return tl::unexpected(damaged(file, "is a PNG without its header"));
  }
  const std::uint64_t bit_depth = field(kHeaderData + 8, 1);
  const std::uint64_t color_type = field(kHeaderData + 9, 1);
  if ((bit_depth != 8 && bit_depth != 16) || (color_type != 0 && color_type != 2)) {
    return tl::unexpected(unsupported(file, "is a PNG of " + std::to_string(bit_depth) +
                                                " bits and colour type " +
                                                std::to_string(color_type)));
  }
  return ImageHeader{.width_px = static_cast<std::int64_t>(field(kHeaderData, 4)),
                     .height_px = static_cast<std::int64_t>(field(kHeaderData + 4, 4)),
                     .channel_count = color_type == 2 ? 3 : 1,
                     .bit_depth = static_cast<int>(bit_depth)};
}

// TIFF --------------------------------------------------------------------------------------------

enum TiffTag : std::uint64_t {
  kImageWidth = 256,
  kImageLength = 257,
  kBitsPerSample = 258,
  kCompression = 259,
  kPhotometric = 262,
  kStripOffsets = 273,
  kOrientation = 274,
  kSamplesPerPixel = 277,
  kRowsPerStrip = 278,
  kStripByteCounts = 279,
  kPlanarConfiguration = 284,
  kTileWidth = 322,
  kTileLength = 323,
  kTileOffsets = 324,
  kTileByteCounts = 325,
  kSampleFormat = 339,
};

// The values of the unsigned integer tags of the first image of a TIFF or BigTIFF.
class TiffDirectory {
 public:
  static std::optional<TiffDirectory> read(Bytes bytes) {
    TiffDirectory directory;
    const ByteOrder order = starts_with(bytes, "II") ? ByteOrder::kLittle : ByteOrder::kBig;
    const auto version = number_at(bytes, 2, 2, order);
    const bool is_big = version == 43;
    if (!is_big && version != 42) return std::nullopt;
    const int word = is_big ? 8 : 4;  // bytes of an offset or count
    const auto start = number_at(bytes, is_big ? 8 : 4, word, order);
    if (!start) return std::nullopt;
    const auto entry_count = number_at(bytes, *start, is_big ? 8 : 2, order);
    constexpr std::uint64_t kMostEntries = 4096;
    if (!entry_count || *entry_count > kMostEntries) return std::nullopt;
    const std::uint64_t entry_size = is_big ? 20 : 12;
    for (std::uint64_t i = 0; i < *entry_count; ++i) {
      const std::uint64_t entry = *start + (is_big ? 8U : 2U) + i * entry_size;
      if (!directory.read_entry(bytes, entry, word, order)) return std::nullopt;
    }
    return directory;
  }

  const std::vector<std::uint64_t>& values(TiffTag tag) const {
    static const std::vector<std::uint64_t> kNone;
    const auto it = tags_.find(tag);
    return it == tags_.end() ? kNone : it->second;
  }
  std::uint64_t value(TiffTag tag, std::uint64_t fallback) const {
    return values(tag).empty() ? fallback : values(tag).front();
  }

 private:
  // False if the entry or its values lie beyond the end of the file.
  bool read_entry(Bytes bytes, std::uint64_t entry, int word, ByteOrder order) {
    const auto tag = number_at(bytes, entry, 2, order);
    const auto type = number_at(bytes, entry + 2, 2, order);
    const auto count = number_at(bytes, entry + 4, word, order);
    const std::uint64_t inline_at = entry + 4 + static_cast<std::uint64_t>(word);
    const auto outside_at = number_at(bytes, inline_at, word, order);
    if (!tag || !type || !count || !outside_at) return false;
    const int size = *type == 1 ? 1 : *type == 3 ? 2 : *type == 4 ? 4 : *type == 16 ? 8 : 0;
    if (size == 0) return true;  // no unsigned integer: none of the tags we ask for
    const auto value_size = static_cast<std::uint64_t>(size);
    if (*count > bytes.size() / value_size) return false;
    const bool is_inline = *count * value_size <= static_cast<std::uint64_t>(word);
    const std::uint64_t first = is_inline ? inline_at : *outside_at;
    std::vector<std::uint64_t>& values = tags_[*tag];
    for (std::uint64_t i = 0; i < *count; ++i) {
      const auto value = number_at(bytes, first + i * value_size, size, order);
      if (!value) return false;
      values.push_back(*value);
    }
    return true;
  }

  std::map<std::uint64_t, std::vector<std::uint64_t>> tags_;
};

// Strips and tiles far larger than the image: OpenCV allocates one whole.
std::string objection_to_parts(const TiffDirectory& tiff) {
  constexpr std::uint64_t kLargestPart = 4096;
  constexpr std::uint64_t kAllRows = 0xFFFFFFFF;  // the format's default
  const std::uint64_t most_columns = std::max(tiff.value(kImageWidth, 0), kLargestPart);
  const std::uint64_t most_rows = std::max(tiff.value(kImageLength, 0), kLargestPart);
  const std::uint64_t strip_rows = tiff.value(kRowsPerStrip, kAllRows);
  if (strip_rows != kAllRows && strip_rows > most_rows) {
    return "strips of " + std::to_string(strip_rows) + " rows";
  }
  if (tiff.value(kTileWidth, 0) > most_columns || tiff.value(kTileLength, 0) > most_rows) {
    return "tiles of " + std::to_string(tiff.value(kTileWidth, 0)) + " x " +
           std::to_string(tiff.value(kTileLength, 0)) + " px";
  }
  return {};
}

// Why this kind of TIFF is refused; "" if it is not.
std::string objection_to_kind(const TiffDirectory& tiff) {
  constexpr std::array<std::uint64_t, 5> kLossless{1, 5, 8, 32773, 32946};
  const std::uint64_t channels = tiff.value(kSamplesPerPixel, 1);
  const std::uint64_t bits = tiff.value(kBitsPerSample, 1);
  const std::uint64_t compression = tiff.value(kCompression, 1);
  if (channels != 1 && channels != 3) return std::to_string(channels) + " channels";
  if (bits != 8 && bits != 16) return std::to_string(bits) + " bits a sample";
  for (const std::uint64_t other : tiff.values(kBitsPerSample)) {
    if (other != bits) return "channels of different depth";
  }
  if (tiff.value(kSampleFormat, 1) != 1) return "samples that are no unsigned integers";
  if (std::ranges::find(kLossless, compression) == kLossless.end()) {
    return "compression " + std::to_string(compression);
  }
  // 1: zero is black; 2: RGB.
  if (tiff.value(kPhotometric, 1) != (channels == 3 ? 2U : 1U)) {
    return "photometric interpretation " + std::to_string(tiff.value(kPhotometric, 1));
  }
  if (tiff.value(kOrientation, 1) != 1) {
    return "orientation " + std::to_string(tiff.value(kOrientation, 1));
  }
  if (channels == 3 && tiff.value(kPlanarConfiguration, 1) != 1) return "separate colour planes";
  return objection_to_parts(tiff);
}

// Whether every strip or tile lies in the file, and uncompressed strips hold all their rows.
std::string objection_to_extent(const TiffDirectory& tiff, Bytes bytes) {
  const bool is_tiled = !tiff.values(kTileOffsets).empty();
  const auto& offsets = tiff.values(is_tiled ? kTileOffsets : kStripOffsets);
  const auto& counts = tiff.values(is_tiled ? kTileByteCounts : kStripByteCounts);
  if (offsets.empty() || offsets.size() != counts.size()) return "has no list of its strips";
  std::uint64_t byte_count = 0;
  for (std::size_t i = 0; i < offsets.size(); ++i) {
    if (offsets[i] > bytes.size() || bytes.size() - offsets[i] < counts[i]) {
      return "is truncated: its samples go on beyond the end of the file";
    }
    byte_count += counts[i];
  }
  if (is_tiled || tiff.value(kCompression, 1) != 1) return {};
  const std::uint64_t expected = tiff.value(kImageWidth, 0) * tiff.value(kImageLength, 0) *
                                 tiff.value(kSamplesPerPixel, 1) *
                                 (tiff.value(kBitsPerSample, 8) / 8);
  if (byte_count < expected) {
    return "is truncated: its strips hold " + std::to_string(byte_count) + " of " +
           std::to_string(expected) + " bytes";
  }
  return {};
}

Result<ImageHeader> probe_tiff(Bytes bytes, const std::string& file) {
  const std::optional<TiffDirectory> tiff = TiffDirectory::read(bytes);
  if (!tiff) {
    return tl::unexpected(damaged(file, "is truncated or damaged: its TIFF tags cannot be read"));
  }
  if (const std::string kind = objection_to_kind(*tiff); !kind.empty()) {
    return tl::unexpected(unsupported(file, "is a TIFF with " + kind));
  }
  // Sides are 32 bit by the format; this also keeps their product in range.
  constexpr std::uint64_t kLargestSide = 1U << 24U;
  const std::uint64_t width = tiff->value(kImageWidth, 0);
  const std::uint64_t height = tiff->value(kImageLength, 0);
  if (width == 0 || height == 0 || width > kLargestSide || height > kLargestSide) {
    return tl::unexpected(damaged(
        file, "is a TIFF of " + std::to_string(width) + " x " + std::to_string(height) + " px"));
  }
  if (const std::string objection = objection_to_extent(*tiff, bytes); !objection.empty()) {
    return tl::unexpected(damaged(file, objection));
  }
  return ImageHeader{.width_px = static_cast<std::int64_t>(width),
                     .height_px = static_cast<std::int64_t>(height),
                     .channel_count = static_cast<int>(tiff->value(kSamplesPerPixel, 1)),
                     .bit_depth = static_cast<int>(tiff->value(kBitsPerSample, 8))};
}

}  // namespace

Result<ImageHeader> probe_image(const std::vector<std::byte>& bytes, const std::string& file) {
  if (starts_with(bytes, kPngSignature)) return probe_png(bytes, file);
  if (starts_with(bytes, "II") || starts_with(bytes, "MM")) return probe_tiff(bytes, file);
  if (bytes.empty()) return tl::unexpected(damaged(file, "is empty"));
  return tl::unexpected(damaged(file, "is neither TIFF nor PNG, or its first bytes are damaged"));
}

}  // namespace estimation
