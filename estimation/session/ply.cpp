#include "estimation/session/ply.h"

#include <bit>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <string>
#include <system_error>

#include "estimation/session/files.h"
#include "estimation/session/frame_io.h"

namespace estimation {
namespace {

namespace fs = std::filesystem;

static_assert(std::endian::native == std::endian::little, "the file's byte order is the machine's");

std::string header_of(const Mesh& mesh) {
  std::string text =
      "ply\nformat binary_little_endian 1.0\n"
      "comment mm; camera coordinates: x right, y down, z forward\n"
      "comment software ssrig " SSRIG_VERSION "\nelement vertex ";
  text.append(std::to_string(mesh.vertices.size())).append("\n");
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"})
    text.append("property float ").append(name).append("\n");
  if (mesh.is_colored)
    for (const char* name : {"red", "green", "blue"})
      text.append("property uchar ").append(name).append("\n");
  return text.append("element face ")
      .append(std::to_string(mesh.triangles.size()))
      .append("\nproperty list uchar uint vertex_indices\nend_header\n");
}

template <typename T, std::size_t kCount>
void append(const std::array<T, kCount>& values, std::string& bytes) {
  bytes.append(reinterpret_cast<const char*>(values.data()), sizeof values);
}

// A few megabytes at a time: a mesh of the full sensor has a hundred.
constexpr std::size_t kBlockBytes = std::size_t{1} << 22;

void write_all(const Mesh& mesh, std::ofstream& file) {
  std::string bytes = header_of(mesh);
  const auto flush_over = [&](std::size_t limit) {
    if (bytes.size() < limit) return;
    file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    bytes.clear();
  };
  for (const MeshVertex& vertex : mesh.vertices) {
    append(vertex.position_mm, bytes);
    append(vertex.normal, bytes);
    if (mesh.is_colored) append(vertex.color, bytes);
    flush_over(kBlockBytes);
  }
  for (const auto& triangle : mesh.triangles) {
    bytes.push_back(3);
    append(triangle, bytes);
    flush_over(kBlockBytes);
  }
  flush_over(0);
  file.flush();
}

}  // namespace

Result<void> write_ply(const fs::path& path, const Mesh& mesh) {
  fs::path staging = path;
  staging += ".being_written";
  const auto failed = [&](int error_number) {
    std::error_code ignored;
    fs::remove(staging, ignored);
    return tl::unexpected(
        InputError{InputFault::kUnwritable, path.string(), "", explain_errno(error_number)});
  };
  errno = 0;
  std::ofstream file(staging, std::ios::binary | std::ios::trunc);
  if (file) write_all(mesh, file);
  if (!file) return failed(errno != 0 ? errno : EIO);
  file.close();
  if (!file) return failed(errno != 0 ? errno : EIO);
  const auto placed = put_in_place(staging, path);
  std::error_code ignored;
  if (!placed) fs::remove(staging, ignored);
  return placed;
}

}  // namespace estimation
