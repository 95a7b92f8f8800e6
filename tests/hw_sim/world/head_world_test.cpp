#include "hw_sim/world/head_world.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <vector>

#include "estimation/session/maps.h"
#include "hw_sim/world/identity_block.h"
#include "hw_sim/world/scene.h"
#include "tests/hw_sim/world/test_rig.h"
#include "tests/temporary_folder.h"

namespace hw_sim {
namespace {

using estimation::Image;
using estimation::Vec3;
using std::chrono::microseconds;

std::shared_ptr<const Picture> shared_picture(const TestRig& rig,
                                              const estimation::PatternKind& kind,
                                              std::uint64_t id) {
  return std::make_shared<const Picture>(make_picture(rig, kind, id));
}

Image<std::uint16_t> shot(const HeadWorld& world, std::vector<LightSegment> light,
                          microseconds duration, std::uint64_t trigger = 1) {
  Image<std::uint16_t> frame(world.height_px(), world.width_px(), world.channel_count());
  world.expose({.light = std::move(light), .duration = duration, .trigger_number = trigger},
               frame.view());
  return frame;
}

SceneOptions scene(const std::string& name, bool has_indirect = false, int threads = 2) {
  SceneOptions options;
  options.name = name;
  options.has_indirect = has_indirect;
  options.has_identity = false;  // identity_block_test.cpp looks at it
  options.thread_count = threads;
  return options;
}

std::vector<std::uint16_t> bytes_of(const Image<std::uint16_t>& frame) {
  return {frame.samples().begin(), frame.samples().end()};
}

TEST(HeadWorld, SameSeedSameBytesForAnyNumberOfThreads) {
  const TestRig rig = make_test_rig(49, 36, 8);
  const auto stripes =
      shared_picture(rig, estimation::Stripes{estimation::Axis::kColumn, 40, 8, 7}, 1);
  const auto one = make_world(rig, scene("face_female", true, 1));
  const auto three = make_world(rig, scene("face_female", true, 3));
  const auto frame = shot(*one, {{stripes, microseconds(16667)}}, microseconds(16667));
  EXPECT_EQ(bytes_of(frame),
            bytes_of(shot(*three, {{stripes, microseconds(16667)}}, microseconds(16667))));
  EXPECT_NE(bytes_of(frame),
            bytes_of(shot(*three, {{stripes, microseconds(16667)}}, microseconds(16667), 2)));
  SceneOptions other = scene("face_female", true, 3);
  other.seed = 2;
  const auto reseeded = make_world(rig, other);
  EXPECT_NE(bytes_of(frame),
            bytes_of(shot(*reseeded, {{stripes, microseconds(16667)}}, microseconds(16667))));
}

TEST(HeadWorld, AnExposureThatStraddlesPicturesShowsEachForItsTime) {
  TestRig rig = make_test_rig(49, 36, 4);
  remove_noise(rig);
  const auto world = make_world(rig, scene("flat_phantom"));
  const auto white = shared_picture(rig, estimation::White{}, 1);
  const auto bars =
      shared_picture(rig, estimation::Stripes{estimation::Axis::kColumn, 40, 8, 0}, 2);
  const auto long_white = shot(*world, {{white, microseconds(3000)}}, microseconds(3000));
  const auto long_bars = shot(*world, {{bars, microseconds(7000)}}, microseconds(7000));
  const auto both =
      shot(*world, {{white, microseconds(3000)}, {bars, microseconds(7000)}}, microseconds(10000));
  for (std::size_t i = 0; i < both.samples().size(); ++i)
    EXPECT_NEAR(both.samples()[i], long_white.samples()[i] + long_bars.samples()[i] - 64, 1.01);
}

TEST(HeadWorld, DarknessIsTheBlackLevel) {
  TestRig rig = make_test_rig(49, 36, 4);
  remove_noise(rig);
  const auto world = make_world(rig, scene("flat_phantom"));
  const auto before_first_show = shot(*world, {}, microseconds(10000));
  for (const auto v : before_first_show.samples()) EXPECT_EQ(v, 64);
  const auto black = shared_picture(rig, estimation::Black{}, 1);
  const auto under_black = shot(*world, {{black, microseconds(10000)}}, microseconds(10000));
  for (const auto v : under_black.samples()) EXPECT_EQ(v, 64);
}

TEST(HeadWorld, NobodyInTheChairIsDarkAndHasTruth) {
  TestRig rig = make_test_rig(49, 36, 4);
  remove_noise(rig);
  const auto world = make_world(rig, scene("empty", true));
  const auto white = shared_picture(rig, estimation::White{}, 1);
  const auto frame = shot(*world, {{white, microseconds(10000)}}, microseconds(10000));
  for (const auto v : frame.samples()) EXPECT_EQ(v, 64);
  const test_support::TemporaryFolder folder;
  EXPECT_TRUE(world->write_truth(folder.path()));
}

TEST(HeadWorld, EachPixelSeesItsOwnBandInEveryBayerOrder) {
  using estimation::ColorFilter;
  for (const ColorFilter filter : {ColorFilter::kBayerRG, ColorFilter::kBayerGR,
                                   ColorFilter::kBayerGB, ColorFilter::kBayerBG}) {
    TestRig rig = make_test_rig(49, 36, 8);
    rig.camera.roi_x_px = filter == ColorFilter::kBayerRG ? 3 : 0;
    rig.camera.pixel_format.filter = filter;
    rig.calibration.irradiance->signal_per_us = {0.3, 0.02, 0.001};  // tells bands apart
    const auto world = make_world(rig, scene("flat_phantom"));
    const Image<float> linear = world->linear_image(make_picture(rig, estimation::White{}));
    // R_d of the cheek by band is 0.2 to 0.5.
    for (int row = 16; row < 20; ++row)
      for (int col = 20; col < 24; ++col) {
        const auto band = static_cast<std::size_t>(estimation::band_at(rig.camera, row, col));
        const double r = static_cast<double>(linear.at(row, col)) /
                         rig.calibration.irradiance->signal_per_us[band];
        EXPECT_GT(r, 0.15);
        EXPECT_LT(r, 0.55);
      }
  }
}

TEST(HeadWorld, RgbPixelsHoldAllBandsAndMonoOne) {
  TestRig rig = make_test_rig(49, 36, 4);
  remove_noise(rig);
  const auto bayer = make_world(rig, scene("flat_phantom"));
  const Image<float> mosaic = bayer->linear_image(make_picture(rig, estimation::White{}));
  rig.camera.pixel_format.filter = estimation::ColorFilter::kRgb;
  const auto rgb = make_world(rig, scene("flat_phantom"));
  ASSERT_EQ(rgb->channel_count(), 3);
  const Image<float> full = rgb->linear_image(make_picture(rig, estimation::White{}));
  rig = make_test_rig(49, 36, 4);
  for (int row = 10; row < 20; ++row)
    for (int col = 10; col < 20; ++col)
      EXPECT_FLOAT_EQ(mosaic.at(row, col),
                      full.at(row, col, estimation::band_at(rig.camera, row, col)));
  rig.camera.pixel_format.filter = estimation::ColorFilter::kMono;
  rig.calibration.irradiance->signal_per_us = {0.2};
  const auto mono = make_world(rig, scene("flat_phantom"));
  EXPECT_EQ(mono->channel_count(), 1);
  const Image<float> grey = mono->linear_image(make_picture(rig, estimation::White{}));
  EXPECT_NEAR(grey.at(18, 24), full.at(18, 24, 1) * 0.2F / 0.19F, 1e-6F);
}

class FaceTruth : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    rig_ = new TestRig(make_test_rig(147, 108, 2));
    const auto bare = make_world(*rig_, scene("face_female", false));
    bare_ = new Image<float>(bare->linear_image(make_picture(*rig_, estimation::White{})));
    const auto world = make_world(*rig_, scene("face_female", true));
    full_ = new Image<float>(world->linear_image(make_picture(*rig_, estimation::White{})));
    const test_support::TemporaryFolder folder;
    ASSERT_TRUE(world->write_truth(folder.path()));
    maps_ = new estimation::Maps(*estimation::read_maps(folder.path()));
    extra_ =
        new std::map<std::string, Image<float>>(*estimation::read_exr(folder.path() / "scene.exr"));
  }
  static void TearDownTestSuite() {
    delete rig_;
    delete bare_;
    delete full_;
    delete maps_;
    delete extra_;
  }
  template <typename Use>
  static void for_each_seen(const Use& use) {
    for (int row = 0; row < rig_->camera.height_px; ++row)
      for (int col = 0; col < rig_->camera.width_px; ++col)
        if (extra_->at("region").at(row, col) > 0) use(row, col);
  }
  static double extra(const char* name, int row, int col) {
    return static_cast<double>(extra_->at(name).at(row, col));
  }
  static Vec3 vector_at(const std::array<Image<float>, 3>& images, int row, int col) {
    return {static_cast<double>(images[0].at(row, col)),
            static_cast<double>(images[1].at(row, col)),
            static_cast<double>(images[2].at(row, col))};
  }
  static std::size_t band_at(int row, int col) {
    return static_cast<std::size_t>(estimation::band_at(rig_->camera, row, col));
  }
  // What a perfect white surface would give there, lit from the pixel's angle and distance.
  static double white_signal_per_us(int row, int col) {
    const auto& c = rig_->calibration;
    const Vec3 lamp = -(c.projector_from_camera.t() * c.projector_from_camera_mm);
    const double ratio = *c.irradiance->reference_distance_mm /
                         cv::norm(vector_at(maps_->position_mm, row, col) - lamp);
    return c.irradiance->signal_per_us[band_at(row, col)] * extra("cos_projector", row, col) *
           ratio * ratio;
  }
  static TestRig* rig_;
  static Image<float>* bare_;  // without interreflection
  static Image<float>* full_;
  static estimation::Maps* maps_;
  static std::map<std::string, Image<float>>* extra_;
};
TestRig* FaceTruth::rig_ = nullptr;
Image<float>* FaceTruth::bare_ = nullptr;
Image<float>* FaceTruth::full_ = nullptr;
estimation::Maps* FaceTruth::maps_ = nullptr;
std::map<std::string, Image<float>>* FaceTruth::extra_ = nullptr;

TEST_F(FaceTruth, TheHeadIsWhereTheTaskPutIt) {
  Vec3 low = Vec3::all(1e9), high = Vec3::all(-1e9);
  int lips = 0, forehead = 0, cheek = 0;
  for_each_seen([&](int row, int col) {
    const Vec3 point = vector_at(maps_->position_mm, row, col);
    for (int axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], point[axis]);
      high[axis] = std::max(high[axis], point[axis]);
    }
    lips += extra("region", row, col) == 2;
    forehead += extra("region", row, col) == 3;
    cheek += extra("region", row, col) == 4;
  });
  EXPECT_NEAR(high[0] - low[0], 155, 15);
  EXPECT_LT(low[1], -95);
  EXPECT_GT(high[1], 95);
  EXPECT_GT(low[2], 940);
  EXPECT_LT(high[2], 1110);
  EXPECT_GT(lips, 50);
  EXPECT_GT(forehead, 300);
  EXPECT_GT(cheek, 200);
}

TEST_F(FaceTruth, PositionsProjectToTheirPixelAndCorrespondence) {
  const auto& c = rig_->calibration;
  for_each_seen([&](int row, int col) {
    const Vec3 point = vector_at(maps_->position_mm, row, col);
    // Grazing facets keep the mesh's point, a float's 1e-4 mm: still on the pixel's ray.
    EXPECT_NEAR(c.camera.K(0, 0) * point[0] / point[2] + c.camera.K(0, 2), col, 1e-3);
    EXPECT_NEAR(c.camera.K(1, 1) * point[1] / point[2] + c.camera.K(1, 2), row, 1e-3);
    const Vec3 local = c.projector_from_camera * point + c.projector_from_camera_mm;
    EXPECT_NEAR(c.projector.K(0, 0) * local[0] / local[2] + c.projector.K(0, 2),
                static_cast<double>(maps_->correspondence_px[0].at(row, col)), 1e-3);
    EXPECT_NEAR(c.projector.K(1, 1) * local[1] / local[2] + c.projector.K(1, 2),
                static_cast<double>(maps_->correspondence_px[1].at(row, col)), 1e-3);
  });
}

TEST_F(FaceTruth, NormalsAreThoseOfNeighbouringPositions) {
  int count = 0;
  double sum_deg = 0;
  for (int row = 1; row < rig_->camera.height_px - 1; ++row)
    for (int col = 1; col < rig_->camera.width_px - 1; ++col) {
      if (!(extra("border_distance_mm", row, col) > 6)) continue;
      const Vec3 normal = vector_at(maps_->normal, row, col);
      EXPECT_NEAR(cv::norm(normal), 1, 1e-5);
      const Vec3 right =
          vector_at(maps_->position_mm, row, col + 1) - vector_at(maps_->position_mm, row, col - 1);
      const Vec3 down =
          vector_at(maps_->position_mm, row + 1, col) - vector_at(maps_->position_mm, row - 1, col);
      Vec3 across = down.cross(right);  // towards the camera: -z
      across /= cv::norm(across);
      sum_deg += std::acos(std::min(1.0, across.dot(normal))) * 57.29578;
      ++count;
    }
  ASSERT_GT(count, 1000);
  EXPECT_LT(sum_deg / count, 2.0);  // pixels are 2 mm apart here
}

TEST_F(FaceTruth, LitSkinFarFromBordersReflectsItsTruth) {
  int count = 0, close = 0;
  for_each_seen([&](int row, int col) {
    if (extra("lit", row, col) == 0 || extra("cos_projector", row, col) < 0.5) return;
    if (extra("border_distance_mm", row, col) < 8) return;
    const std::size_t band = band_at(row, col);
    const double factor = static_cast<double>(full_->at(row, col)) / white_signal_per_us(row, col);
    const double truth = static_cast<double>(maps_->diffuse_reflectance[band].at(row, col)) +
                         static_cast<double>(maps_->indirect[band].at(row, col));
    ++count;
    // Curvature bends the kernel; the rest is exact.
    close += std::abs(factor / truth - 1) < 0.03;
  });
  ASSERT_GT(count, 500);
  EXPECT_GT(close, 0.9 * count);
}

TEST_F(FaceTruth, ACastShadowIsDark) {
  // Shadows on a face are a few millimetres wide, and light bleeds in from their rims.
  double dark = 0, light = 0;
  int dark_count = 0, light_count = 0;
  for_each_seen([&](int row, int col) {
    if (extra("border_distance_mm", row, col) < 2) return;
    const bool is_lit = extra("lit", row, col) != 0;
    (is_lit ? light : dark) += static_cast<double>(bare_->at(row, col));
    ++(is_lit ? light_count : dark_count);
  });
  ASSERT_GT(dark_count, 10);
  EXPECT_LT(dark / dark_count, 0.05 * light / light_count);
}

TEST_F(FaceTruth, InterreflectionOnlyAddsAndIsItsTruth) {
  double largest = 0;
  for_each_seen([&](int row, int col) {
    EXPECT_GE(full_->at(row, col), bare_->at(row, col));
    if (extra("cos_projector", row, col) < 0.5) return;
    const std::size_t band = band_at(row, col);
    const double b = static_cast<double>(maps_->indirect[band].at(row, col));
    const double added = static_cast<double>(full_->at(row, col) - bare_->at(row, col)) /
                         white_signal_per_us(row, col);
    EXPECT_NEAR(added, b, 2e-5);
    largest = std::max(largest, b);
  });
  EXPECT_GT(largest, 0.01);
  EXPECT_LT(largest, 0.3);
}

class EveryScene : public testing::TestWithParam<std::string> {};

TEST_P(EveryScene, IsSeenLitAndHasItsTruthAndLeavesTheCornerToTheIdentity) {
  TestRig rig = make_test_rig(49, 36, 8);
  rig.camera.pixel_format.filter = estimation::ColorFilter::kRgb;
  const auto world = make_world(rig, scene(GetParam()));
  ASSERT_TRUE(world);
  const Image<float> white = world->linear_image(make_picture(rig, estimation::White{}));
  const test_support::TemporaryFolder folder;
  ASSERT_TRUE(world->write_truth(folder.path()));
  const auto maps = estimation::read_maps(folder.path());
  const auto extra = estimation::read_exr(folder.path() / "scene.exr");
  ASSERT_TRUE(maps && extra);
  int seen = 0;
  for (int row = 0; row < 36; ++row)
    for (int col = 0; col < 49; ++col) {
      const bool is_seen = extra->at("region").at(row, col) > 0;
      seen += is_seen ? 1 : 0;
      EXPECT_FALSE(is_seen && col < IdentityBlockLayout::kWidthPx) << row << " " << col;
      for (int band = 0; band < 3; ++band) {
        const auto b = static_cast<std::size_t>(band);
        EXPECT_TRUE(is_seen ? white.at(row, col, band) >= 0 : white.at(row, col, band) == 0);
        EXPECT_EQ(std::isnan(maps->sigma_a_per_mm[b].at(row, col)), !is_seen);
        EXPECT_EQ(std::isnan(maps->diffuse_reflectance[b].at(row, col)), !is_seen);
        // The projector's pixels are 2.4 mm here: grazing light may fall between their rays.
        if (is_seen && extra->at("lit").at(row, col) > 0 &&
            extra->at("cos_projector").at(row, col) > 0.5F) {
          EXPECT_GT(white.at(row, col, band), 0);
          EXPECT_FALSE(std::isnan(maps->indirect[b].at(row, col)));
        }
      }
    }
  if (GetParam() == "empty")
    EXPECT_EQ(seen, 0);
  else
    EXPECT_GT(seen, 300);
}

INSTANTIATE_TEST_SUITE_P(Scenes, EveryScene, testing::ValuesIn(scene_names()),
                         [](const auto& each) { return each.param; });

TEST(WaxBust, IsOfJensensMedia) {
  const auto bust = make_scene("wax_bust");
  ASSERT_TRUE(bust);
  const auto at = [&](double x, double y) {
    return bust->skin->at(Vec3(x, y + 2, 1000)).material.bands;
  };
  // design/science.md: sigma_s' | sigma_a; Skin2 on forehead and cheeks, Skin1 between, Chicken2.
  EXPECT_EQ(at(0, -52)[0], (Scattering{0.013, 1.09}));
  EXPECT_EQ(at(40, 34)[2], (Scattering{0.145, 1.79}));
  EXPECT_EQ(at(0, 100)[1], (Scattering{0.17, 0.88}));
  EXPECT_EQ(at(0, 63)[0], (Scattering{0.018, 0.19}));
}

TEST(HeadWorld, ALensBendsThePictureAsOpenCvSays) {
  TestRig rig = make_test_rig(49, 36, 8);
  rig.calibration.camera.distortion = {-0.4, 0.1, 0.002, -0.003, 0.01};
  const auto world = make_world(rig, scene("flat_phantom"));
  const test_support::TemporaryFolder folder;
  ASSERT_TRUE(world->write_truth(folder.path()));
  const auto maps = estimation::read_maps(folder.path());
  ASSERT_TRUE(maps);
  const auto& [k1, k2, p1, p2, k3] = rig.calibration.camera.distortion;
  const auto& K = rig.calibration.camera.K;
  int seen = 0;
  double most_bent_px = 0;
  for (int row = 0; row < 36; ++row)
    for (int col = 0; col < 49; ++col) {
      const auto z = static_cast<double>(maps->position_mm[2].at(row, col));
      if (std::isnan(z)) continue;
      const double x = static_cast<double>(maps->position_mm[0].at(row, col)) / z;
      const double y = static_cast<double>(maps->position_mm[1].at(row, col)) / z;
      const double r2 = x * x + y * y, radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
      const double bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x);
      const double bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y;
      EXPECT_NEAR(K(0, 0) * bent_x + K(0, 2), col, 2e-3);
      EXPECT_NEAR(K(1, 1) * bent_y + K(1, 2), row, 2e-3);
      most_bent_px = std::max(most_bent_px, K(0, 0) * std::hypot(bent_x - x, bent_y - y));
      ++seen;
    }
  EXPECT_GT(seen, 500);
  EXPECT_GT(most_bent_px, 0.05);
}

TEST(Interreflection, AConvexBodyHasNone) {
  TestRig rig = make_test_rig(49, 36, 4);
  const Picture white = make_picture(rig, estimation::White{});
  const Image<float> with = make_world(rig, scene("sphere", true))->linear_image(white);
  const Image<float> without = make_world(rig, scene("sphere", false))->linear_image(white);
  for (std::size_t i = 0; i < with.samples().size(); ++i)
    EXPECT_NEAR(with.samples()[i], without.samples()[i], 1e-6F);
}

TEST(TransportCache, SecondStartReadsWhatTheFirstComputed) {
  const TestRig rig = make_test_rig(49, 36, 4);
  const test_support::TemporaryFolder folder;
  SceneOptions options = scene("sphere");
  options.cache_folder = folder.path() / "below";
  const auto create = [&](bool& is_from_cache) {
    is_from_cache = false;
    auto world = HeadWorld::create(rig.camera, rig.projector, rig.calibration, options,
                                   [&](double, const std::string& what) {
                                     is_from_cache |= what.find("cache") != std::string::npos;
                                   });
    const Image<float> image = (*world)->linear_image(
        make_picture(rig, estimation::Stripes{estimation::Axis::kColumn, 40, 8, 5}));
    return std::vector<float>(image.samples().begin(), image.samples().end());
  };
  bool is_from_cache = false;
  const auto computed = create(is_from_cache);
  EXPECT_FALSE(is_from_cache);
  EXPECT_EQ(create(is_from_cache), computed);
  EXPECT_TRUE(is_from_cache);

  std::filesystem::path file;
  int file_count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(options.cache_folder)) {
    file = entry.path();
    ++file_count;
  }
  ASSERT_EQ(file_count, 1);  // and no temporary one
  {
    std::fstream damage(file, std::ios::in | std::ios::out | std::ios::binary);
    damage.seekp(5000);
    damage.put('\x55');
    damage.put('\x2a');
  }
  EXPECT_EQ(create(is_from_cache), computed);
  EXPECT_FALSE(is_from_cache);
  std::filesystem::resize_file(file, std::filesystem::file_size(file) / 2);
  EXPECT_EQ(create(is_from_cache), computed);
  EXPECT_FALSE(is_from_cache);
}

TEST(HeadWorldCreate, SaysWhatIsMissing) {
  using testing::HasSubstr;
  const auto error_of = [](const TestRig& rig, const SceneOptions& options) {
    const auto world = HeadWorld::create(rig.camera, rig.projector, rig.calibration, options);
    EXPECT_FALSE(world);
    return world ? rig::Error{} : world.error();
  };
  TestRig rig = make_test_rig(49, 36, 4);
  const rig::Error unknown = error_of(rig, scene("face"));
  EXPECT_EQ(unknown.fault, rig::Fault::kConfiguration);
  EXPECT_THAT(unknown.detail, HasSubstr("face_female, face_male"));
  rig.camera.gain_e_per_dn.reset();
  rig.calibration.irradiance->reference_distance_mm.reset();
  const rig::Error missing = error_of(rig, scene("sphere"));
  EXPECT_EQ(missing.fault, rig::Fault::kConfiguration);
  EXPECT_THAT(missing.detail, HasSubstr("gain_e_per_dn"));
  EXPECT_THAT(missing.detail, HasSubstr("reference_distance_mm"));
}

}  // namespace
}  // namespace hw_sim
