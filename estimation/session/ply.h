// The surface as a mesh that any 3-D program reads: binary little-endian PLY.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "estimation/session/error.h"

namespace estimation {

struct MeshVertex {
  std::array<float, 3> position_mm{}, normal{};  // camera coordinates: x right, y down, z forward
  std::array<std::uint8_t, 3> color{};           // sRGB; written if the mesh is coloured
};

struct Mesh {
  std::vector<MeshVertex> vertices;
  std::vector<std::array<std::uint32_t, 3>> triangles;  // counter-clockwise seen from the camera
  bool is_colored = false;
};

// Replaces the file whole or not at all. Errors: kUnwritable.
Result<void> write_ply(const std::filesystem::path& path, const Mesh& mesh);

}  // namespace estimation
