// The one place that calls OpenEXR, and the one that catches what it throws.
#include "estimation/session/exr.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>
#include <ImfThreading.h>

#include <algorithm>
#include <cstring>
#include <exception>
#include <stdexcept>
#include <thread>

#include "estimation/base/check.h"
#include "estimation/session/exr_header.h"
#include "estimation/session/file_reading.h"
#include "estimation/session/frame_io.h"
#include "estimation/session/manifest_parts.h"
#include "estimation/session/maps.h"

namespace estimation {
namespace {

// Room for the uncertainty of a 20 megapixel camera, uncompressed.
constexpr std::uint64_t kLargestExrBytes = std::uint64_t{4} << 30U;
constexpr std::size_t kMostChannels = 1024;

// OpenEXR's worker threads and its bound on what a header may ask for: once a process. The pool is
// emptied before static objects go: its own destruction at exit can deadlock before 3.1.8.
class ExrRuntime {
 public:
  static void start() { static const ExrRuntime kRuntime; }
  ~ExrRuntime() { Imf::setGlobalThreadCount(0); }
  ExrRuntime(const ExrRuntime&) = delete;
  ExrRuntime& operator=(const ExrRuntime&) = delete;

 private:
  ExrRuntime() {
    // ZIP packs 16 lines at a time: beyond a few threads the disk is the limit.
    constexpr unsigned kMostThreads = 8;
    Imf::setGlobalThreadCount(
        static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1U, kMostThreads)));
    Imf::Header::setMaxImageSize(kLargestSidePx, kLargestSidePx);
    // Buffers for several tiles are made before the first is read; programs write 32 to 1024 px.
    constexpr int kLargestTilePx = 2048;
    Imf::Header::setMaxTileSize(kLargestTilePx, kLargestTilePx);
  }
};

// OpenEXR reads and writes memory here, so that files get whole or absent by one way for all.
class MemoryOut final : public Imf::OStream {
 public:
  explicit MemoryOut(const char* name) : Imf::OStream(name) {}

  void write(const char data[], int byte_count) override {
    const auto count = static_cast<std::size_t>(byte_count);
    if (position_ + count > bytes_.size()) bytes_.resize(position_ + count);
    std::memcpy(bytes_.data() + position_, data, count);
    position_ += count;
  }
  std::uint64_t tellp() override { return position_; }
  void seekp(std::uint64_t position) override { position_ = position; }
  const std::vector<std::byte>& bytes() const { return bytes_; }

 private:
  std::vector<std::byte> bytes_;
  std::size_t position_ = 0;
};

class MemoryIn final : public Imf::IStream {
 public:
  MemoryIn(const std::vector<std::byte>& bytes, const char* name)
      : Imf::IStream(name), bytes_(bytes) {}

  // OpenEXR asks for a throw at the end of the data; its callers catch it as one of their own.
  bool read(char data[], int byte_count) override {
    const auto count = static_cast<std::size_t>(byte_count);
    if (position_ > bytes_.size() || bytes_.size() - position_ < count) {
      throw std::runtime_error("the file ends too early");
    }
    std::memcpy(data, bytes_.data() + position_, count);
    position_ += count;
    return position_ < bytes_.size();
  }
  std::uint64_t tellg() override { return position_; }
  void seekg(std::uint64_t position) override { position_ = position; }

 private:
  const std::vector<std::byte>& bytes_;
  std::size_t position_ = 0;
};

InputError broken_exr(const std::string& file, const std::string& what) {
  return {InputFault::kUnreadable, file, "",
          what + "; expected a whole OpenEXR file of scan lines or tiles"};
}

// A float slice whose pixel (x, y) of the data window lies at data[(y - y0) * stride + (x - x0)].
Imf::Slice float_slice(float* data, std::ptrdiff_t stride, const Imath::Box2i& window) {
  char* first = reinterpret_cast<char*>(data - window.min.y * stride - window.min.x);
  return {Imf::FLOAT, first, sizeof(float), sizeof(float) * static_cast<std::size_t>(stride)};
}

// Throws what OpenEXR throws.
std::vector<std::byte> encode(const std::vector<ExrChannel>& channels,
                              const std::vector<std::pair<std::string, std::string>>& attributes) {
  const ImageView<const float>& first = channels.front().pixels;
  Imf::Header header(first.width_px, first.height_px);
  header.compression() = Imf::ZIP_COMPRESSION;
  for (const auto& [name, value] : attributes) header.insert(name, Imf::StringAttribute(value));
  Imf::FrameBuffer buffer;
  for (const ExrChannel& channel : channels) {
    header.channels().insert(channel.name, Imf::Channel(Imf::FLOAT));
    // OpenEXR's slices are for reading and writing alike; writing a file only reads them.
    buffer.insert(channel.name, float_slice(const_cast<float*>(channel.pixels.data),  // NOLINT
                                            channel.pixels.stride, header.dataWindow()));
  }
  MemoryOut out("memory");
  {
    Imf::OutputFile file(out, header);
    file.setFrameBuffer(buffer);
    file.writePixels(first.height_px);
  }  // the table of line offsets is written by the destructor
  return out.bytes();
}

std::map<std::string, std::string> text_attributes(const Imf::Header& header) {
  std::map<std::string, std::string> attributes;
  for (auto it = header.begin(); it != header.end(); ++it) {
    if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(&it.attribute())) {
      attributes[it.name()] = text->value();
    }
  }
  return attributes;
}

// No compression that OpenEXR has for data like ours packs tighter (deflate: 1032 to 1); what is
// small may be anything. So the samples a header asks for are bounded by the file's own size.
constexpr std::uint64_t kTightestPacking = 1100;
constexpr std::uint64_t kAlwaysAllowedBytes = std::uint64_t{64} << 20U;

// What makes the file unfit before a pixel is allocated; "" if nothing.
std::string objection_to_header(const Imf::Header& header, std::uint64_t file_byte_count) {
  const Imath::Box2i& window = header.dataWindow();
  const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1;
  const std::int64_t height = std::int64_t{window.max.y} - window.min.y + 1;
  std::int64_t channel_count = 0;
  for (auto it = header.channels().begin(); it != header.channels().end(); ++it) {
    ++channel_count;
    if (it.channel().xSampling != 1 || it.channel().ySampling != 1) {
      return std::string("its channel ") + it.name() + " is subsampled";
    }
  }
  const auto limit = static_cast<std::int64_t>(
      std::min(kLargestExrBytes, kAlwaysAllowedBytes + kTightestPacking * file_byte_count) /
      sizeof(float));
  if (width < 1 || height < 1 || width > kLargestSidePx || height > kLargestSidePx ||
      width * height > kLargestAreaPx || channel_count > static_cast<std::int64_t>(kMostChannels) ||
      width * height * channel_count > limit) {
    return "its header asks for " + std::to_string(width) + " x " + std::to_string(height) +
           " px with " + std::to_string(channel_count) + " channels, which " +
           std::to_string(file_byte_count) + " bytes cannot hold";
  }
  return {};
}

// Throws what OpenEXR throws.
Result<ExrFile> decode(const std::vector<std::byte>& bytes, const std::string& name) {
  if (const std::string objection = objection_to_exr_headers(bytes); !objection.empty()) {
    return tl::unexpected(broken_exr(name, objection));
  }
  MemoryIn in(bytes, name.c_str());
  Imf::InputFile file(in);
  const Imf::Header& header = file.header();
  if (const std::string objection = objection_to_header(header, bytes.size()); !objection.empty()) {
    return tl::unexpected(broken_exr(name, objection));
  }
  const Imath::Box2i window = header.dataWindow();
  ExrFile content;
  content.attributes = text_attributes(header);
  Imf::FrameBuffer buffer;
  for (auto it = header.channels().begin(); it != header.channels().end(); ++it) {
    Image<float>& image = content.channels[it.name()];
    image = Image<float>(window.max.y - window.min.y + 1, window.max.x - window.min.x + 1);
    buffer.insert(it.name(), float_slice(image.samples().data(), image.width_px(), window));
  }
  file.setFrameBuffer(buffer);
  file.readPixels(window.min.y, window.max.y);
  if (!file.isComplete()) return tl::unexpected(broken_exr(name, "lines are missing"));
  return content;
}

}  // namespace

Result<void> write_exr(const std::filesystem::path& path, const std::vector<ExrChannel>& channels,
                       const std::vector<std::pair<std::string, std::string>>& attributes) {
  check(!channels.empty(), "an EXR file needs a channel");
  for (const ExrChannel& channel : channels) {
    check(!channel.pixels.empty() && channel.pixels.channel_count == 1 &&
              channel.pixels.width_px == channels.front().pixels.width_px &&
              channel.pixels.height_px == channels.front().pixels.height_px,
          "the channels of an EXR file are single planes of one size");
  }
  try {
    ExrRuntime::start();
    return write_file_atomically(path, encode(channels, attributes));
  } catch (const std::exception& error) {  // Iex::BaseExc, std::bad_alloc
    return tl::unexpected(InputError{InputFault::kUnwritable, path.string(), "",
                                     std::string("cannot be encoded: ") + error.what()});
  }
}

Result<ExrFile> decode_exr(const std::vector<std::byte>& bytes, const std::string& file) {
  try {
    ExrRuntime::start();
    return decode(bytes, file);
  } catch (const std::exception& error) {  // Iex::BaseExc, std::bad_alloc
    return tl::unexpected(broken_exr(file, std::string("is damaged: ") + error.what()));
  }
}

Result<ExrFile> read_exr_file(const std::filesystem::path& path) {
  const Result<std::vector<std::byte>> bytes = read_file(path, kLargestExrBytes);
  if (!bytes) return tl::unexpected(bytes.error());
  return decode_exr(*bytes, path.string());
}

Result<std::map<std::string, Image<float>>> read_exr(const std::filesystem::path& path) {
  Result<ExrFile> file = read_exr_file(path);
  if (!file) return tl::unexpected(file.error());
  return std::move(file->channels);
}

}  // namespace estimation
