#include "estimation/session/exr_header.h"

#include <array>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string_view>
#include <utility>

namespace estimation {
namespace {

using Bytes = std::span<const std::byte>;

// Bytes of a value, where its type has always as many.
constexpr std::array<std::pair<std::string_view, std::uint32_t>, 24> kTypeSizes{
    {{"box2f", 16},      {"box2i", 16},   {"chromaticities", 32},
     {"compression", 1}, {"double", 8},   {"envmap", 1},
     {"float", 4},       {"int", 4},      {"keycode", 28},
     {"lineOrder", 1},   {"m33f", 36},    {"m33d", 72},
     {"m44f", 64},       {"m44d", 128},   {"rational", 8},
     {"tiledesc", 9},    {"timecode", 8}, {"v2i", 8},
     {"v2f", 8},         {"v2d", 16},     {"v3i", 12},
     {"v3f", 12},        {"v3d", 24},     {"deepImageState", 1}}};

// The file from a place on.
class Reader {
 public:
  explicit Reader(Bytes bytes) : bytes_(bytes) {}

  // A text that ends with a zero byte; nullopt if none does or it is longer than OpenEXR's names.
  std::optional<std::string_view> text() {
    constexpr std::size_t kLongestName = 255;
    std::size_t length = 0;
    while (length < bytes_.size() && bytes_[length] != std::byte{0}) ++length;
    if (length == bytes_.size() || length > kLongestName) return std::nullopt;
    const std::string_view text(reinterpret_cast<const char*>(bytes_.data()), length);
    bytes_ = bytes_.subspan(length + 1);
    return text;
  }

  std::optional<std::uint32_t> number() {
    std::uint32_t number = 0;
    if (bytes_.size() < sizeof number) return std::nullopt;
    std::memcpy(&number, bytes_.data(), sizeof number);
    bytes_ = bytes_.subspan(sizeof number);
    return number;
  }

  std::optional<Bytes> take(std::size_t count) {
    if (bytes_.size() < count) return std::nullopt;
    const Bytes taken = bytes_.first(count);
    bytes_ = bytes_.subspan(count);
    return taken;
  }

  bool is_empty() const { return bytes_.empty(); }

 private:
  Bytes bytes_;
};

// Names with 16 bytes each, then a zero byte, which is the list's last.
bool is_channel_list(Bytes value) {
  constexpr std::size_t kChannelBytes = 16;
  Reader reader(value);
  while (true) {
    const auto name = reader.text();
    if (!name) return false;
    if (name->empty()) return reader.is_empty();
    if (!reader.take(kChannelBytes)) return false;
  }
}

// Width and height, then 4 bytes a pixel.
bool is_preview(Bytes value) {
  Reader reader(value);
  const auto width_px = reader.number();
  const auto height_px = reader.number();
  if (!width_px || !height_px) return false;
  const std::uint64_t pixel_count = std::uint64_t{*width_px} * *height_px;
  return pixel_count <= value.size() && 8 + 4 * pixel_count == value.size();
}

// Texts, each after its length.
bool is_text_list(Bytes value) {
  Reader reader(value);
  while (!reader.is_empty()) {
    const auto length = reader.number();
    if (!length || !reader.take(*length)) return false;
  }
  return true;
}

bool is_sound(std::string_view type, Bytes value) {
  for (const auto& [name, byte_count] : kTypeSizes) {
    if (type == name) return value.size() == byte_count;
  }
  if (type == "chlist") return is_channel_list(value);
  if (type == "preview") return is_preview(value);
  if (type == "stringvector") return is_text_list(value);
  if (type == "floatvector") return value.size() % 4 == 0;
  return true;  // a text, or bytes that OpenEXR keeps as they are
}

// Attributes up to an empty name. Sets `is_empty` where there is none.
std::string objection_to_header(Reader& reader, bool& is_empty) {
  is_empty = true;
  while (true) {
    const auto name = reader.text();
    if (!name) return "its header is truncated";
    if (name->empty()) return {};
    is_empty = false;
    const auto type = reader.text();
    const auto byte_count = reader.number();
    const auto value = byte_count ? reader.take(*byte_count) : std::nullopt;
    if (!type || !value) return "an attribute goes on beyond the end of the file";
    if (!is_sound(*type, *value)) return "its attribute " + std::string(*name) + " is damaged";
  }
}

}  // namespace

std::string objection_to_exr_headers(const std::vector<std::byte>& bytes) {
  constexpr std::uint32_t kMagic = 20000630;
  constexpr std::uint32_t kMultiPart = 0x1000;
  Reader reader(bytes);
  const auto magic = reader.number();
  const auto version = reader.number();
  if (magic != kMagic || !version) return "it does not begin as an EXR file";
  bool is_last = (*version & kMultiPart) == 0;
  bool is_empty = false;
  do {
    if (std::string objection = objection_to_header(reader, is_empty); !objection.empty()) {
      return objection;
    }
    is_last = is_last || is_empty;
  } while (!is_last);
  return {};
}

}  // namespace estimation
