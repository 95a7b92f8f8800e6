#include "estimation/session/maps.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <limits>
#include <random>
#include <set>

#include "session_folder.h"

namespace estimation {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

constexpr int kWidthPx = 37;
constexpr int kHeightPx = 21;

// As a full disk: writing beyond `byte_count` fails.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t byte_count) : handler_(std::signal(SIGXFSZ, SIG_IGN)) {
    ::getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limit{byte_count, before_.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &limit);
  }
  ~FileSizeLimit() {
    ::setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, handler_);
  }
  FileSizeLimit(const FileSizeLimit&) = delete;
  FileSizeLimit& operator=(const FileSizeLimit&) = delete;

 private:
  rlimit before_{};
  void (*handler_)(int);
};

class RandomMaps {
 public:
  explicit RandomMaps(std::uint64_t seed) : random_(seed) {}

  Image<float> plane() {
    Image<float> image(kHeightPx, kWidthPx);
    for (float& value : image.samples()) {
      value = static_cast<float>(random_() % 100000) * 0.37F - 5000.0F;
      if (random_() % 7 == 0) value = std::numeric_limits<float>::quiet_NaN();
    }
    return image;
  }

  Maps full(int band_count) {
    Maps maps;
    maps.height_px = kHeightPx;
    maps.width_px = kWidthPx;
    maps.band_count = band_count;
    for (BandMaps* bands : bands_of(maps)) {
      for (int band = 0; band < band_count; ++band)
        (*bands)[static_cast<std::size_t>(band)] = plane();
    }
    for (int band = 0; band < band_count; ++band) {
      Image<std::uint32_t> bits(kHeightPx, kWidthPx);
      for (std::uint32_t& sum : bits.samples()) sum = random_() % 32768;
      maps.validity[static_cast<std::size_t>(band)] = bits;
    }
    for (auto* images : {&maps.position_mm, &maps.normal}) {
      for (Image<float>& image : *images) image = plane();
    }
    for (auto* images : {&maps.correspondence_px, &maps.correspondence_sd_px}) {
      for (Image<float>& image : *images) image = plane();
    }
    maps.position_sd_mm = plane();
    maps.method = "lut";
    maps.scattering_model = "dipole";
    return maps;
  }

  static std::vector<BandMaps*> bands_of(Maps& maps) {
    return {&maps.sigma_a_per_mm,
            &maps.sigma_s_prime_per_mm,
            &maps.translucency_mm,
            &maps.diffuse_reflectance,
            &maps.indirect,
            &maps.sigma_a_rel_sd,
            &maps.sigma_s_prime_rel_sd,
            &maps.translucency_rel_sd,
            &maps.diffuse_reflectance_rel_sd,
            &maps.indirect_sd};
  }

 private:
  std::mt19937_64 random_;
};

void expect_same(const Image<float>& a, const Image<float>& b) {
  ASSERT_EQ(a.samples().size(), b.samples().size());
  EXPECT_TRUE(std::ranges::equal(a.samples(), b.samples(), [](float x, float y) {
    return x == y || (std::isnan(x) && std::isnan(y));
  }));
}

void expect_same(Maps& a, Maps& b) {
  EXPECT_EQ(a.height_px, b.height_px);
  EXPECT_EQ(a.width_px, b.width_px);
  EXPECT_EQ(a.band_count, b.band_count);
  EXPECT_EQ(a.method, b.method);
  EXPECT_EQ(a.scattering_model, b.scattering_model);
  const auto bands_a = RandomMaps::bands_of(a);
  const auto bands_b = RandomMaps::bands_of(b);
  for (std::size_t i = 0; i < bands_a.size(); ++i) {
    for (std::size_t band = 0; band < 3; ++band) {
      SCOPED_TRACE("map " + std::to_string(i) + " band " + std::to_string(band));
      expect_same((*bands_a[i])[band], (*bands_b[i])[band]);
    }
  }
  for (std::size_t i = 0; i < 3; ++i) {
    expect_same(a.position_mm[i], b.position_mm[i]);
    expect_same(a.normal[i], b.normal[i]);
    EXPECT_TRUE(std::ranges::equal(a.validity[i].samples(), b.validity[i].samples()));
  }
  for (std::size_t i = 0; i < 2; ++i) {
    expect_same(a.correspondence_px[i], b.correspondence_px[i]);
    expect_same(a.correspondence_sd_px[i], b.correspondence_sd_px[i]);
  }
  expect_same(a.position_sd_mm, b.position_sd_mm);
}

std::set<std::string> names_in(const fs::path& folder) {
  std::set<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder)) names.insert(entry.path().filename());
  return names;
}

std::set<std::string> channels_of(const fs::path& path) {
  const Imf::InputFile file(path.c_str());
  std::set<std::string> names;
  const Imf::ChannelList& channels = file.header().channels();
  for (auto it = channels.begin(); it != channels.end(); ++it) {
    EXPECT_EQ(it.channel().type, Imf::FLOAT);
    names.insert(it.name());
  }
  EXPECT_EQ(file.header().compression(), Imf::ZIP_COMPRESSION);
  return names;
}

std::string attribute(const fs::path& path, const std::string& name) {
  const Imf::InputFile file(path.c_str());
  const auto* text = file.header().findTypedAttribute<Imf::StringAttribute>(name);
  return text == nullptr ? "(absent)" : text->value();
}

TEST(Maps, ColourAndMonoSurviveTheirFiles) {
  for (const int band_count : {3, 1}) {
    SCOPED_TRACE(band_count);
    const TemporaryFolder folder;
    Maps maps = RandomMaps(1).full(band_count);
    const auto written = write_maps(folder.path() / "deep" / "maps", maps);
    ASSERT_TRUE(written) << written.error().text();
    auto read = read_maps(folder.path() / "deep" / "maps");
    ASSERT_TRUE(read) << read.error().text();
    expect_same(maps, *read);
  }
}

TEST(Maps, FilesChannelsAndAttributesAreTheContracts) {
  const TemporaryFolder folder;
  ASSERT_TRUE(write_maps(folder.path(), RandomMaps(2).full(3)));
  const std::set<std::string> rgb{"R", "G", "B"};
  const std::set<std::string> xyz{"X", "Y", "Z"};
  std::set<std::string> deviations{"correspondence.U", "correspondence.V", "position"};
  for (const char* map :
       {"sigma_a", "sigma_s_prime", "translucency", "diffuse_reflectance", "indirect"}) {
    for (const char* band : {".R", ".G", ".B"}) deviations.insert(std::string(map) + band);
  }
  const std::map<std::string, std::pair<std::set<std::string>, std::string>> expected{
      {"sigma_a.exr", {rgb, "1/mm"}},
      {"sigma_s_prime.exr", {rgb, "1/mm"}},
      {"translucency.exr", {rgb, "mm"}},
      {"diffuse_reflectance.exr", {rgb, "1"}},
      {"indirect.exr", {rgb, "1"}},
      {"position.exr", {xyz, "mm"}},
      {"normal.exr", {xyz, "1"}},
      {"correspondence.exr", {{"U", "V"}, "px"}},
      {"validity.exr", {rgb, "sum of bits"}},
      {"uncertainty.exr",
       {deviations,
        "sigma_a, sigma_s_prime, translucency, diffuse_reflectance: relative; indirect: 1; "
        "correspondence: px; position: mm"}}};
  std::set<std::string> names;
  for (const auto& [name, content] : expected) {
    SCOPED_TRACE(name);
    names.insert(name);
    EXPECT_EQ(channels_of(folder.path() / name), content.first);
    EXPECT_EQ(attribute(folder.path() / name, "unit"), content.second);
    EXPECT_EQ(attribute(folder.path() / name, "scatteringModel"), "dipole");
    EXPECT_EQ(attribute(folder.path() / name, "method"), "lut");
    EXPECT_EQ(attribute(folder.path() / name, "noise"), "measured");
    EXPECT_THAT(attribute(folder.path() / name, "software"), HasSubstr("ssrig"));
  }
  EXPECT_EQ(names_in(folder.path()), names);
}

TEST(Maps, AMonoCamerasMapsHaveY) {
  const TemporaryFolder folder;
  ASSERT_TRUE(write_maps(folder.path(), RandomMaps(3).full(1)));
  for (const char* name : {"sigma_a.exr", "indirect.exr", "validity.exr"}) {
    EXPECT_EQ(channels_of(folder.path() / name), std::set<std::string>{"Y"});
  }
  EXPECT_TRUE(channels_of(folder.path() / "uncertainty.exr").contains("translucency.Y"));
}

TEST(Maps, WhatWasNotComputedHasNoFile) {
  const TemporaryFolder folder;
  Maps maps;
  maps.height_px = kHeightPx;
  maps.width_px = kWidthPx;
  for (Image<float>& image : maps.position_mm) image = RandomMaps(4).plane();
  ASSERT_TRUE(write_maps(folder.path(), maps));
  EXPECT_EQ(names_in(folder.path()), std::set<std::string>{"position.exr"});
  auto read = read_maps(folder.path());
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(read->band_count, 3);
  EXPECT_TRUE(read->sigma_a_per_mm[0].empty());
  expect_same(read->position_mm[2], maps.position_mm[2]);
}

TEST(Maps, MapsOfAnEarlierRunDoNotSurviveAsIfTheyWereCurrent) {
  const TemporaryFolder folder;
  write_text(folder.path() / "notes.txt", "somebody's own");
  ASSERT_TRUE(write_maps(folder.path(), RandomMaps(8).full(3)));
  Maps geometry;
  geometry.height_px = kHeightPx;
  geometry.width_px = kWidthPx;
  for (Image<float>& image : geometry.position_mm) image = RandomMaps(9).plane();
  ASSERT_TRUE(write_maps(folder.path(), geometry));
  EXPECT_EQ(names_in(folder.path()), (std::set<std::string>{"notes.txt", "position.exr"}));
}

TEST(Maps, ADiskThatFillsUpLeavesTheOldMapsAsTheyWere) {
  const TemporaryFolder folder;
  ASSERT_TRUE(write_maps(folder.path(), RandomMaps(10).full(3)));
  const std::string sigma_a = text_of(folder.path() / "sigma_a.exr");
  const std::set<std::string> names = names_in(folder.path());
  {
    // sigma_a.exr and others of three channels fit, uncertainty.exr does not.
    const FileSizeLimit limit(20000);
    const auto written = write_maps(folder.path(), RandomMaps(11).full(3));
    ASSERT_FALSE(written);
    EXPECT_EQ(written.error().fault, InputFault::kUnwritable);
    EXPECT_FALSE(write_maps(folder.path() / "new", RandomMaps(11).full(3)));
  }
  EXPECT_EQ(text_of(folder.path() / "sigma_a.exr"), sigma_a);
  EXPECT_EQ(names_in(folder.path()), names);
}

TEST(Maps, AnEmptyFolderHoldsNoMapsAndAMissingOneIsNotFound) {
  const TemporaryFolder folder;
  const auto none = read_maps(folder.path());
  ASSERT_TRUE(none);
  EXPECT_EQ(none->height_px, 0);
  const auto missing = read_maps(folder.path() / "maps");
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().fault, InputFault::kNotFound);
}

TEST(Maps, MapsOfDifferentSizesAreAnError) {
  const TemporaryFolder folder;
  Maps maps = RandomMaps(5).full(3);
  for (Image<float>& image : maps.normal) image = Image<float>(kHeightPx, kWidthPx + 1);
  ASSERT_TRUE(write_maps(folder.path(), maps));
  const auto read = read_maps(folder.path());
  ASSERT_FALSE(read);
  EXPECT_THAT(read.error().text(), HasSubstr("normal.exr: is 38 x 21 px; expected 37 x 21"));
}

TEST(Maps, ValidityThatIsNoSumOfBitsIsAnError) {
  const TemporaryFolder folder;
  Image<float> plane(kHeightPx, kWidthPx);
  plane.at(2, 3) = 0.5F;
  ASSERT_TRUE(write_exr(folder.path() / "validity.exr", {{"Y", plane.view()}}, {}));
  const auto read = read_maps(folder.path());
  ASSERT_FALSE(read);
  EXPECT_THAT(read.error().text(), HasSubstr("validity.exr: pixel (row 2, column 3): is 0.5"));
}

TEST(Maps, AnUnwritableFolderIsAnError) {
  const TemporaryFolder folder;
  write_text(folder.path() / "maps", "a file");
  const auto written = write_maps(folder.path() / "maps", RandomMaps(6).full(1));
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().fault, InputFault::kUnwritable);
}

TEST(Exr, AFileCutAnywhereIsAnError) {
  const TemporaryFolder folder;
  const fs::path path = folder.path() / "a.exr";
  const Image<float> plane = RandomMaps(7).plane();
  ASSERT_TRUE(write_exr(path, {{"Y", plane.view()}}, {{"unit", "mm"}}));
  const std::string whole = text_of(path);
  for (std::size_t size = 0; size < whole.size(); size += 1 + size / 16) {
    write_text(path, whole.substr(0, size));
    const auto read = read_exr(path);
    ASSERT_FALSE(read) << size << " of " << whole.size();
    EXPECT_EQ(read.error().fault, InputFault::kUnreadable);
    EXPECT_EQ(read.error().file, path.string());
  }
  write_text(path, whole.substr(0, whole.size() - 1));
  EXPECT_FALSE(read_exr(path));
}

TEST(Exr, RandomDamageNeverEndsTheProgram) {
  const TemporaryFolder folder;
  const fs::path path = folder.path() / "a.exr";
  ASSERT_TRUE(write_exr(path, {{"Y", RandomMaps(8).plane().view()}}, {{"unit", "mm"}}));
  const std::string whole = text_of(path);
  std::mt19937_64 random(9);
  for (int draw = 0; draw < 500; ++draw) {
    std::string damaged = whole;
    for (int i = 0; i < 3; ++i) {
      damaged[random() % (draw % 2 == 0 ? 400 : damaged.size())] = static_cast<char>(random());
    }
    write_text(path, damaged);
    const auto read = read_exr(path);
    if (!read) {
      EXPECT_FALSE(read.error().expectation.empty());
    }
  }
}

TEST(Exr, AHeaderThatAsksForTooMuchIsRefused) {
  const TemporaryFolder folder;
  const fs::path path = folder.path() / "a.exr";
  ASSERT_TRUE(write_exr(path, {{"Y", RandomMaps(10).plane().view()}}, {}));
  std::string bytes = text_of(path);
  // The attribute: name, type, size 16, then x and y of both corners.
  const std::size_t window = bytes.find(std::string("dataWindow\0box2i\0\x10\0\0\0", 21));
  ASSERT_NE(window, std::string::npos);
  for (const std::size_t corner : {std::size_t{8}, std::size_t{12}}) {
    bytes.replace(window + 21 + corner, 4, std::string("\xf0\xff\0\0", 4));  // 65520
  }
  write_text(path, bytes);
  EXPECT_FALSE(read_exr(path));
}

TEST(Exr, AnotherWritersHalfFloatsAndWindowAreRead) {
  const TemporaryFolder folder;
  const fs::path path = folder.path() / "a.exr";
  const Imath::Box2i window({3, 5}, {6, 7});  // 4 x 3 px, not at the origin
  Imf::Header header(Imath::Box2i({0, 0}, {9, 9}), window);
  header.channels().insert("flat", Imf::Channel(Imf::HALF));
  std::vector<half> values;
  for (int i = 0; i < 12; ++i) values.emplace_back(0.25F * static_cast<float>(i));
  Imf::FrameBuffer buffer;
  buffer.insert("flat", Imf::Slice::Make(Imf::HALF, values.data(), window));
  {
    Imf::OutputFile file(path.c_str(), header);
    file.setFrameBuffer(buffer);
    file.writePixels(3);
  }
  const auto channels = read_exr(path);
  ASSERT_TRUE(channels) << channels.error().text();
  const Image<float>& flat = channels->at("flat");
  ASSERT_EQ(flat.width_px(), 4);
  ASSERT_EQ(flat.height_px(), 3);
  EXPECT_EQ(flat.at(0, 0), 0.0F);
  EXPECT_EQ(flat.at(2, 3), 2.75F);
}

TEST(Exr, AViewWithAStrideIsWrittenRowByRow) {
  const TemporaryFolder folder;
  const Image<float> plane = RandomMaps(11).plane();
  ImageView<const float> part = plane.view();
  part.data += 4;
  part.width_px = 6;
  ASSERT_TRUE(write_exr(folder.path() / "a.exr", {{"Y", part}}, {}));
  const auto channels = read_exr(folder.path() / "a.exr");
  ASSERT_TRUE(channels);
  const float written = channels->at("Y").at(9, 5);
  const float original = plane.at(9, 9);
  EXPECT_TRUE(written == original || (std::isnan(written) && std::isnan(original)));
}

TEST(Exr, AMissingFolderIsUnwritable) {
  const auto written =
      write_exr("/nowhere/at/all/a.exr", {{"Y", RandomMaps(12).plane().view()}}, {});
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().fault, InputFault::kUnwritable);
}

}  // namespace
}  // namespace estimation
