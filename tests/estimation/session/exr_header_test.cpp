#include "estimation/session/exr_header.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <string_view>

#include "estimation/session/exr.h"

namespace estimation {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

std::string number(std::uint32_t value) {
  std::string bytes(sizeof value, '\0');
  for (char& byte : bytes) {
    byte = static_cast<char>(value & 255U);
    value >>= 8U;
  }
  return bytes;
}

std::string attribute(std::string_view name, std::string_view type, const std::string& value) {
  return std::string(name) + '\0' + std::string(type) + '\0' +
         number(static_cast<std::uint32_t>(value.size())) + value;
}

std::string file_of(const std::string& attributes, std::uint32_t version = 2) {
  return number(20000630) + number(version) + attributes + '\0';
}

std::string objection_to(const std::string& file) {
  const auto* first = reinterpret_cast<const std::byte*>(file.data());
  return objection_to_exr_headers({first, first + file.size()});
}

const std::string kChannels =
    attribute("channels", "chlist", std::string("Y") + std::string(17, '\0') + '\0');

TEST(ExrHeader, SoundAttributesPass) {
  EXPECT_THAT(
      objection_to(file_of(kChannels + attribute("dataWindow", "box2i", std::string(16, 0)) +
                           attribute("method", "string", "likelihood") +
                           attribute("lens", "vendor", "anything"))),
      IsEmpty());
}

TEST(ExrHeader, ATextLongerThanTheFileIsRefused) {
  const std::string claim = std::string("note") + '\0' + "string" + '\0' + number(2'000'000'000);
  EXPECT_THAT(objection_to(file_of(kChannels + claim)), HasSubstr("beyond the end of the file"));
}

// OpenEXR reads 16 bytes whatever the length says, and takes what follows for attributes.
TEST(ExrHeader, AValueOfAnotherLengthThanItsTypeIsDamaged) {
  EXPECT_THAT(objection_to(file_of(attribute("dataWindow", "box2i", std::string(12, 0)))),
              HasSubstr("dataWindow"));
  EXPECT_THAT(objection_to(file_of(attribute("channels", "chlist", "Y"))), HasSubstr("channels"));
  EXPECT_THAT(objection_to(file_of(attribute("preview", "preview", number(30000) + number(30000)))),
              HasSubstr("preview"));
  EXPECT_THAT(objection_to(file_of(attribute("views", "stringvector", number(9) + "left"))),
              HasSubstr("views"));
}

TEST(ExrHeader, TruncatedHeadersAreRefusedWhereverTheyEnd) {
  constexpr std::uint32_t kMultiPart = 0x1002;
  const std::string parts = file_of(kChannels + '\0' + kChannels, kMultiPart) + '\0';
  EXPECT_THAT(objection_to(parts), IsEmpty());
  for (std::size_t length = 0; length < parts.size(); ++length)
    EXPECT_NE(objection_to(parts.substr(0, length)), "") << length;
}

// 6 kB that ask for 1.6 GB of samples.
TEST(ExrHeader, AFileIsNotAllocatedMoreThanItCanHold) {
  const std::string window = number(0) + number(0) + number(9999) + number(9999);
  std::string channels;
  for (const char* name : {"A", "B", "C", "D"}) {
    channels.append(name, 2).append(number(2)).append(4, '\0');
    channels.append(number(1)).append(number(1));
  }
  std::string file = file_of(attribute("channels", "chlist", channels + '\0') +
                             attribute("compression", "compression", std::string(1, 3)) +
                             attribute("dataWindow", "box2i", window) +
                             attribute("displayWindow", "box2i", window) +
                             attribute("lineOrder", "lineOrder", std::string(1, 0)) +
                             attribute("pixelAspectRatio", "float", number(0x3F800000)) +
                             attribute("screenWindowCenter", "v2f", std::string(8, 0)) +
                             attribute("screenWindowWidth", "float", number(0x3F800000)));
  for (int block = 0; block < 625; ++block) file += number(400) + number(0);  // where its lines are
  ASSERT_THAT(objection_to(file), IsEmpty());
  const auto* first = reinterpret_cast<const std::byte*>(file.data());
  const auto decoded = decode_exr({first, first + file.size()}, "a.exr");
  ASSERT_FALSE(decoded);
  EXPECT_THAT(decoded.error().text(), HasSubstr("bytes cannot hold"));
}

}  // namespace
}  // namespace estimation
