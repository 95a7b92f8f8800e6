#include "hw_sim/world/judge.h"

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <sstream>
#include <vector>

#include "estimation/session/maps.h"
#include "hw_sim/world/scene.h"

namespace hw_sim {

namespace {

using estimation::Image;
using estimation::InputFault;
using estimation::Maps;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

struct Truth {
  Maps maps;
  std::map<std::string, Image<float>> scene;

  float scene_at(const char* name, int row, int col) const { return scene.at(name).at(row, col); }
};

enum class PixelSet { kFace, kSmoothSkin };

bool is_in_set(const Truth& truth, PixelSet set, std::size_t band, int row, int col) {
  constexpr float kCosine60 = 0.5F;
  if (truth.scene_at("region", row, col) == 0 || truth.scene_at("lit", row, col) == 0) return false;
  if (truth.scene_at("cos_projector", row, col) < kCosine60) return false;
  if (truth.scene_at("cos_camera", row, col) < kCosine60) return false;
  if (set == PixelSet::kFace) return true;
  const auto region = static_cast<Region>(static_cast<int>(truth.scene_at("region", row, col)));
  if (region != Region::kForehead && region != Region::kCheek) return false;
  return truth.scene_at("border_distance_mm", row, col) >
         2 * truth.maps.translucency_mm[band].at(row, col);
}

// NaN where either is missing.
float value_at(const Image<float>& image, int row, int col) {
  return image.empty() ? std::numeric_limits<float>::quiet_NaN() : image.at(row, col);
}

ErrorStats stats_of(std::vector<double>& errors) {
  if (errors.empty()) return {kNan, kNan};
  // The smallest value that at least that share of the errors does not exceed.
  const auto quantile = [&](double share) {
    const auto rank =
        static_cast<std::size_t>(std::ceil(share * static_cast<double>(errors.size()))) - 1;
    const auto at = errors.begin() + static_cast<std::ptrdiff_t>(rank);
    std::nth_element(errors.begin(), at, errors.end());
    return *at;
  };
  return {quantile(0.5), quantile(0.95)};
}

BandErrors judge_band(const Maps& maps, const Truth& truth, PixelSet set, std::size_t band,
                      int& pixel_count) {
  std::vector<double> sigma_a, sigma_s_prime, translucency, reflectance;
  const auto add = [](std::vector<double>& errors, const estimation::BandMaps& found,
                      const estimation::BandMaps& expected, std::size_t b, int row, int col) {
    const double value = static_cast<double>(value_at(found[b], row, col));
    const double wanted = static_cast<double>(value_at(expected[b], row, col));
    if (std::isfinite(value) && std::isfinite(wanted))
      errors.push_back(std::abs(value - wanted) / wanted);
  };
  int valid_count = 0;
  pixel_count = 0;
  for (int row = 0; row < maps.height_px; ++row)
    for (int col = 0; col < maps.width_px; ++col) {
      if (!is_in_set(truth, set, band, row, col)) continue;
      ++pixel_count;
      const std::uint32_t bits = maps.validity[band].empty() ? 0 : maps.validity[band].at(row, col);
      if ((bits & estimation::kValidityErrors) != 0 ||
          !std::isfinite(value_at(maps.translucency_mm[band], row, col)))
        continue;
      ++valid_count;
      add(sigma_a, maps.sigma_a_per_mm, truth.maps.sigma_a_per_mm, band, row, col);
      add(sigma_s_prime, maps.sigma_s_prime_per_mm, truth.maps.sigma_s_prime_per_mm, band, row,
          col);
      add(translucency, maps.translucency_mm, truth.maps.translucency_mm, band, row, col);
      add(reflectance, maps.diffuse_reflectance, truth.maps.diffuse_reflectance, band, row, col);
    }
  return {stats_of(sigma_a), stats_of(sigma_s_prime), stats_of(translucency), stats_of(reflectance),
          pixel_count > 0 ? static_cast<double>(valid_count) / pixel_count : 0};
}

void judge_geometry(const Maps& maps, const Truth& truth, PixelSet set, SetErrors& errors) {
  // Red scatters farthest, so its set is the strictest.
  std::vector<double> position_mm, normal_deg;
  for (int row = 0; row < maps.height_px; ++row)
    for (int col = 0; col < maps.width_px; ++col) {
      if (!is_in_set(truth, set, 0, row, col)) continue;
      double offset2 = 0, cosine = 0, length2 = 0;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const double offset = static_cast<double>(value_at(maps.position_mm[axis], row, col)) -
                              static_cast<double>(truth.maps.position_mm[axis].at(row, col));
        const double n = static_cast<double>(value_at(maps.normal[axis], row, col));
        offset2 += offset * offset;
        length2 += n * n;
        cosine += n * static_cast<double>(truth.maps.normal[axis].at(row, col));
      }
      if (std::isfinite(offset2)) position_mm.push_back(std::sqrt(offset2));
      if (std::isfinite(cosine) && length2 > 0)
        normal_deg.push_back(std::acos(std::clamp(cosine / std::sqrt(length2), -1.0, 1.0)) * 180 /
                             std::numbers::pi);
    }
  errors.position_mm = stats_of(position_mm);
  errors.normal_deg = stats_of(normal_deg);
}

SetErrors judge_set(const Maps& maps, const Truth& truth, PixelSet set) {
  SetErrors errors;
  errors.band_count = truth.maps.band_count;
  for (std::size_t band = 0; band < static_cast<std::size_t>(errors.band_count); ++band) {
    int pixel_count = 0;
    errors.bands[band] = judge_band(maps, truth, set, band, pixel_count);
    errors.pixel_count = std::max(errors.pixel_count, pixel_count);
  }
  judge_geometry(maps, truth, set, errors);
  return errors;
}

tl::unexpected<estimation::InputError> nothing_to_judge(const std::filesystem::path& folder,
                                                        const std::string& expectation) {
  return tl::unexpected(
      estimation::InputError{InputFault::kNotFound, folder.string(), "", expectation});
}

constexpr const char* kBandNames[3] = {"red", "green", "blue"};
constexpr const char* kSetNames[2] = {"whole face", "forehead and cheeks"};

std::string fixed(double value, int width, int decimals) {
  std::ostringstream text;
  text << std::fixed << std::setprecision(decimals) << std::setw(width);
  if (std::isfinite(value)) {
    text << value;
  } else {
    text << "-";
  }
  return text.str();
}

std::string percent(const ErrorStats& stats) {
  return fixed(100 * stats.median, 7, 2) + fixed(100 * stats.percentile95, 8, 2);
}

std::string set_table(const SetErrors& errors, const char* name) {
  std::string text = std::string(name) +
                     ", lit, both angles below 60 degrees: " + std::to_string(errors.pixel_count) +
                     " pixels\n";
  text += "  error, %      sigma_a        sigma_s'          l_d            R_d       valid, %\n";
  text += "             med     p95    med     p95    med     p95    med     p95\n";
  for (std::size_t band = 0; band < static_cast<std::size_t>(errors.band_count); ++band) {
    const BandErrors& b = errors.bands[band];
    std::string label = errors.band_count == 1 ? "mono" : kBandNames[band];
    label.resize(7, ' ');
    text += "  " + label + percent(b.sigma_a) + percent(b.sigma_s_prime) + percent(b.translucency) +
            percent(b.diffuse_reflectance) + fixed(100 * b.valid_frac, 11, 2) + "\n";
  }
  return text + "  position: median " + fixed(errors.position_mm.median, 0, 3) + " mm, p95 " +
         fixed(errors.position_mm.percentile95, 0, 3) + " mm; normal: median " +
         fixed(errors.normal_deg.median, 0, 2) + " deg, p95 " +
         fixed(errors.normal_deg.percentile95, 0, 2) + " deg\n";
}

nlohmann::ordered_json to_json(const ErrorStats& stats) {
  const auto number = [](double value) {
    return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json();
  };
  return {{"median", number(stats.median)}, {"percentile95", number(stats.percentile95)}};
}

nlohmann::ordered_json to_json(const SetErrors& errors) {
  nlohmann::ordered_json json;
  json["pixel_count"] = errors.pixel_count;
  const std::size_t band_count =
      std::min(static_cast<std::size_t>(errors.band_count), errors.bands.size());
  for (std::size_t band = 0; band < band_count; ++band) {
    const BandErrors& b = errors.bands[band];
    json[band_count == 1 ? "mono" : kBandNames[band]] = {
        {"sigma_a_rel", to_json(b.sigma_a)},
        {"sigma_s_prime_rel", to_json(b.sigma_s_prime)},
        {"translucency_rel", to_json(b.translucency)},
        {"diffuse_reflectance_rel", to_json(b.diffuse_reflectance)},
        {"valid_frac", b.valid_frac}};
  }
  json["position_mm"] = to_json(errors.position_mm);
  json["normal_deg"] = to_json(errors.normal_deg);
  return json;
}

}  // namespace

estimation::Result<JudgeReport> judge(const std::filesystem::path& maps_folder,
                                      const std::filesystem::path& truth_folder) {
  auto maps = estimation::read_maps(maps_folder);
  if (!maps) return tl::unexpected(maps.error());
  Truth truth;
  auto truth_maps = estimation::read_maps(truth_folder);
  if (!truth_maps) return tl::unexpected(truth_maps.error());
  truth.maps = std::move(*truth_maps);
  auto scene = estimation::read_exr(truth_folder / "scene.exr");
  if (!scene) return tl::unexpected(scene.error());
  truth.scene = std::move(*scene);

  for (const char* name : {"region", "border_distance_mm", "cos_projector", "cos_camera", "lit"})
    if (truth.scene.count(name) == 0 || truth.scene.at(name).height_px() != truth.maps.height_px ||
        truth.scene.at(name).width_px() != truth.maps.width_px)
      return nothing_to_judge(truth_folder / "scene.exr",
                              std::string("channel ") + name +
                                  " is missing or of another size; expected the truth that "
                                  "ssrig-sim run writes");
  const auto bands = static_cast<std::size_t>(truth.maps.band_count);
  for (std::size_t band = 0; band < bands; ++band)
    if (truth.maps.translucency_mm[band].empty() || truth.maps.position_mm[0].empty() ||
        truth.maps.normal[0].empty())
      return nothing_to_judge(truth_folder,
                              "truth maps are missing; expected the truth that "
                              "ssrig-sim run writes");
  if (maps->height_px != truth.maps.height_px || maps->width_px != truth.maps.width_px)
    return nothing_to_judge(maps_folder,
                            "maps of " + std::to_string(truth.maps.width_px) + " x " +
                                std::to_string(truth.maps.height_px) +
                                " px were expected, as the truth has; run ssrig estimate first");
  return JudgeReport{judge_set(*maps, truth, PixelSet::kFace),
                     judge_set(*maps, truth, PixelSet::kSmoothSkin)};
}

std::string JudgeReport::table() const {
  return set_table(face, kSetNames[0]) + "\n" + set_table(smooth_skin, kSetNames[1]);
}

std::string JudgeReport::json() const {
  const nlohmann::ordered_json json = {{"face", to_json(face)},
                                       {"forehead_and_cheeks", to_json(smooth_skin)}};
  return json.dump(2);
}

}  // namespace hw_sim
