#include "estimation/report/quicklook.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <functional>
#include <opencv2/imgcodecs.hpp>
#include <utility>

#include "estimation/base/check.h"
#include "estimation/report/pictures.h"
#include "estimation/session/frame_io.h"

namespace estimation {
namespace {

struct Picture {
  std::string file;
  std::function<plot::Canvas()> draw;
};

void add_bands(const std::string& file, const std::string& title, const std::string& unit,
               const BandMaps& bands, int band_count, std::vector<Picture>& pictures) {
  if (bands[0].empty()) return;
  pictures.push_back(
      {file, [=, &bands] { return plot::draw_bands(title, unit, bands, band_count); }});
}

// Of maps and profiles: what a report of an earlier run may hold and this one not.
constexpr std::array<const char*, 9> kPictureNames{
    "sigma_a.png",  "sigma_s_prime.png", "translucency.png", "diffuse_reflectance.png",
    "indirect.png", "normal.png",        "depth.png",        "validity.png",
    "profiles.png"};

void remove_others(const std::filesystem::path& folder,
                   const std::vector<std::filesystem::path>& written) {
  for (const char* name : kPictureNames) {
    const std::filesystem::path path = folder / name;
    std::error_code ignored;  // a picture that stays is no reason to fail
    if (std::ranges::find(written, path) == written.end()) std::filesystem::remove(path, ignored);
  }
}

std::vector<Picture> list_pictures(const Maps& maps, const CameraInfo& camera,
                                   std::span<const QuicklookFrame> frames,
                                   std::span<const ProfilePoint> profiles) {
  std::vector<Picture> pictures;
  const int bands = maps.band_count;
  add_bands("sigma_a.png", "absorption coefficient sigma_a", "1/mm", maps.sigma_a_per_mm, bands,
            pictures);
  add_bands("sigma_s_prime.png", "reduced scattering coefficient sigma_s'", "1/mm",
            maps.sigma_s_prime_per_mm, bands, pictures);
  add_bands("translucency.png", "translucency: diffuse mean free path", "mm", maps.translucency_mm,
            bands, pictures);
  add_bands("diffuse_reflectance.png", "diffuse reflectance", "reflectance",
            maps.diffuse_reflectance, bands, pictures);
  add_bands("indirect.png", "indirect light", "reflectance", maps.indirect, bands, pictures);
  if (!maps.normal[0].empty()) {
    pictures.push_back({"normal.png", [&] { return plot::draw_normals(maps.normal); }});
  }
  if (!maps.position_mm[2].empty()) {
    pictures.push_back({"depth.png", [&] { return plot::draw_depth(maps.position_mm[2]); }});
  }
  if (!maps.validity[0].empty()) {
    pictures.push_back(
        {"validity.png", [&, bands] { return plot::draw_validity(maps.validity, bands); }});
  }
  if (!profiles.empty()) {
    pictures.push_back({"profiles.png", [=] { return plot::draw_profiles(profiles, bands); }});
  }
  for (const QuicklookFrame& frame : frames) {
    pictures.push_back({frame.name + ".png", [&] { return plot::draw_frame(frame, camera); }});
  }
  return pictures;
}

// The one place where OpenCV's exceptions become errors.
Result<std::vector<std::byte>> encode_png(const Picture& picture) {
  try {
    std::vector<unsigned char> bytes;
    if (cv::imencode(".png", picture.draw(), bytes)) {
      const auto* first = reinterpret_cast<const std::byte*>(bytes.data());
      return std::vector<std::byte>(first, first + bytes.size());
    }
  } catch (const cv::Exception& problem) {
    return tl::unexpected(InputError{InputFault::kInvalid, picture.file, "",
                                     "the picture could not be drawn: " + problem.msg});
  }
  return tl::unexpected(InputError{InputFault::kInvalid, picture.file, "",
                                   "the picture could not be encoded as PNG"});
}

}  // namespace

Result<std::vector<std::filesystem::path>> write_quicklook(const std::filesystem::path& folder,
                                                           const Maps& maps,
                                                           const CameraInfo& camera,
                                                           std::span<const QuicklookFrame> frames,
                                                           std::span<const ProfilePoint> profiles) {
  std::error_code problem;
  std::filesystem::create_directories(folder, problem);
  if (problem) {
    return tl::unexpected(InputError{InputFault::kUnwritable, folder.string(), "",
                                     "cannot make the report's folder: " + problem.message()});
  }
  std::vector<std::filesystem::path> written;
  for (const Picture& picture : list_pictures(maps, camera, frames, profiles)) {
    const auto png = encode_png(picture);
    if (!png) return tl::unexpected(png.error());
    const std::filesystem::path path = folder / picture.file;
    if (auto done = write_file_atomically(path, *png); !done) return tl::unexpected(done.error());
    written.push_back(path);
  }
  remove_others(folder, written);
  return written;
}

}  // namespace estimation
