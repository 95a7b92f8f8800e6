#include "estimation/session/maps.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string_view>
#include <system_error>

#include "estimation/session/exr.h"
#include "estimation/session/files.h"
#include "estimation/session/frame_io.h"

namespace estimation {
namespace {

namespace fs = std::filesystem;

// One plane of a Maps and the channel that stores it.
template <typename T>
struct Plane {
  std::string channel;
  T* image;
};

// One file of the folder: its planes in the order of session_format.md.
template <typename T>
struct MapFile {
  std::string name;
  std::string unit;
  std::vector<Plane<T>> planes;
};

std::string band_name(int band, int band_count) {
  if (band_count == 1) return "Y";
  return std::string(1, "RGB"[band]);
}

// `maps` is a Maps or a const Maps: the table of files serves writing and reading.
template <typename AnyMaps>
auto map_files(AnyMaps& maps, int band_count) {
  using Pixels = std::remove_reference_t<decltype((maps.position_sd_mm))>;
  const auto by_band = [&](auto& bands, const std::string& prefix) {
    std::vector<Plane<Pixels>> planes;
    planes.reserve(static_cast<std::size_t>(band_count));
    for (int band = 0; band < band_count; ++band) {
      planes.push_back(
          {prefix + band_name(band, band_count), &bands[static_cast<std::size_t>(band)]});
    }
    return planes;
  };
  const auto by_axis = [](auto& images, std::string_view axes, const std::string& prefix) {
    std::vector<Plane<Pixels>> planes;
    for (std::size_t i = 0; i < axes.size(); ++i) planes.push_back({prefix + axes[i], &images[i]});
    return planes;
  };
  MapFile<Pixels> uncertainty{
      "uncertainty.exr",
      "sigma_a, sigma_s_prime, translucency, diffuse_reflectance: relative; indirect: 1; "
      "correspondence: px; position: mm",
      {}};
  const auto add_uncertainty = [&](const std::vector<Plane<Pixels>>& planes) {
    uncertainty.planes.insert(uncertainty.planes.end(), planes.begin(), planes.end());
  };
  add_uncertainty(by_band(maps.sigma_a_rel_sd, "sigma_a."));
  add_uncertainty(by_band(maps.sigma_s_prime_rel_sd, "sigma_s_prime."));
  add_uncertainty(by_band(maps.translucency_rel_sd, "translucency."));
  add_uncertainty(by_band(maps.diffuse_reflectance_rel_sd, "diffuse_reflectance."));
  add_uncertainty(by_band(maps.indirect_sd, "indirect."));
  add_uncertainty(by_axis(maps.correspondence_sd_px, "UV", "correspondence."));
  add_uncertainty({{"position", &maps.position_sd_mm}});

  return std::vector<MapFile<Pixels>>{
      {"sigma_a.exr", "1/mm", by_band(maps.sigma_a_per_mm, "")},
      {"sigma_s_prime.exr", "1/mm", by_band(maps.sigma_s_prime_per_mm, "")},
      {"translucency.exr", "mm", by_band(maps.translucency_mm, "")},
      {"diffuse_reflectance.exr", "1", by_band(maps.diffuse_reflectance, "")},
      {"indirect.exr", "1", by_band(maps.indirect, "")},
      std::move(uncertainty),
      {"position.exr", "mm", by_axis(maps.position_mm, "XYZ", "")},
      {"normal.exr", "1", by_axis(maps.normal, "XYZ", "")},
      {"correspondence.exr", "px", by_axis(maps.correspondence_px, "UV", "")},
  };
}

constexpr const char* kValidityFile = "validity.exr";
constexpr const char* kStagingName = ".maps_being_written";

std::vector<std::pair<std::string, std::string>> attributes_of(const Maps& maps,
                                                               const std::string& unit) {
  return {{"unit", unit},
          {"scatteringModel", maps.scattering_model},
          {"method", maps.method},
          {"noise", maps.is_noise_measured ? "measured" : "estimated"},
          {"software", "ssrig " SSRIG_VERSION}};
}

// Only what was computed gets a channel.
Result<void> write_map_file(const fs::path& folder, const MapFile<const Image<float>>& file,
                            const Maps& maps) {
  std::vector<ExrChannel> channels;
  for (const Plane<const Image<float>>& plane : file.planes) {
    if (!plane.image->empty()) channels.push_back({plane.channel, plane.image->view()});
  }
  if (channels.empty()) return {};
  return write_exr(folder / file.name, channels, attributes_of(maps, file.unit));
}

Result<void> write_validity(const fs::path& folder, const Maps& maps) {
  std::vector<Image<float>> planes;
  for (const Image<std::uint32_t>& bits : maps.validity) {
    if (bits.empty()) continue;
    Image<float> plane(bits.height_px(), bits.width_px());
    // Exact: the largest sum of bits is below 2^24.
    std::ranges::transform(bits.samples(), plane.samples().begin(),
                           [](std::uint32_t sum) { return static_cast<float>(sum); });
    planes.push_back(std::move(plane));
  }
  if (planes.empty()) return {};
  std::vector<ExrChannel> channels;
  for (const Image<float>& plane : planes) {
    const auto band = static_cast<int>(channels.size());
    channels.push_back({band_name(band, maps.band_count), plane.view()});
  }
  return write_exr(folder / kValidityFile, channels, attributes_of(maps, "sum of bits"));
}

InputError unwritable(const fs::path& path, const std::error_code& error) {
  return {InputFault::kUnwritable, path.string(), "", explain_errno(error.value())};
}

// Every name of a map file, whether `maps` holds it or not.
std::vector<std::string> map_names(const Maps& maps) {
  std::vector<std::string> names{kValidityFile};
  for (const auto& file : map_files(maps, maps.band_count)) names.push_back(file.name);
  return names;
}

Result<void> write_all(const fs::path& folder, const Maps& maps) {
  for (const auto& file : map_files(maps, maps.band_count)) {
    if (auto written = write_map_file(folder, file, maps); !written) return written;
  }
  return write_validity(folder, maps);
}

// Moves what is in `staging` into `folder` and removes its other maps: they are of an earlier run.
Result<void> replace_maps(const fs::path& folder, const fs::path& staging,
                          const std::vector<std::string>& names) {
  for (const std::string& name : names) {
    std::error_code error;
    if (fs::exists(staging / name, error)) {
      if (auto placed = put_in_place(staging / name, folder / name); !placed) return placed;
      continue;
    }
    fs::remove(folder / name, error);
    if (error) return tl::unexpected(unwritable(folder / name, error));
  }
  return {};
}

// A file of the folder; nullopt if it is not there.
Result<std::optional<ExrFile>> read_if_present(const fs::path& path) {
  Result<ExrFile> file = read_exr_file(path);
  if (file) return std::optional(std::move(*file));
  if (file.error().fault == InputFault::kNotFound) return std::optional<ExrFile>{};
  return tl::unexpected(file.error());
}

// The folder's files by name.
using ExrFiles = std::map<std::string, ExrFile>;

Result<ExrFiles> read_present(const fs::path& folder) {
  ExrFiles files;
  for (const std::string& name : map_names({})) {
    Result<std::optional<ExrFile>> file = read_if_present(folder / name);
    if (!file) return tl::unexpected(file.error());
    if (*file) files.emplace(name, std::move(**file));
  }
  return files;
}

bool is_mono(const ExrFiles& files) {
  for (const auto& [name, file] : files) {
    for (const auto& [channel, image] : file.channels) {
      if (channel == "Y" && name != "position.exr" && name != "normal.exr") return true;
      if (channel.ends_with(".Y")) return true;
    }
  }
  return false;
}

// Moves a channel out of its file and checks its size against the others'.
Result<Image<float>> take_plane(ExrFile& file, const std::string& channel, Maps& maps,
                                const fs::path& path) {
  const auto it = file.channels.find(channel);
  if (it == file.channels.end()) return Image<float>{};
  Image<float> image = std::move(it->second);
  if (maps.height_px == 0) {
    maps.height_px = image.height_px();
    maps.width_px = image.width_px();
  }
  if (image.height_px() != maps.height_px || image.width_px() != maps.width_px) {
    return tl::unexpected(InputError{
        InputFault::kInvalid, path.string(), "",
        "is " + std::to_string(image.width_px()) + " x " + std::to_string(image.height_px()) +
            " px; expected " + std::to_string(maps.width_px) + " x " +
            std::to_string(maps.height_px) + " like the other maps of its folder"});
  }
  return image;
}

Result<Image<std::uint32_t>> validity_bits(const Image<float>& plane, const fs::path& path) {
  constexpr float kLargestSum = 16777215.0F;  // a float holds whole numbers up to here
  Image<std::uint32_t> bits(plane.height_px(), plane.width_px());
  for (int row = 0; row < plane.height_px(); ++row) {
    for (int col = 0; col < plane.width_px(); ++col) {
      const float sum = plane.at(row, col);
      if (!(sum >= 0 && sum <= kLargestSum) || sum != std::floor(sum)) {
        return tl::unexpected(InputError{
            InputFault::kInvalid, path.string(),
            "pixel (row " + std::to_string(row) + ", column " + std::to_string(col) + ")",
            "is " + std::to_string(sum) + "; expected a sum of validity bits"});
      }
      bits.at(row, col) = static_cast<std::uint32_t>(sum);
    }
  }
  return bits;
}

Result<void> read_validity(ExrFile& file, Maps& maps, const fs::path& path) {
  for (int band = 0; band < maps.band_count; ++band) {
    const auto plane = take_plane(file, band_name(band, maps.band_count), maps, path);
    if (!plane) return tl::unexpected(plane.error());
    auto bits = validity_bits(*plane, path);
    if (!bits) return tl::unexpected(bits.error());
    maps.validity[static_cast<std::size_t>(band)] = std::move(*bits);
  }
  return {};
}

void take_attributes(const ExrFile& file, Maps& maps) {
  const auto text = [&](const std::string& name) {
    const auto it = file.attributes.find(name);
    return it == file.attributes.end() ? std::string{} : it->second;
  };
  if (maps.method.empty()) maps.method = text("method");
  if (text("noise") == "estimated") maps.is_noise_measured = false;
  if (maps.scattering_model.empty()) maps.scattering_model = text("scatteringModel");
}

}  // namespace

Result<void> write_maps(const fs::path& folder, const Maps& maps) {
  std::error_code error;
  const bool is_new = !fs::exists(folder, error);
  fs::create_directories(folder, error);
  if (error) return tl::unexpected(unwritable(folder, error));
  // All of them beside the old ones first: a full disk must not leave half of each.
  const fs::path staging = folder / kStagingName;
  fs::remove_all(staging, error);  // of a run that was killed
  fs::create_directory(staging, error);
  Result<void> written;
  if (error) written = tl::unexpected(unwritable(staging, error));
  if (written) written = write_all(staging, maps);
  // A person looks for the map, not for our folder.
  if (!written)
    written.error().file = (folder / fs::path(written.error().file).filename()).string();
  if (written) written = replace_maps(folder, staging, map_names(maps));
  fs::remove_all(staging, error);
  if (!written && is_new) fs::remove(folder, error);  // only if empty
  return written;
}

Result<Maps> read_maps(const fs::path& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) {
    return tl::unexpected(InputError{InputFault::kNotFound, folder.string(), "",
                                     "is no folder; expected the folder with the maps"});
  }
  Result<ExrFiles> files = read_present(folder);
  if (!files) return tl::unexpected(files.error());

  Maps maps;
  maps.band_count = is_mono(*files) ? 1 : 3;
  for (const auto& file : map_files(maps, maps.band_count)) {
    const auto content = files->find(file.name);
    if (content == files->end()) continue;
    take_attributes(content->second, maps);
    for (const auto& plane : file.planes) {
      auto image = take_plane(content->second, plane.channel, maps, folder / file.name);
      if (!image) return tl::unexpected(image.error());
      *plane.image = std::move(*image);
    }
  }
  if (const auto validity = files->find(kValidityFile); validity != files->end()) {
    take_attributes(validity->second, maps);
    const auto read = read_validity(validity->second, maps, folder / kValidityFile);
    if (!read) return tl::unexpected(read.error());
  }
  return maps;
}

}  // namespace estimation
