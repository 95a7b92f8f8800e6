#include "estimation/session/frame_io.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "session_folder.h"

namespace estimation {
namespace {

using testing::HasSubstr;

constexpr int kWidthPx = 13;
constexpr int kHeightPx = 7;
const char* const kAllFormats[] = {"Mono8",     "Mono12",    "Mono16", "BayerRG8", "BayerGR12",
                                   "BayerGB16", "BayerBG12", "RGB8",   "RGB16"};

Manifest manifest_of(const std::string& format, int width_px = kWidthPx,
                     int height_px = kHeightPx) {
  Manifest manifest;
  manifest.camera.width_px = width_px;
  manifest.camera.height_px = height_px;
  manifest.camera.pixel_format = parse_pixel_format(format).value();
  return manifest;
}

Image<std::uint16_t> random_frame(PixelFormat format, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  Image<std::uint16_t> frame(kHeightPx, kWidthPx, sample_channel_count(format.filter));
  for (std::uint16_t& dn : frame.samples()) {
    dn = static_cast<std::uint16_t>(random() % (1U << static_cast<unsigned>(format.bit_depth)));
  }
  return frame;
}

// The same samples as OpenCV orders them: blue first.
cv::Mat bgr_of(const Image<std::uint16_t>& frame, int bit_depth) {
  cv::Mat mat(frame.height_px(), frame.width_px(), CV_16UC(frame.channel_count()));
  for (int row = 0; row < mat.rows; ++row) {
    for (int col = 0; col < mat.cols; ++col) {
      for (int channel = 0; channel < mat.channels(); ++channel) {
        mat.ptr<std::uint16_t>(row)[col * mat.channels() + channel] =
            frame.at(row, col, mat.channels() - 1 - channel);
      }
    }
  }
  if (bit_depth == 8) mat.convertTo(mat, CV_8U);
  return mat;
}

std::vector<std::byte> encoded(const cv::Mat& mat, const std::string& extension,
                               const std::vector<int>& parameters = {}) {
  std::vector<unsigned char> bytes;
  EXPECT_TRUE(cv::imencode(extension, mat, bytes, parameters));
  std::vector<std::byte> result(bytes.size());
  std::ranges::transform(bytes, result.begin(), [](unsigned char b) { return std::byte{b}; });
  return result;
}

// Bytes as a frame of a session on disk.
Result<Image<std::uint16_t>> read_bytes(const std::vector<std::byte>& bytes,
                                        const Manifest& manifest) {
  const TemporaryFolder session;
  write_bytes(session.path() / "f.tiff", bytes);
  return read_frame(session.path(), manifest, "f.tiff");
}

void expect_equal(const Result<Image<std::uint16_t>>& read, const Image<std::uint16_t>& frame) {
  ASSERT_TRUE(read) << read.error().text();
  ASSERT_EQ(read->height_px(), frame.height_px());
  ASSERT_EQ(read->width_px(), frame.width_px());
  ASSERT_EQ(read->channel_count(), frame.channel_count());
  EXPECT_TRUE(std::ranges::equal(read->samples(), frame.samples()));
}

void expect_refused(const Result<Image<std::uint16_t>>& read, const std::string& part) {
  ASSERT_FALSE(read) << "accepted, not: " << part;
  EXPECT_THAT(read.error().file, HasSubstr("f.tiff"));
  EXPECT_THAT(read.error().expectation, HasSubstr("; expected "));
  EXPECT_THAT(read.error().text(), HasSubstr(part));
}

TEST(FrameIo, EveryFormatSurvivesOurTiff) {
  for (const char* name : kAllFormats) {
    SCOPED_TRACE(name);
    const Manifest manifest = manifest_of(name);
    const PixelFormat format = manifest.camera.pixel_format;
    const Image<std::uint16_t> frame = random_frame(format, 5);
    const auto bytes = encode_frame_tiff(frame.view(), format.bit_depth);
    ASSERT_TRUE(bytes);
    expect_equal(read_bytes(*bytes, manifest), frame);
  }
}

TEST(FrameIo, OurTiffIsReadByOthersAndUncompressed) {
  for (const char* name : kAllFormats) {
    SCOPED_TRACE(name);
    const PixelFormat format = parse_pixel_format(name).value();
    const Image<std::uint16_t> frame = random_frame(format, 6);
    auto bytes = encode_frame_tiff(frame.view(), format.bit_depth);
    ASSERT_TRUE(bytes);
    const cv::Mat raw(1, static_cast<int>(bytes->size()), CV_8UC1, bytes->data());
    const cv::Mat decoded = cv::imdecode(raw, cv::IMREAD_UNCHANGED);
    const cv::Mat expected = bgr_of(frame, format.bit_depth);
    ASSERT_EQ(decoded.type(), expected.type());
    ASSERT_EQ(decoded.size(), expected.size());
    EXPECT_EQ(cv::norm(decoded, expected, cv::NORM_INF), 0);
    const std::size_t sample_bytes = frame.samples().size() * (format.bit_depth == 8 ? 1 : 2);
    EXPECT_LT(bytes->size(), sample_bytes + 400);
    EXPECT_GE(bytes->size(), sample_bytes);
  }
}

TEST(FrameIo, EveryFormatIsReadFromOthersTiffAndPng) {
  for (const char* name : kAllFormats) {
    const Manifest manifest = manifest_of(name);
    const PixelFormat format = manifest.camera.pixel_format;
    const Image<std::uint16_t> frame = random_frame(format, 7);
    const cv::Mat mat = bgr_of(frame, format.bit_depth);
    // TIFF compressions: none, LZW, deflate, PackBits.
    for (const int compression : {1, 5, 8, 32946, 32773}) {
      SCOPED_TRACE(std::string(name) + " TIFF " + std::to_string(compression));
      expect_equal(
          read_bytes(encoded(mat, ".tiff", {cv::IMWRITE_TIFF_COMPRESSION, compression}), manifest),
          frame);
    }
    SCOPED_TRACE(std::string(name) + " PNG");
    expect_equal(read_bytes(encoded(mat, ".png"), manifest), frame);
  }
}

TEST(FrameIo, EightBitValuesMayLieInASixteenBitFile) {
  const Manifest manifest = manifest_of("Mono8");
  const Image<std::uint16_t> frame = random_frame(manifest.camera.pixel_format, 8);
  expect_equal(read_bytes(encoded(bgr_of(frame, 16), ".png"), manifest), frame);
}

std::vector<std::byte> bytes_of_list(std::initializer_list<int> values) {
  std::vector<std::byte> bytes;
  for (const int value : values) bytes.push_back(static_cast<std::byte>(value));
  return bytes;
}

void expect_red_green_blue(const Result<Image<std::uint16_t>>& read) {
  ASSERT_TRUE(read) << read.error().text();
  const std::array<std::uint16_t, 9> expected{255, 0, 0, 0, 254, 0, 0, 0, 253};
  EXPECT_TRUE(std::ranges::equal(read->samples(), expected));
}

TEST(FrameIo, AHandMadePngHasItsColoursInOrder) {
  // 3 x 1 px, 8 bit RGB: red 255, green 254, blue 253. Made with Python's zlib and struct.
  const auto png = bytes_of_list(
      {0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44,
       0x52, 0x00, 0x00, 0x00, 0x03, 0x00, 0x00, 0x00, 0x01, 0x08, 0x02, 0x00, 0x00, 0x00, 0x94,
       0x82, 0x83, 0xe3, 0x00, 0x00, 0x00, 0x11, 0x49, 0x44, 0x41, 0x54, 0x78, 0x9c, 0x63, 0xf8,
       0xcf, 0xc0, 0xc0, 0xf0, 0x0f, 0x88, 0xff, 0x02, 0x00, 0x0e, 0xf4, 0x02, 0xfb, 0xf6, 0xea,
       0x74, 0x4b, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82});
  expect_red_green_blue(read_bytes(png, manifest_of("RGB8", 3, 1)));
}

// A big-endian TIFF of 3 x 1 px, 8 bit RGB, written from the specification; classic or BigTIFF.
class HandMadeTiff {
 public:
  explicit HandMadeTiff(bool is_big) : is_big_(is_big) {
    put(0x4d4d, 2);
    put(is_big ? 43 : 42, 2);
    if (is_big) {
      put(8, 2);
      put(0, 2);
    }
    const int word = is_big ? 8 : 4;
    const int start = is_big ? 16 : 8;
    const int tag_count = 9;
    const int samples_at = start + (is_big ? 8 : 2) + tag_count * (4 + 2 * word) + word;
    put(start, word);
    put(tag_count, is_big ? 8 : 2);
    tag(256, 3);
    tag(257, 1);
    tag(258, 8);
    tag(259, 1);
    tag(262, 2);
    long_tag(273, samples_at);
    tag(277, 3);
    tag(278, 1);
    tag(279, 9);
    put(0, word);
    for (const int value : {255, 0, 0, 0, 254, 0, 0, 0, 253}) put(value, 1);
  }
  const std::vector<std::byte>& bytes() const { return bytes_; }

 private:
  void put(int value, int byte_count) {
    for (int i = byte_count - 1; i >= 0; --i) {
      bytes_.push_back(i < 4 ? static_cast<std::byte>(value >> (8 * i) & 255) : std::byte{0});
    }
  }
  void tag(int number, int value) {  // one 16 bit value, left-aligned in its field
    put(number, 2);
    put(3, 2);
    put(1, is_big_ ? 8 : 4);
    put(value, 2);
    for (int i = is_big_ ? 6 : 2; i > 0; --i) put(0, 1);
  }
  void long_tag(int number, int value) {
    put(number, 2);
    put(4, 2);
    put(1, is_big_ ? 8 : 4);
    put(value, 4);
    if (is_big_) put(0, 4);
  }

  bool is_big_;
  std::vector<std::byte> bytes_;
};

TEST(FrameIo, AHandMadeBigEndianTiffHasItsColoursInOrder) {
  expect_red_green_blue(read_bytes(HandMadeTiff(false).bytes(), manifest_of("RGB8", 3, 1)));
}

TEST(FrameIo, AHandMadeBigTiffIsRead) {
  expect_red_green_blue(read_bytes(HandMadeTiff(true).bytes(), manifest_of("RGB8", 3, 1)));
}

TEST(FrameIo, AFileCutAnywhereIsAnError) {
  const Manifest manifest = manifest_of("RGB16");
  const PixelFormat format = manifest.camera.pixel_format;
  const Image<std::uint16_t> frame = random_frame(format, 9);
  const cv::Mat mat = bgr_of(frame, 16);
  const std::vector<std::pair<std::string, std::vector<std::byte>>> files{
      {"our TIFF", encode_frame_tiff(frame.view(), 16).value()},
      {"OpenCV's TIFF", encoded(mat, ".tiff", {cv::IMWRITE_TIFF_COMPRESSION, 1})},
      {"LZW TIFF", encoded(mat, ".tiff", {cv::IMWRITE_TIFF_COMPRESSION, 5})},
      {"PNG", encoded(mat, ".png")}};
  for (const auto& [kind, bytes] : files) {
    SCOPED_TRACE(kind);
    // OpenCV's TIFF ends with its tags' values, the last of which may go unused.
    const std::size_t largest_cut = kind == "OpenCV's TIFF" || kind == "LZW TIFF" ? 20 : 1;
    for (std::size_t size = 0; size + largest_cut <= bytes.size(); ++size) {
      const auto read =
          read_bytes({bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(size)}, manifest);
      ASSERT_FALSE(read) << size << " of " << bytes.size();
      ASSERT_EQ(read.error().fault, InputFault::kUnreadable) << read.error().text();
    }
  }
}

TEST(FrameIo, ACutFileSaysSo) {
  const Manifest manifest = manifest_of("Mono16");
  const Image<std::uint16_t> frame = random_frame(manifest.camera.pixel_format, 10);
  std::vector<std::byte> tiff = encode_frame_tiff(frame.view(), 16).value();
  tiff.pop_back();
  expect_refused(read_bytes(tiff, manifest), "is truncated");
  std::vector<std::byte> png = encoded(bgr_of(frame, 16), ".png");
  png.erase(png.end() - 3, png.end());  // GCC 12 misreads resize() under its sanitizers
  expect_refused(read_bytes(png, manifest), "is truncated");
  expect_refused(read_bytes({}, manifest), "is empty");
  expect_refused(read_bytes(bytes_of("a text"), manifest), "neither TIFF nor PNG");
}

TEST(FrameIo, AnAlteredPngIsAnError) {
  const Manifest manifest = manifest_of("Mono16");
  std::vector<std::byte> png =
      encoded(bgr_of(random_frame(manifest.camera.pixel_format, 11), 16), ".png");
  png[png.size() / 2] ^= std::byte{1};
  expect_refused(read_bytes(png, manifest), "checksum");
}

TEST(FrameIo, AMissingFileIsNotFound) {
  const TemporaryFolder session;
  const auto read = read_frame(session.path(), manifest_of("Mono8"), "frames/f.tiff");
  ASSERT_FALSE(read);
  EXPECT_EQ(read.error().fault, InputFault::kNotFound);
  EXPECT_THAT(read.error().text(), HasSubstr("frames/f.tiff"));
}

TEST(FrameIo, ANameOutOfTheSessionIsRefused) {
  const TemporaryFolder session;
  EXPECT_FALSE(read_frame(session.path(), manifest_of("Mono8"), "/etc/hostname"));
  EXPECT_FALSE(read_frame(session.path(), manifest_of("Mono8"), "../f.tiff"));
}

TEST(FrameIo, TheManifestsSizeAndChannelsAreRequired) {
  const Image<std::uint16_t> mono = random_frame({ColorFilter::kMono, 16}, 12);
  const Image<std::uint16_t> colour = random_frame({ColorFilter::kRgb, 16}, 12);
  const auto mono_tiff = encode_frame_tiff(mono.view(), 16).value();
  const auto colour_tiff = encode_frame_tiff(colour.view(), 16).value();
  expect_refused(read_bytes(mono_tiff, manifest_of("Mono16", 14)),
                 "13 x 7 px with 1 channel; expected 14 x 7 px with 1 channel");
  expect_refused(read_bytes(mono_tiff, manifest_of("RGB16")), "expected 13 x 7 px with 3 channels");
  expect_refused(read_bytes(colour_tiff, manifest_of("BayerRG16")),
                 "is 13 x 7 px with 3 channels; expected 13 x 7 px with 1 channel");
}

TEST(FrameIo, TwelveBitsNeedASixteenBitFile) {
  const Image<std::uint16_t> frame = random_frame({ColorFilter::kMono, 8}, 13);
  expect_refused(read_bytes(encode_frame_tiff(frame.view(), 8).value(), manifest_of("Mono12")),
                 "8 bits a sample; expected 16, as Mono12 needs");
}

TEST(FrameIo, AValueAboveTheDepthNamesItsPixel) {
  Image<std::uint16_t> frame(kHeightPx, kWidthPx);
  frame.at(3, 5) = 4096;
  const auto read = read_bytes(encode_frame_tiff(frame.view(), 16).value(), manifest_of("Mono12"));
  expect_refused(read, "pixel (row 3, column 5): is 4096 DN; expected at most 4095");
  frame.at(3, 5) = 4095;
  EXPECT_TRUE(read_bytes(encode_frame_tiff(frame.view(), 16).value(), manifest_of("Mono12")));
}

TEST(FrameIo, OtherKindsOfPicturesAreRefusedByName) {
  const Manifest manifest = manifest_of("Mono8");
  cv::Mat alpha(kHeightPx, kWidthPx, CV_8UC4, cv::Scalar(1, 2, 3, 4));
  expect_refused(read_bytes(encoded(alpha, ".png"), manifest), "colour type 6");
  cv::Mat real(kHeightPx, kWidthPx, CV_32FC1, cv::Scalar(1));
  expect_refused(read_bytes(encoded(real, ".tiff"), manifest), "TIFF with 32 bits a sample");
  cv::Mat bytes(kHeightPx, kWidthPx, CV_8UC1, cv::Scalar(1));
  expect_refused(read_bytes(encoded(bytes, ".png", {cv::IMWRITE_PNG_BILEVEL, 1}), manifest),
                 "PNG of 1 bits");
  expect_refused(read_bytes(encoded(bytes, ".jpg"), manifest), "neither TIFF nor PNG");
}

// The position of a tag's value in one of our TIFFs.
std::size_t value_of_tag(const std::vector<std::byte>& tiff, unsigned tag) {
  for (std::size_t entry = 10; entry + 12 <= tiff.size(); entry += 12) {
    const unsigned found =
        std::to_integer<unsigned>(tiff[entry]) | std::to_integer<unsigned>(tiff[entry + 1]) << 8U;
    if (found == tag) return entry + 8;
  }
  ADD_FAILURE() << "no tag " << tag;
  return 0;
}

TEST(FrameIo, TiffTagsThatWouldBeMisreadAreRefused) {
  const Image<std::uint16_t> frame = random_frame({ColorFilter::kRgb, 16}, 14);
  const auto tiff = encode_frame_tiff(frame.view(), 16).value();
  const struct {
    unsigned tag;
    int value;
    const char* message;
  } cases[] = {{262, 1, "photometric interpretation 1"},
               {284, 2, "separate colour planes"},
               {339, 2, "no unsigned integers"},
               {259, 7, "compression 7"},
               {277, 4, "4 channels"}};
  for (const auto& broken : cases) {
    auto bytes = tiff;
    bytes[value_of_tag(tiff, broken.tag)] = static_cast<std::byte>(broken.value);
    expect_refused(read_bytes(bytes, manifest_of("RGB16")), broken.message);
  }
}

// OpenCV makes room for a whole strip: found by tests/fuzz.
TEST(FrameIo, AStripOfFarMoreRowsThanTheFrameIsRefused) {
  const Image<std::uint16_t> frame = random_frame({ColorFilter::kMono, 16}, 15);
  auto tiff = encode_frame_tiff(frame.view(), 16).value();
  const std::size_t rows = value_of_tag(tiff, 278);
  tiff[rows + 2] = std::byte{0x7f};
  expect_refused(read_bytes(tiff, manifest_of("Mono16")), "strips of 8323079 rows");
  for (std::size_t i = 0; i < 4; ++i) tiff[rows + i] = std::byte{0xff};  // the format's "all"
  EXPECT_TRUE(read_bytes(tiff, manifest_of("Mono16")));
}

TEST(FrameIo, AHeaderThatAsksForTooMuchIsRefusedBeforeDecoding) {
  const Image<std::uint16_t> frame = random_frame({ColorFilter::kMono, 16}, 15);
  auto tiff = encode_frame_tiff(frame.view(), 16).value();
  const std::size_t width = value_of_tag(tiff, 256);
  tiff[width + 2] = std::byte{0x0f};  // 983053 px
  const auto read = read_bytes(tiff, manifest_of("Mono16"));
  expect_refused(read, "is truncated");
}

TEST(FrameIo, RandomDamageNeverEndsTheProgram) {
  const Manifest manifest = manifest_of("RGB16");
  const Image<std::uint16_t> frame = random_frame(manifest.camera.pixel_format, 16);
  const cv::Mat mat = bgr_of(frame, 16);
  std::mt19937_64 random(17);
  for (const auto& whole :
       {encode_frame_tiff(frame.view(), 16).value(),
        encoded(mat, ".tiff", {cv::IMWRITE_TIFF_COMPRESSION, 5}), encoded(mat, ".png")}) {
    for (int draw = 0; draw < 400; ++draw) {
      std::vector<std::byte> bytes = whole;
      // Half of the damage goes to the first 200 bytes, where our headers are; OpenCV's are last.
      for (int i = 0; i < 3; ++i) {
        const std::size_t reach =
            draw % 2 == 0 ? bytes.size() : std::min<std::size_t>(200, bytes.size());
        bytes[draw % 4 == 1 ? bytes.size() - 1 - random() % reach : random() % reach] =
            static_cast<std::byte>(random());
      }
      const auto read = read_bytes(bytes, manifest);
      if (!read) {
        EXPECT_FALSE(read.error().expectation.empty());
      }
    }
  }
}

TEST(FrameIo, AViewWithAStrideIsEncodedRowByRow) {
  const Image<std::uint16_t> frame = random_frame({ColorFilter::kMono, 16}, 18);
  ImageView<const std::uint16_t> part = frame.view();
  part.data += 2;
  part.width_px = 5;
  const auto read = read_bytes(encode_frame_tiff(part, 16).value(), manifest_of("Mono16", 5));
  ASSERT_TRUE(read) << read.error().text();
  for (int row = 0; row < kHeightPx; ++row) {
    for (int col = 0; col < 5; ++col) EXPECT_EQ(read->at(row, col), frame.at(row, col + 2));
  }
}

TEST(FrameIo, WhatCannotBeEncodedIsAnError) {
  const Image<std::uint16_t> frame(2, 2, 1, 300);
  EXPECT_FALSE(encode_frame_tiff(frame.view(), 8));
  EXPECT_FALSE(encode_frame_tiff(frame.view(), 10));
  EXPECT_FALSE(encode_frame_tiff({}, 8));
  EXPECT_FALSE(encode_frame_tiff(Image<std::uint16_t>(2, 2, 2).view(), 8));
}

}  // namespace
}  // namespace estimation
