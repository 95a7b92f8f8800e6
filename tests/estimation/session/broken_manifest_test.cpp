// Manifests that are wrong, each in one way: each gets an error that names the file, the place,
// what was found and what was expected.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

#include "estimation/session/manifest.h"
#include "session_folder.h"

namespace estimation {
namespace {

using nlohmann::json;
using testing::HasSubstr;

// The example with every optional key present, so that each can be broken.
json full_document() {
  json document = example_document();
  document["state"] = "failed";
  document["failure"] = {{"code", "a"}, {"slots", {"b"}}, {"text", "c"}};
  document["camera"]["roi"] = {2, 4};
  document["camera"]["flat_field"] = "flat.exr";
  document["camera"]["dark_frames"] = {{{"exposure_us", 10}, {"file", "dark.png"}}};
  document["projector"]["sync_square"] = {0, 0, 32, 32};
  json& calibration = document["calibration"];
  calibration["camera"]["distortion"] = {0, 0, 0, 0, 0};
  calibration["projector"]["distortion"] = {0, 0, 0, 0, 0};
  calibration["irradiance"]["vignetting"] = "vignetting.exr";
  calibration["projector_black"] = {0.1, 0.1, 0.1};
  calibration["stripe_transfer"] = {{{"distance_mm", 900}, {"transfer", {0.9, 0.8}}}};
  calibration["color_matrix"] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  document["patterns"] = {
      {{"index", 0},
       {"kind", "stripes"},
       {"axis", "column"},
       {"period_px", 40},
       {"width_px", 8},
       {"shift_px", 0}},
      {{"index", 1}, {"kind", "gray_code"}, {"axis", "row"}, {"bit", 3}, {"inverted", false}},
      {{"index", 2}, {"kind", "fringe"}, {"axis", "row"}, {"period_px", 9.5}, {"shift_px", 0.5}},
      {{"index", 3}, {"kind", "white"}},
      {{"index", 4}, {"kind", "image"}, {"file", "a.png"}}};
  document["frames"] = {{{"pattern", 0},
                         {"exposure_us", 16667},
                         {"file", "frames/000_0.tiff"},
                         {"frame_id", 1},
                         {"camera_timestamp_ns", 2},
                         {"edge_timestamp_ns", 3},
                         {"sha256", std::string(64, '0')}}};
  return document;
}

TEST(BrokenManifest, TheUnbrokenOneIsFine) {
  const auto manifest = parse_manifest(full_document().dump(), "session.json");
  EXPECT_TRUE(manifest) << manifest.error().text();
}

// Breaks one place and expects the error to be about it.
void expect_error(const std::string& pointer, const json& document,
                  const std::string& expected_place) {
  const auto manifest = parse_manifest(document.dump(), "a/session.json");
  ASSERT_FALSE(manifest) << pointer << " was accepted: "
                         << document.value(json::json_pointer(pointer), json());
  const InputError& error = manifest.error();
  EXPECT_EQ(error.fault, InputFault::kInvalid);
  EXPECT_EQ(error.place, expected_place) << error.text();
  EXPECT_TRUE(error.text().starts_with("a/session.json: " + expected_place + ": ")) << error.text();
  EXPECT_THAT(error.expectation, HasSubstr("; expected ")) << pointer;
}

void expect_refused(const std::string& pointer, const json& value) {
  SCOPED_TRACE(pointer + " = " + value.dump().substr(0, 80));
  json document = full_document();
  document[json::json_pointer(pointer)] = value;
  expect_error(pointer, document, pointer);
}

TEST(BrokenManifest, EachMissingRequiredKeyIsNamed) {
  for (const char* pointer : {"/format",
                              "/id",
                              "/created",
                              "/camera",
                              "/camera/width",
                              "/camera/height",
                              "/camera/pixel_format",
                              "/camera/dark_frames/0/exposure_us",
                              "/camera/dark_frames/0/file",
                              "/projector",
                              "/projector/width",
                              "/projector/height",
                              "/calibration",
                              "/calibration/camera",
                              "/calibration/camera/K",
                              "/calibration/projector",
                              "/calibration/projector/K",
                              "/calibration/projector/R",
                              "/calibration/projector/t",
                              "/calibration/stripe_transfer/0/distance_mm",
                              "/calibration/stripe_transfer/0/transfer",
                              "/patterns",
                              "/patterns/0/index",
                              "/patterns/0/kind",
                              "/patterns/0/axis",
                              "/patterns/0/period_px",
                              "/patterns/0/width_px",
                              "/patterns/0/shift_px",
                              "/patterns/1/axis",
                              "/patterns/1/bit",
                              "/patterns/1/inverted",
                              "/patterns/2/period_px",
                              "/patterns/2/shift_px",
                              "/patterns/4/file",
                              "/frames",
                              "/frames/0/pattern",
                              "/frames/0/exposure_us",
                              "/frames/0/file"}) {
    SCOPED_TRACE(pointer);
    json document = full_document();
    const json::json_pointer place(pointer);
    document[place.parent_pointer()].erase(place.back());
    expect_error(pointer, document, pointer);
    const auto error = parse_manifest(document.dump(), "s").error();
    EXPECT_THAT(error.expectation, HasSubstr("is missing; expected "));
  }
}

// Every known key of the document, containers and leaves alike.
void collect_places(const json& value, const std::string& pointer,
                    std::vector<std::string>& places) {
  if (!pointer.empty()) places.push_back(pointer);
  if (!value.is_structured()) return;
  for (const auto& [key, child] : value.items()) {
    std::string child_pointer = pointer;
    child_pointer.append("/").append(key);
    collect_places(child, child_pointer, places);
  }
}

TEST(BrokenManifest, EachValueOfTheWrongTypeIsNamed) {
  const json document = full_document();
  std::vector<std::string> places;
  collect_places(document, "", places);
  EXPECT_GT(places.size(), 120U);
  const std::vector<json> values{nullptr, true, "text", 17, -1.5, json::array(), json::object()};
  for (const std::string& place : places) {
    const json& right = document[json::json_pointer(place)];
    for (const json& wrong : values) {
      if (std::string_view(wrong.type_name()) == right.type_name()) continue;
      if (place == "/failure/slots/0") continue;  // of any type
      SCOPED_TRACE(place + " = " + wrong.dump());
      json broken = document;
      broken[json::json_pointer(place)] = wrong;
      const auto manifest = parse_manifest(broken.dump(), "session.json");
      const bool is_also_a_transfer = place == "/calibration/stripe_transfer" && wrong.is_string();
      if (is_also_a_transfer) continue;
      ASSERT_FALSE(manifest);
      // The value itself, or the first thing missing in it.
      EXPECT_TRUE(manifest.error().place.starts_with(place)) << manifest.error().text();
      EXPECT_THAT(manifest.error().expectation, HasSubstr("; expected "));
    }
  }
}

TEST(BrokenManifest, EachValueOutOfRangeIsNamed) {
  expect_refused("/format", 2);
  expect_refused("/format", 0);
  expect_refused("/id", "");
  for (const char* created : {"", "yesterday", "2026-13-01T00:00:00Z", "2026-01-32T00:00:00Z",
                              "2026-01-01T24:00:00Z", "2026-01-01T00:00:00", "2026-01-01",
                              "2026-01-01T00:00:00.Z", "2026-01-01T00:00:00+01:00"}) {
    expect_refused("/created", created);
  }
  expect_refused("/state", "finished");
  for (const char* side :
       {"/camera/width", "/camera/height", "/projector/width", "/projector/height"}) {
    for (const json& value : {json(0), json(-64), json(65536), json(64.5), json(1e300),
                              json(18446744073709551615ULL)}) {
      expect_refused(side, value);
    }
  }
  for (const char* format : {"Mono10", "BayerRG12p", "mono8", "", "RGB12"}) {
    expect_refused("/camera/pixel_format", format);
  }
  expect_refused("/camera/roi", {1});
  expect_refused("/camera/roi/0", -1);
  expect_refused("/camera/black_level", -1);
  expect_refused("/camera/black_level", 4096);
  expect_refused("/camera/saturation_level", 64);
  expect_refused("/camera/saturation_level", 0);
  expect_refused("/camera/gain_e_per_dn", 0);
  expect_refused("/camera/read_noise_e", -0.1);
  expect_refused("/camera/dark_frames/0/exposure_us", 0);
  expect_refused("/projector/sync_square", {1000, 0, 32, 32});
  expect_refused("/projector/sync_square", {0, 740, 32, 32});
  expect_refused("/projector/sync_square", {0, 0, 32});
  expect_refused("/projector/sync_square/2", 0);
}

TEST(BrokenManifest, AnAreaTooLargeToAllocateIsNamed) {
  json document = full_document();
  document["camera"]["width"] = 65535;
  document["camera"]["height"] = 65535;
  expect_error("/camera/height", document, "/camera/height");
}

TEST(BrokenManifest, EachCalibrationOutOfRangeIsNamed) {
  for (const char* lens : {"/calibration/camera", "/calibration/projector"}) {
    const std::string K = std::string(lens) + "/K";
    expect_refused(K, {{0, 0, 31}, {0, 200, 23}, {0, 0, 1}});
    expect_refused(K, {{200, 0, 31}, {0, -200, 23}, {0, 0, 1}});
    expect_refused(K, {{200, 3, 31}, {0, 200, 23}, {0, 0, 1}});
    expect_refused(K, {{200, 0, 31}, {0, 200, 23}, {0, 0, 0}});
    expect_refused(K, {{200, 0, 31}, {0, 200, 23}});
    expect_refused(K + "/1", {0, 200});
    expect_refused(std::string(lens) + "/distortion", {0, 0, 0, 0});
  }
  expect_refused("/calibration/projector/R", {{1, 0, 0}, {0, 1, 0}, {0, 0, 1.01}});
  expect_refused("/calibration/projector/R", {{1, 0, 0}, {0, 1, 0}, {0, 0, -1}});  // a mirror
  expect_refused("/calibration/projector/R", {{1, 0.01, 0}, {0, 1, 0}, {0, 0, 1}});
  expect_refused("/calibration/projector/t", {1, 2});
  expect_refused("/calibration/irradiance/signal_per_us", {1, 2});
  expect_refused("/calibration/irradiance/signal_per_us", {1});  // a colour camera
  expect_refused("/calibration/irradiance/signal_per_us/1", 0);
  expect_refused("/calibration/irradiance/reference_distance_mm", 0);
  expect_refused("/calibration/projector_black", json::array());
  expect_refused("/calibration/projector_black/2", -0.1);
  expect_refused("/calibration/projector_black/2", 0.9);  // more than white adds
  expect_refused("/calibration/stripe_transfer", {{{"distance_mm", 9}, {"transfer", {1}}},
                                                  {{"distance_mm", 9}, {"transfer", {1}}}});
  expect_refused("/calibration/stripe_transfer/0/distance_mm", 0);
  expect_refused("/calibration/stripe_transfer/0/transfer", json::array());
  expect_refused("/calibration/stripe_transfer/0/transfer/1", 1.2);  // optics add no contrast
  expect_refused("/calibration/stripe_transfer/0/transfer/1", -0.5);
  expect_refused("/calibration/color_matrix/0", {1, 2});
}

TEST(BrokenManifest, AMonoCamerasColoursMustBeEqual) {
  json document = full_document();
  document["camera"]["pixel_format"] = "Mono12";
  expect_error("signal", document, "/calibration/irradiance/signal_per_us");
  document["calibration"]["irradiance"]["signal_per_us"] = {0.2};
  document["calibration"]["projector_black"] = {0.1, 0.1, 0.2};
  expect_error("black", document, "/calibration/projector_black");
  document["calibration"]["projector_black"] = {0.1};
  document["calibration"]["stripe_transfer"] = {{"R", {0.9}}, {"G", {0.8}}, {"B", {0.9}}};
  expect_error("transfer", document, "/calibration/stripe_transfer");
}

TEST(BrokenManifest, EachPatternOutOfRangeIsNamed) {
  expect_refused("/patterns/1/index", 0);  // taken
  expect_refused("/patterns/0/index", -1);
  expect_refused("/patterns/0/kind", "strips");
  expect_refused("/patterns/0/axis", "diagonal");
  expect_refused("/patterns/0/period_px", 0);
  expect_refused("/patterns/0/period_px", -40);
  expect_refused("/patterns/0/width_px", 0);
  expect_refused("/patterns/0/width_px", 41);
  expect_refused("/patterns/0/shift_px", 0.5);
  expect_refused("/patterns/0/shift_px", 2147483648LL);
  expect_refused("/patterns/1/bit", 31);
  expect_refused("/patterns/1/bit", -1);
  expect_refused("/patterns/2/period_px", 0);
}

TEST(BrokenManifest, EachFrameOutOfRangeIsNamed) {
  expect_refused("/frames/0/pattern", 88);
  expect_refused("/frames/0/exposure_us", 0);
  expect_refused("/frames/0/exposure_us", -5);
  expect_refused("/frames/0/frame_id", -1);
  expect_refused("/frames/0/sha256", "abc");
  expect_refused("/frames/0/sha256", std::string(64, 'g'));
}

TEST(BrokenManifest, EachFileNameThatLeadsOutIsNamed) {
  for (const char* pointer :
       {"/camera/dark_frames/0/file", "/camera/flat_field", "/calibration/irradiance/vignetting",
        "/calibration/stripe_transfer", "/patterns/4/file", "/frames/0/file"}) {
    for (const char* name : {"/etc/passwd", "../a.tiff", "frames/../../a.tiff", ""}) {
      expect_refused(pointer, name);
    }
    expect_refused(pointer, std::string("a\0b", 3));
  }
}

// Text that is no JSON --------------------------------------------------------------------------

InputError error_of(const std::string& text) {
  const auto manifest = parse_manifest(text, "session.json");
  EXPECT_FALSE(manifest);
  return manifest ? InputError{} : manifest.error();
}

TEST(BrokenJson, ASyntaxErrorHasLineAndColumn) {
  const InputError error = error_of("{\"format\": 1,\n \"id\": nonsense}");
  EXPECT_EQ(error.file, "session.json");
  EXPECT_EQ(error.place, "line 2, column 9") << error.text();
  EXPECT_THAT(error.expectation, HasSubstr("expected a valid JSON document"));
}

TEST(BrokenJson, AnEmptyOrCutFileIsAnError) {
  EXPECT_THAT(error_of("").place, HasSubstr("line 1"));
  const std::string text = example_document().dump(1);
  for (std::size_t size = 0; size < text.size(); size += 997) {
    EXPECT_THAT(error_of(text.substr(0, size)).place, HasSubstr("line ")) << size;
  }
}

TEST(BrokenJson, NumbersNoDoubleHoldsAreErrors) {
  EXPECT_THAT(error_of(R"({"format": 1e999})").expectation, HasSubstr("1e999"));
  EXPECT_THAT(error_of(R"({"format": NaN})").place, HasSubstr("column 12"));
  EXPECT_THAT(error_of(R"({"format": 99999999999999999999999999})").place, "/format");
}

TEST(BrokenJson, InvalidUtf8IsAnError) {
  EXPECT_THAT(error_of("{\"id\": \"a\xff\"}").expectation, HasSubstr("UTF-8"));
  EXPECT_THAT(error_of("{\"id\": \"\xed\xa0\x80\"}").expectation, HasSubstr("UTF-8"));
}

TEST(BrokenJson, DeepNestingIsAnError) {
  EXPECT_THAT(error_of(std::string(1000000, '[')).expectation, HasSubstr("nested deeper than 64"));
  std::string objects;
  for (int i = 0; i < 100000; ++i) objects += "{\"a\":";
  EXPECT_THAT(error_of(objects).expectation, HasSubstr("nested deeper than 64"));
}

TEST(BrokenJson, AKeyGivenTwiceIsAnError) {
  EXPECT_THAT(error_of(R"({"format": 1, "format": 1})").expectation, HasSubstr("\"format\""));
}

TEST(BrokenJson, MoreKeysThanAnyManifestHasIsAnError) {
  json object;
  for (int i = 0; i < 2000; ++i) object[std::to_string(i)] = i;
  EXPECT_THAT(error_of(object.dump()).expectation, HasSubstr("more than 1000 keys"));
}

TEST(BrokenJson, OtherDocumentsAreErrors) {
  for (const char* text : {"null", "1", "\"a\"", "[]", "[1, 2]", "true"}) {
    EXPECT_THAT(error_of(text).expectation, HasSubstr("expected an object")) << text;
    EXPECT_EQ(error_of(text).place, "/");
  }
}

TEST(BrokenJson, RandomDamageNeverEndsTheProgram) {
  const std::string text = full_document().dump();
  std::mt19937_64 random(3);
  int refused_count = 0;
  for (int draw = 0; draw < 3000; ++draw) {
    std::string damaged = text;
    for (int i = 0; i < 3; ++i) damaged[random() % damaged.size()] = static_cast<char>(random());
    const auto manifest = parse_manifest(damaged, "session.json");
    if (manifest) {
      static_cast<void>(format_manifest(*manifest));
    } else {
      ++refused_count;
      EXPECT_FALSE(manifest.error().expectation.empty());
    }
  }
  EXPECT_GT(refused_count, 2000);
}

TEST(BrokenManifest, AValueQuotedInAMessageStaysShortAndOnOneLine) {
  json document = full_document();
  std::string name(500, 'x');
  name.insert(4, "\n\"");
  document["camera"]["pixel_format"] = name;
  const auto manifest = parse_manifest(document.dump(), "session.json");
  ASSERT_FALSE(manifest);
  EXPECT_EQ(manifest.error().text().find('\n'), std::string::npos);
  EXPECT_LT(manifest.error().text().size(), 300U);
}

// Files -----------------------------------------------------------------------------------------

TEST(ReadManifest, AMissingSessionNamesTheFile) {
  const auto manifest = read_manifest("/nowhere/session");
  ASSERT_FALSE(manifest);
  EXPECT_EQ(manifest.error().fault, InputFault::kNotFound);
  EXPECT_EQ(manifest.error().file, "/nowhere/session/session.json");
}

TEST(ReadManifest, AFolderInItsPlaceIsAnError) {
  const TemporaryFolder folder;
  std::filesystem::create_directory(folder.path() / "session.json");
  const auto manifest = read_manifest(folder.path());
  ASSERT_FALSE(manifest);
  EXPECT_EQ(manifest.error().fault, InputFault::kUnreadable);
  EXPECT_THAT(manifest.error().text(), HasSubstr("regular file"));
}

TEST(ReadManifest, AFileTooLargeToBeAManifestIsNotRead) {
  const TemporaryFolder folder;
  write_text(folder.path() / "session.json", "{}");
  std::filesystem::resize_file(folder.path() / "session.json", std::uintmax_t{1} << 30U);
  const auto manifest = read_manifest(folder.path());
  ASSERT_FALSE(manifest);
  EXPECT_THAT(manifest.error().text(), HasSubstr("1073741824 bytes"));
}

}  // namespace
}  // namespace estimation
