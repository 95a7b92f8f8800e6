// Manifests that are right: what they mean, and that writing them loses nothing.
#include "estimation/session/manifest.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "session_folder.h"

namespace estimation {
namespace {

using nlohmann::json;

Manifest parsed(const json& document) {
  const auto manifest = parse_manifest(document.dump(), "session.json");
  EXPECT_TRUE(manifest) << manifest.error().text();
  return manifest.value_or(Manifest{});
}

TEST(Manifest, TheReferenceSessionIsRead) {
  const auto manifest = read_manifest(example_session());
  ASSERT_TRUE(manifest) << manifest.error().text();
  EXPECT_EQ(manifest->id, "session_example");
  EXPECT_EQ(manifest->state, SessionState::kComplete);
  EXPECT_EQ(manifest->camera.width_px, 64);
  EXPECT_EQ(manifest->camera.height_px, 48);
  EXPECT_EQ(manifest->camera.pixel_format, (PixelFormat{ColorFilter::kBayerRG, 12}));
  EXPECT_EQ(manifest->camera.black_level_dn, 64.0);
  EXPECT_EQ(manifest->calibration.irradiance->signal_per_us,
            (std::vector<double>{0.2, 0.19, 0.17}));
  EXPECT_DOUBLE_EQ(manifest->calibration.projector_from_camera_mm[0], 242.53562503633296);
  EXPECT_DOUBLE_EQ(manifest->calibration.projector_from_camera(0, 2), -0.24253562503633297);
  EXPECT_EQ(manifest->patterns.size(), 88U);
  ASSERT_EQ(manifest->frames.size(), 176U);
  EXPECT_EQ(manifest->frames[1].exposure_us, 66667.0);
  EXPECT_EQ(manifest->other_keys, "");
}

// Every value of `before` is in `after`, at the same place.
void expect_contains(const json& after, const json& before, const std::string& place) {
  SCOPED_TRACE(place);
  if (before.is_object()) {
    for (const auto& [key, value] : before.items()) {
      ASSERT_TRUE(after.contains(key)) << place << "/" << key;
      std::string child_place = place;
      child_place.append("/").append(key);
      expect_contains(after[key], value, child_place);
    }
  } else if (before.is_array()) {
    ASSERT_EQ(after.size(), before.size());
    for (std::size_t i = 0; i < before.size(); ++i) {
      expect_contains(after[i], before[i], place + "/" + std::to_string(i));
    }
  } else {
    EXPECT_EQ(after, before);
  }
}

void expect_round_trip(const json& document) {
  const std::string written = format_manifest(parsed(document));
  expect_contains(json::parse(written), document, "");
  EXPECT_EQ(format_manifest(parsed(json::parse(written))), written);
}

TEST(Manifest, TheReferenceSessionSurvivesARewrite) { expect_round_trip(example_document()); }

// Seeded random manifests with every optional key present or absent -----------------------------

class RandomDocument {
 public:
  explicit RandomDocument(std::uint64_t seed) : random_(seed) {}

  json make() {
    is_mono_ = flip();
    json document{{"format", 1},
                  {"id", "s" + std::to_string(random_())},
                  {"created", "2026-01-31T23:59:59Z"},
                  {"camera", camera()},
                  {"projector", {{"width", 1024}, {"height", 768}}},
                  {"calibration", calibration()},
                  {"patterns", patterns()},
                  {"frames", json::array()}};
    if (flip()) document["projector"]["sync_square"] = {1, 2, 30, 40};
    for (const char* key : {"subject", "notes", "software", "plan", "unknown_text"}) {
      if (flip()) document[key] = "text \u00e4 " + std::to_string(random_());
    }
    if (flip()) document["state"] = pick({"capturing", "complete", "interrupted", "aborted"});
    if (flip()) {
      document["failure"] = {{"code", "kFrameLost"}, {"slots", {"pattern 1"}}, {"text", "lost"}};
    }
    for (const json& pattern : document["patterns"]) add_frames(document, pattern["index"]);
    return document;
  }

 private:
  bool flip() { return random_() % 2 == 0; }
  int whole(int lowest, int highest) {
    return lowest + static_cast<int>(random_() % static_cast<std::uint64_t>(highest - lowest + 1));
  }
  double real() { return static_cast<double>(random_() % 1000000 + 1) / 1024.0; }
  static constexpr double kGreatestReal = 1000;
  std::string pick(const std::vector<std::string>& names) {
    return names[random_() % names.size()];
  }

  json camera() {
    const std::string mono = pick({"Mono8", "Mono12", "Mono16"});
    const std::string colour = pick({"BayerRG8", "BayerGR12", "BayerGB16", "BayerBG12", "RGB16"});
    json camera{{"width", whole(1, 4000)},
                {"height", whole(1, 4000)},
                {"pixel_format", is_mono_ ? mono : colour}};
    if (flip()) camera["roi"] = {whole(0, 9), whole(0, 9)};
    if (flip()) camera["black_level"] = 16;
    if (flip()) camera["saturation_level"] = 250.5;
    if (flip()) camera["dark_frames"] = {{{"exposure_us", real()}, {"file", "d/1.png"}, {"x", 1}}};
    if (flip()) camera["gain_e_per_dn"] = real();
    if (flip()) camera["read_noise_e"] = real();
    if (flip()) camera["flat_field"] = "flat.exr";
    if (flip()) camera["vendor"] = {{"serial", "x"}, {"temperature_c", {1, 2}}};
    return camera;
  }

  json bands(double least) {
    json values = json::array();
    for (int band = 0; band < (is_mono_ ? 1 : 3); ++band) values.push_back(least + real());
    return values;
  }

  json transfer_by_band() {
    if (is_mono_ || flip()) return {0.9, 0.8, 0.5};
    return {{"R", {0.9, 0.8}}, {"G", {0.9}}, {"B", {0.7, 0.1, 0.0}}};
  }

  json calibration() {
    const json K{{real(), 0, real()}, {0, real(), real()}, {0, 0, 1}};
    const double angle_rad = real();
    const double c = std::cos(angle_rad);
    const double s = std::sin(angle_rad);
    json calibration{
        {"camera", {{"K", K}}},
        {"projector",
         {{"K", K}, {"R", {{c, 0, s}, {0, 1, 0}, {-s, 0, c}}}, {"t", {real(), -real(), real()}}}}};
    if (flip()) calibration["camera"]["distortion"] = {0.1, -0.2, 0.001, 0, 1e-9};
    if (flip()) calibration["projector"]["lens_name"] = "50 mm";
    if (flip()) {
      calibration["irradiance"] = {{"signal_per_us", bands(kGreatestReal)}};
      if (flip()) calibration["irradiance"]["reference_distance_mm"] = real();
      if (flip()) calibration["irradiance"]["vignetting"] = "v.exr";
      if (flip()) calibration["irradiance"]["standard"] = "SRS-99";
    }
    if (flip()) calibration["projector_black"] = bands(0);
    if (flip()) calibration["color_matrix"] = {{1, 0.5, 0}, {0, 1, -0.5}, {0, 0, 1}};
    switch (whole(0, 3)) {
      case 0:
        calibration["stripe_transfer"] = transfer_by_band();
        break;
      case 1:
        calibration["stripe_transfer"] = {
            {{"distance_mm", 900}, {"transfer", transfer_by_band()}, {"note", "near"}},
            {{"distance_mm", 1100.5}, {"transfer", transfer_by_band()}}};
        break;
      case 2:
        calibration["stripe_transfer"] = "transfer.exr";
        break;
      default:
        break;
    }
    return calibration;
  }

  json pattern_kind() {
    const std::string axis = pick({"column", "row"});
    switch (whole(0, 5)) {
      case 0:
        return {{"kind", "stripes"},
                {"axis", axis},
                {"period_px", 40},
                {"width_px", whole(1, 40)},
                {"shift_px", whole(-50, 50)}};
      case 1:
        return {{"kind", "gray_code"}, {"axis", axis}, {"bit", whole(0, 30)}, {"inverted", flip()}};
      case 2:
        return {{"kind", "fringe"}, {"axis", axis}, {"period_px", real()}, {"shift_px", -real()}};
      case 3:
        return {{"kind", "white"}};
      case 4:
        return {{"kind", "black"}};
      default:
        return {{"kind", "image"}, {"file", "p/a.png"}};
    }
  }

  json patterns() {
    json list = json::array();
    int index = whole(0, 5);
    for (int i = whole(0, 12); i > 0; --i) {
      json pattern = pattern_kind();
      pattern["index"] = index;
      if (flip()) pattern["label"] = "p" + std::to_string(index);
      index += whole(1, 3);
      list.insert(list.begin() + whole(0, static_cast<int>(list.size())), pattern);
    }
    return list;
  }

  void add_frames(json& document, int pattern) {
    for (int bracket = whole(0, 3); bracket > 0; --bracket) {
      json frame{{"pattern", pattern},
                 {"exposure_us", real()},
                 {"file", "frames/" + std::to_string(document["frames"].size()) + ".tiff"}};
      if (flip()) frame["frame_id"] = random_();
      if (flip()) frame["camera_timestamp_ns"] = static_cast<std::int64_t>(random_() >> 1U);
      if (flip()) frame["edge_timestamp_ns"] = -5;
      if (flip()) frame["sha256"] = std::string(64, 'a');
      if (flip()) frame["temperature_c"] = real();
      document["frames"].push_back(frame);
    }
  }

  std::mt19937_64 random_;
  bool is_mono_ = false;
};

TEST(Manifest, RandomManifestsSurviveARewriteWithTheirUnknownKeys) {
  for (std::uint64_t seed = 0; seed < 300; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    expect_round_trip(RandomDocument(seed).make());
    if (HasFailure()) break;
  }
}

TEST(Manifest, UnknownKeysFollowTheirElementWhenTheListChanges) {
  json document = example_document();
  document["frames"][2]["lamp"] = "warm";
  document["patterns"][5]["label"] = "five";
  Manifest manifest = parsed(document);
  std::swap(manifest.frames[2], manifest.frames[7]);
  manifest.patterns.erase(manifest.patterns.begin() + 5);
  std::erase_if(manifest.frames, [](const FrameRecord& frame) { return frame.pattern == 5; });
  const json written = json::parse(format_manifest(manifest));
  EXPECT_EQ(written["frames"][7]["lamp"], "warm");
  EXPECT_FALSE(written["frames"][2].contains("lamp"));
  for (const json& pattern : written["patterns"]) EXPECT_FALSE(pattern.contains("label"));
}

TEST(Manifest, ChangedValuesWinOverWhatWasRead) {
  json document = example_document();
  document["state"] = "interrupted";
  Manifest manifest = parsed(document);
  manifest.state = SessionState::kComplete;
  manifest.camera.roi_x_px = 3;
  manifest.other_keys = R"({"rig_file": "rig.toml", "camera": {"roi": [9, 9], "lens": "a"}})";
  const json written = json::parse(format_manifest(manifest));
  EXPECT_EQ(written["state"], "complete");
  EXPECT_EQ(written["camera"]["roi"], (json{3, 0}));
  EXPECT_EQ(written["camera"]["lens"], "a");
  EXPECT_EQ(written["rig_file"], "rig.toml");
}

TEST(Manifest, RequiredKeysComeFirstAndAFrameTakesOneLine) {
  const std::string text = format_manifest(parsed(example_document()));
  EXPECT_TRUE(text.starts_with("{\n  \"format\": 1,\n  \"id\": \"session_example\",\n"))
      << text.substr(0, 80);
  EXPECT_NE(
      text.find("\n    {\"pattern\":0,\"exposure_us\":16667.0,\"file\":\"frames/000_0.tiff\"},\n"),
      std::string::npos);
}

TEST(Manifest, TextThatIsNoUtf8IsWrittenAsUtf8) {
  Manifest manifest = parsed(example_document());
  manifest.subject = "J\xfcrgen";
  const auto again = parse_manifest(format_manifest(manifest), "session.json");
  ASSERT_TRUE(again) << again.error().text();
  EXPECT_EQ(again->subject, "J\xef\xbf\xbdrgen");
}

TEST(Manifest, WithoutIrradianceLevelsAndStateItIsAGeometrySession) {
  json document = example_document();
  document["calibration"].erase("irradiance");
  for (const char* key : {"black_level", "saturation_level", "gain_e_per_dn", "read_noise_e"}) {
    document["camera"].erase(key);
  }
  const Manifest manifest = parsed(document);
  EXPECT_FALSE(manifest.calibration.irradiance);
  EXPECT_FALSE(manifest.camera.black_level_dn);
  EXPECT_EQ(manifest.state, SessionState::kComplete);
}

TEST(Manifest, AnIrradianceWithoutItsSignalIsKeptButNotUsed) {
  json document = example_document();
  document["calibration"]["irradiance"].erase("signal_per_us");
  EXPECT_FALSE(parsed(document).calibration.irradiance);
  expect_round_trip(document);
}

TEST(Manifest, AMonoCamerasThreeEqualNumbersAreOne) {
  json document = example_document();
  document["camera"]["pixel_format"] = "Mono12";
  document["calibration"]["irradiance"]["signal_per_us"] = {0.2, 0.2, 0.2};
  document["calibration"]["projector_black"] = {0.01};
  const Manifest manifest = parsed(document);
  EXPECT_EQ(manifest.calibration.irradiance->signal_per_us, std::vector<double>{0.2});
  EXPECT_EQ(manifest.calibration.projector_black_dn_per_us, std::vector<double>{0.01});
}

TEST(Manifest, WholeNumbersMayBeWrittenWithAPoint) {
  json document = example_document();
  document["camera"]["width"] = 64.0;
  document["patterns"][0]["period_px"] = 40.0;
  document["frames"][0]["frame_id"] = 7.0;
  EXPECT_EQ(parsed(document).camera.width_px, 64);
  EXPECT_EQ(parsed(document).frames[0].frame_id, 7U);
}

TEST(Manifest, SlotsOfAFailureMayBeNamedInAnyWay) {
  json document = example_document();
  document["state"] = "failed";
  document["failure"] = {{"code", "frame_lost"}, {"slots", {"pattern 3", 17, {{"pattern", 4}}}}};
  EXPECT_EQ(parsed(document).failure->slots,
            (std::vector<std::string>{"pattern 3", "17", "{\"pattern\":4}"}));
}

TEST(Manifest, TransferEntriesAreSortedByDistance) {
  json document = example_document();
  document["calibration"]["stripe_transfer"] = {{{"distance_mm", 1100}, {"transfer", {0.8}}},
                                                {{"distance_mm", 900}, {"transfer", {0.9}}}};
  const Manifest manifest = parsed(document);
  const auto& by_depth = std::get<TransferByDepth>(*manifest.calibration.stripe_transfer);
  ASSERT_EQ(by_depth.entries.size(), 2U);
  EXPECT_EQ(by_depth.entries[0].distance_mm, 900);
  EXPECT_EQ(by_depth.entries[0].transfer.harmonics[2], std::vector<double>{0.9});
}

TEST(Manifest, CreatedMayCarryAFractionOrAnExplicitZeroOffset) {
  for (const char* created :
       {"2026-01-31T23:59:59.25Z", "2026-01-31T23:59:59+00:00", "2016-12-31T23:59:60Z"}) {
    json document = example_document();
    document["created"] = created;
    EXPECT_EQ(parsed(document).created, created);
  }
}

TEST(Calibration, StandsAloneInAFile) {
  json document = example_document()["calibration"];
  document["operator"] = "unknown keys are ignored";
  const auto calibration = parse_calibration(document.dump(), "rig.json");
  ASSERT_TRUE(calibration) << calibration.error().text();
  EXPECT_EQ(calibration->camera.K(0, 2), 31.5);
  document["projector"].erase("t");
  const auto broken = parse_calibration(document.dump(), "rig.json");
  ASSERT_FALSE(broken);
  EXPECT_EQ(broken.error().file, "rig.json");
  EXPECT_EQ(broken.error().place, "/projector/t");
}

TEST(Calibration, CameraAndProjectorInOnePlaceAreRefused) {
  json document = example_document()["calibration"];
  document["projector"]["t"] = {0, 0, 0};
  const auto calibration = parse_calibration(document.dump(), "rig.json");
  ASSERT_FALSE(calibration);
  EXPECT_EQ(calibration.error().place, "/projector/t");
  EXPECT_NE(calibration.error().text().find("cannot be in one place"), std::string::npos);
}

TEST(PixelFormat, NamesAreTheContracts) {
  int accepted = 0;
  for (const char* filter : {"Mono", "BayerRG", "BayerGR", "BayerGB", "BayerBG", "RGB"}) {
    for (const char* depth : {"8", "12", "16", "10", ""}) {
      const std::string name = std::string(filter) + depth;
      const auto format = parse_pixel_format(name);
      if (!format) continue;
      ++accepted;
      EXPECT_EQ(to_string(*format), name);
    }
  }
  EXPECT_EQ(accepted, 17);  // all but RGB12
  EXPECT_FALSE(parse_pixel_format("mono8"));
  EXPECT_FALSE(parse_pixel_format("RGB12"));
}

TEST(BandAt, FollowsTheBayerTileFromTheSensorsOrigin) {
  const std::vector<std::pair<ColorFilter, std::string>> tiles{{ColorFilter::kBayerRG, "RGGB"},
                                                               {ColorFilter::kBayerGR, "GRBG"},
                                                               {ColorFilter::kBayerGB, "GBRG"},
                                                               {ColorFilter::kBayerBG, "BGGR"}};
  for (const auto& [filter, tile] : tiles) {
    for (int roi_y_px = 0; roi_y_px < 4; ++roi_y_px) {
      for (int roi_x_px = 0; roi_x_px < 4; ++roi_x_px) {
        CameraInfo camera;
        camera.pixel_format = {filter, 8};
        camera.roi_x_px = roi_x_px;
        camera.roi_y_px = roi_y_px;
        for (int row = 0; row < 4; ++row) {
          for (int col = 0; col < 4; ++col) {
            const char band =
                tile[static_cast<std::size_t>((row + roi_y_px) % 2 * 2 + (col + roi_x_px) % 2)];
            EXPECT_EQ("RGB"[band_at(camera, row, col)], band)
                << tile << " roi " << roi_x_px << ", " << roi_y_px << " at " << row << ", " << col;
          }
        }
      }
    }
  }
}

TEST(BandAt, MonoHasOneBandAndRgbItsChannels) {
  CameraInfo camera;
  EXPECT_EQ(band_at(camera, 1, 1), 0);
  camera.pixel_format = {ColorFilter::kRgb, 8};
  for (int channel = 0; channel < 3; ++channel) EXPECT_EQ(band_at(camera, 1, 1, channel), channel);
}

}  // namespace
}  // namespace estimation
