#include "estimation/geometry/mesh.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <sstream>
#include <string>

#include "tests/temporary_folder.h"

namespace estimation {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr double kFocalPx = 1000;

// What a pinhole without distortion sees of a depth map; normals towards the camera.
Maps maps_of(int height_px, int width_px, double (*depth_mm)(int row, int col)) {
  Maps maps;
  maps.height_px = height_px;
  maps.width_px = width_px;
  maps.position_mm.fill(Image<float>(height_px, width_px, 1, kNaN));
  maps.normal = maps.position_mm;
  for (int row = 0; row < height_px; ++row)
    for (int col = 0; col < width_px; ++col) {
      const double z = depth_mm(row, col);
      if (std::isnan(z)) continue;
      maps.position_mm[0].at(row, col) = static_cast<float>(z * (col - width_px / 2.0) / kFocalPx);
      maps.position_mm[1].at(row, col) = static_cast<float>(z * (row - height_px / 2.0) / kFocalPx);
      maps.position_mm[2].at(row, col) = static_cast<float>(z);
      maps.normal[0].at(row, col) = maps.normal[1].at(row, col) = 0;
      maps.normal[2].at(row, col) = -1;
    }
  return maps;
}

Vec3 point(const Mesh& mesh, std::uint32_t index) {
  const auto& p = mesh.vertices.at(index).position_mm;
  return {double{p[0]}, double{p[1]}, double{p[2]}};
}

TEST(Mesh, APlaneIsCoveredOnceAndFacesTheCamera) {
  const Maps maps = maps_of(7, 9, [](int row, int col) { return 1000 + 0.4 * row - 0.7 * col; });
  const Mesh mesh = make_mesh(maps, {});
  EXPECT_EQ(mesh.vertices.size(), 7U * 9U);
  ASSERT_EQ(mesh.triangles.size(), 2U * 6U * 8U);
  EXPECT_FALSE(mesh.is_colored);
  double area_px = 0;
  for (const auto& [a, b, c] : mesh.triangles) {
    const Vec3 across = (point(mesh, b) - point(mesh, a)).cross(point(mesh, c) - point(mesh, a));
    EXPECT_LT(across[2], 0);
    const auto image = [&](std::uint32_t i) {
      const Vec3 p = point(mesh, i);
      return cv::Vec2d(p[0], p[1]) * (kFocalPx / p[2]);
    };
    const auto u = image(b) - image(a), v = image(c) - image(a);
    area_px += std::abs(u[0] * v[1] - u[1] * v[0]) / 2;
  }
  EXPECT_NEAR(area_px, 6 * 8, 1e-3);
}

TEST(Mesh, NoFaceCrossesAStepOrAGap) {
  const Maps maps = maps_of(6, 12, [](int row, int col) {
    if (row == 2 && col == 2) return std::numeric_limits<double>::quiet_NaN();
    return col < 6 ? 1000.0 : 1008.0;  // eight times the sideways distance
  });
  const Mesh mesh = make_mesh(maps, {});
  for (const auto& triangle : mesh.triangles)
    for (const std::uint32_t index : triangle)
      EXPECT_EQ(point(mesh, index)[2], point(mesh, triangle[0])[2]);
  // Two halves of 5 x 5 squares; each of the four around the missing corner keeps one triangle.
  EXPECT_EQ(mesh.triangles.size(), 2U * 2U * 25U - 4U);
  EXPECT_EQ(mesh.vertices.size(), 6U * 12U - 1U);
}

TEST(Mesh, ColoursAreTheReflectancesAsAScreenCodesThem) {
  Maps maps = maps_of(2, 2, [](int, int) { return 500.0; });
  for (int band = 0; band < 3; ++band)
    maps.diffuse_reflectance[static_cast<std::size_t>(band)] =
        Image<float>(2, 2, 1, band == 0 ? 0.5F : 0.2F);
  maps.diffuse_reflectance[0].at(1, 1) = kNaN;  // as its neighbours
  const Mesh mesh = make_mesh(maps, {});
  ASSERT_EQ(mesh.vertices.size(), 4U);
  EXPECT_TRUE(mesh.is_colored);
  for (const MeshVertex& vertex : mesh.vertices)
    EXPECT_EQ(vertex.color, (std::array<std::uint8_t, 3>{188, 124, 124}));
}

TEST(Mesh, NothingMakesNoMesh) {
  EXPECT_TRUE(make_mesh({}, {}).vertices.empty());
  const Maps maps =
      maps_of(4, 4, [](int, int) { return std::numeric_limits<double>::quiet_NaN(); });
  EXPECT_TRUE(make_mesh(maps, {}).triangles.empty());
}

class PlyFile : public ::testing::Test {
 protected:
  const test_support::TemporaryFolder temporary_;
  const std::filesystem::path folder_ = temporary_.path();
};

// Read back by the format's own rules.
TEST_F(PlyFile, HoldsWhatWasWritten) {
  Mesh mesh;
  mesh.is_colored = true;
  mesh.vertices = {{{1, 2, 3}, {0, 0, -1}, {10, 20, 30}},
                   {{4, 5, 6}, {0, -1, 0}, {40, 50, 60}},
                   {{7, 8, 9}, {-1, 0, 0}, {70, 80, 255}}};
  mesh.triangles = {{2, 0, 1}};
  ASSERT_TRUE(write_ply(folder_ / "surface.ply", mesh));
  std::ifstream file(folder_ / "surface.ply", std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(file)), {});
  const std::size_t end = bytes.find("end_header\n") + 11;
  const std::string header = bytes.substr(0, end);
  EXPECT_TRUE(header.starts_with("ply\nformat binary_little_endian 1.0\n"));
  EXPECT_NE(header.find("element vertex 3\n"), std::string::npos);
  EXPECT_NE(header.find("element face 1\nproperty list uchar uint vertex_indices\n"),
            std::string::npos);
  ASSERT_EQ(bytes.size(), end + 3 * (6 * 4 + 3) + 1 + 3 * 4);
  std::array<float, 6> second{};
  std::memcpy(second.data(), bytes.data() + end + 27, sizeof second);
  EXPECT_EQ(second, (std::array<float, 6>{4, 5, 6, 0, -1, 0}));
  EXPECT_EQ(static_cast<unsigned char>(bytes[end + 3 * 27 - 1]), 255);
  EXPECT_EQ(bytes[end + 3 * 27], 3);
  std::array<std::uint32_t, 3> triangle{};
  std::memcpy(triangle.data(), bytes.data() + end + 3 * 27 + 1, sizeof triangle);
  EXPECT_EQ(triangle, mesh.triangles[0]);
}

TEST_F(PlyFile, AFolderThatIsNotThereIsAnError) {
  const auto written = write_ply(folder_ / "none" / "surface.ply", {});
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().fault, InputFault::kUnwritable);
  EXPECT_NE(written.error().file.find("surface.ply"), std::string::npos);
}

}  // namespace
}  // namespace estimation
