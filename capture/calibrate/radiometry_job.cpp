#include "capture/calibrate/radiometry_job.h"

#include <algorithm>
#include <cmath>
#include <system_error>
#include <utility>

#include "capture/calibrate/lit_scene.h"
#include "capture/calibrate/sensor_series.h"
#include "estimation/calibration/calibration_file.h"
#include "estimation/calibration/radiometry_pictures.h"
#include "estimation/calibration/report_page.h"
#include "estimation/session/file_reading.h"
#include "estimation/session/maps.h"
#include "nlohmann/json.hpp"

namespace capture {

using estimation::Calibration;
using estimation::InputError;
using estimation::InputFault;
using estimation::Measured;
using estimation::Result;
using estimation::TransferFit;
namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

namespace {

// Targets at distances nearer than this are one distance.
constexpr double kSameDistanceFrac = 0.01;
// Contrasts that vary over the field by less are one for all of it.
constexpr double kFieldVariation = 0.01;

InputError named(InputError error, const std::string& session) {
  if (error.file.empty()) error.file = session;
  return error;
}

Json json_of(const Measured& measured) { return {{"value", measured.value}, {"sd", measured.sd}}; }

bool read_color(const Json& json, estimation::Vec3& color) {
  if (!json.is_array() || json.size() != 3) return false;
  for (int i = 0; i < 3; ++i) {
    const Json& value = json[static_cast<std::size_t>(i)];
    if (!value.is_number()) return false;
    color[i] = value.get<double>();
  }
  return true;
}

// From a chart's patches, or from what the camera has of the projector's single colours.
Result<estimation::ColorFit> read_colors(const std::string& path) {
  const auto wrong = [&path](const std::string& expectation) {
    return tl::unexpected(InputError{InputFault::kInvalid, path, "", expectation});
  };
  const auto text = estimation::read_text(path);
  if (!text) return tl::unexpected(text.error());
  const Json json = Json::parse(*text, nullptr, false);
  if (json.is_object() && json.contains("primaries")) {
    estimation::Mat3 camera_by_primary;
    const Json& primaries = json["primaries"];
    for (int i = 0; i < 3; ++i) {
      estimation::Vec3 color;
      const auto at = static_cast<std::size_t>(i);
      if (!primaries.is_array() || primaries.size() != 3 || !read_color(primaries[at], color))
        return wrong("\"primaries\" are the camera's [r, g, b] under red, green and blue");
      for (int band = 0; band < 3; ++band) camera_by_primary(band, i) = color[band];
    }
    const auto matrix = estimation::color_matrix_from_primaries(camera_by_primary);
    if (!matrix) return wrong(matrix.error().expectation);
    estimation::ColorFit fit;
    fit.matrix = *matrix;
    return fit;
  }
  if (!json.is_array())
    return wrong(
        "expected a list of {\"camera\": [r, g, b], \"display\": [r, g, b]}, or {\"primaries\": "
        "[red, green, blue]}");
  std::vector<estimation::ColorPatch> patches;
  for (const Json& each : json) {
    estimation::ColorPatch patch;
    const bool is_whole = each.is_object() && each.contains("camera") && each.contains("display") &&
                          read_color(each["camera"], patch.camera) &&
                          read_color(each["display"], patch.display);
    if (!is_whole)
      return wrong("patch " + std::to_string(patches.size()) +
                   " lacks three numbers under \"camera\" or \"display\"");
    patches.push_back(patch);
  }
  auto fit = estimation::fit_color_matrix(patches);
  if (!fit) return wrong(fit.error().expectation);
  return *fit;
}

// Over the blocks: the largest standard deviation of any harmonic that there is contrast in.
double field_variation(const TransferFit& fit) {
  double largest = 0;
  for (std::size_t band = 0; band < static_cast<std::size_t>(fit.band_count); ++band)
    for (std::size_t n = 0; n < 6; ++n) {
      double squares = 0, noise = 0;
      for (const auto& block : fit.blocks) {
        const Measured& m = block.bands[band].contrast[n];
        squares += std::pow(m.value - fit.bands[band].contrast[n].value, 2);
        noise += m.sd * m.sd;
      }
      const auto count = static_cast<double>(fit.blocks.size());
      largest = std::max(largest, std::sqrt(std::max(0.0, (squares - noise) / count)));
    }
  return largest;
}

bool are_depths(const std::vector<TransferFit>& fits) {
  std::vector<double> distances_mm;
  distances_mm.reserve(fits.size());
  for (const TransferFit& fit : fits) distances_mm.push_back(fit.distance_mm);
  std::ranges::sort(distances_mm);
  for (std::size_t i = 1; i < distances_mm.size(); ++i)
    if (distances_mm[i] < (1 + kSameDistanceFrac) * distances_mm[i - 1]) return false;
  return distances_mm.size() > 1;
}

}  // namespace

Result<RadiometryJob> RadiometryJob::run(const RadiometryInputs& inputs,
                                         const Calibration& geometry) {
  RadiometryJob job(inputs);
  if (const auto done = job.measure_sensor(); !done) return tl::unexpected(done.error());
  if (const auto done = job.measure_standard(geometry); !done) return tl::unexpected(done.error());
  if (const auto done = job.measure_transfer(geometry); !done) return tl::unexpected(done.error());
  if (const auto done = job.measure_color(); !done) return tl::unexpected(done.error());
  return job;
}

Result<void> RadiometryJob::measure_sensor() {
  if (inputs_.series.empty()) return {};
  SensorSeries series;
  for (const std::string& session : inputs_.dark)
    if (const auto added = series.add_dark(session); !added) return added;
  for (const std::string& session : inputs_.series)
    if (const auto added = series.add_lit(session); !added) return added;
  auto fit = estimation::fit_sensor(series.frames(), series.saturation_dn());
  if (!fit) return tl::unexpected(named(fit.error(), inputs_.series.front()));
  sensor_ = std::move(*fit);
  light_ = estimation::check_light(series.pairs(*sensor_), {});
  return {};
}

Result<void> RadiometryJob::measure_standard(const Calibration& geometry) {
  if (inputs_.standard.empty()) return {};
  std::vector<LitScene> scenes;
  for (const std::string& session : inputs_.standard) {
    auto scene = read_lit_scene(session, geometry);
    if (!scene) return tl::unexpected(named(scene.error(), session));
    scenes.push_back(std::move(*scene));
  }
  std::vector<estimation::StandardView> views;
  views.reserve(scenes.size());
  for (const LitScene& scene : scenes) views.push_back(scene.standard_view());
  const estimation::Manifest& manifest = *scenes.front().read.manifest;
  estimation::StandardOptions options;
  options.reflectance = inputs_.reflectance;
  auto fit =
      estimation::fit_illumination(views, geometry, manifest.camera, manifest.projector, options);
  if (!fit) return tl::unexpected(named(fit.error(), inputs_.standard.front()));
  illumination_ = std::move(*fit);
  return {};
}

Result<void> RadiometryJob::measure_transfer(const Calibration& geometry) {
  for (const std::string& session : inputs_.opaque) {
    auto scene = read_lit_scene(session, geometry);
    if (!scene) return tl::unexpected(named(scene.error(), session));
    const auto sweep = transfer_sweep(*scene);
    if (!sweep) return tl::unexpected(named(sweep.error(), session));
    auto fit = estimation::fit_transfer(*sweep, scene->read.manifest->camera);
    if (!fit) return tl::unexpected(named(fit.error(), session));
    camera_ = scene->read.manifest->camera;
    transfers_.push_back(std::move(*fit));
  }
  return {};
}

Result<void> RadiometryJob::measure_color() {
  if (inputs_.chart.empty()) return {};
  const auto fit = read_colors(inputs_.chart);
  if (!fit) return tl::unexpected(fit.error());
  color_ = *fit;
  return {};
}

bool RadiometryJob::is_target_opaque() const {
  return std::ranges::none_of(transfers_,
                              [](const TransferFit& fit) { return fit.scattering.is_scattering; });
}

std::vector<std::string> RadiometryJob::warnings() const {
  std::vector<std::string> warnings;
  const auto add = [&warnings](const std::vector<std::string>& more) {
    warnings.insert(warnings.end(), more.begin(), more.end());
  };
  if (sensor_) add(sensor_->warnings);
  if (light_) add(light_->warnings);
  if (illumination_) add(illumination_->warnings);
  for (const TransferFit& fit : transfers_) add(fit.warnings);
  if (!is_target_opaque())
    warnings.emplace_back("the optics' transfer is not stored: the target scatters");
  return warnings;
}

std::string RadiometryJob::report() const {
  std::string text;
  if (sensor_) text += "Sensor\n" + estimation::describe_sensor(*sensor_) + "\n";
  if (light_) text += "Light\n" + estimation::describe_light(*light_) + "\n";
  if (illumination_)
    text += "Reflectance standard\n" + estimation::describe_illumination(*illumination_) + "\n";
  for (std::size_t i = 0; i < transfers_.size(); ++i)
    text += "Transfer, " + inputs_.opaque[i] + "\n" + estimation::describe_transfer(transfers_[i]) +
            "\n";
  if (color_) {
    char line[120];
    std::snprintf(line, sizeof line, "Colour matrix: residual %.4f rms, %.4f at most\n",
                  color_->residual_rms, color_->residual_max);
    text += line;
  }
  for (const std::string& warning : warnings()) text += "warning: " + warning + "\n";
  return text;
}

Result<void> RadiometryJob::write_report(const fs::path& folder) const {
  if (const auto saved = estimation::save_text(folder / "report.txt", report()); !saved)
    return saved;
  if (sensor_)
    if (const auto drawn = estimation::draw_sensor(folder, *sensor_); !drawn) return drawn;
  if (illumination_)
    if (const auto drawn = estimation::draw_illumination(folder, *illumination_); !drawn)
      return drawn;
  if (const auto drawn = estimation::draw_transfer(folder, transfers_); !drawn) return drawn;
  return estimation::write_report_page(folder, "Radiometry of the rig", report());
}

std::string RadiometryJob::record_json(std::chrono::system_clock::time_point now) const {
  Json json{{"date", estimation::date_text(now)}, {"software", "ssrig"}};
  if (sensor_)
    json["sensor"] = {{"sessions", inputs_.series},
                      {"black_level_dn", json_of(sensor_->black_level_dn)},
                      {"dark_signal_dn_per_us", json_of(sensor_->dark_signal_dn_per_us)},
                      {"gain_e_per_dn", json_of(sensor_->gain_e_per_dn)},
                      {"read_noise_e", json_of(sensor_->read_noise_e)},
                      {"linearity_max_frac", sensor_->linearity_max_frac.value}};
  if (light_)
    json["light"] = {{"white_change_frac", light_->white_change_frac},
                     {"black_change_frac", light_->black_change_frac},
                     {"gamma", json_of(light_->gamma)}};
  if (illumination_) {
    json["standard"] = {{"sessions", inputs_.standard},
                        {"reflectance", inputs_.reflectance},
                        {"residual_rms_frac", illumination_->residual_rms_frac},
                        {"flatness_mm", illumination_->flatness_mm},
                        {"vignetting_order", illumination_->order}};
    for (int band = 0; band < illumination_->band_count; ++band)
      json["standard"]["signal_per_us"].push_back(
          json_of(illumination_->signal_per_us[static_cast<std::size_t>(band)]));
  }
  for (std::size_t i = 0; i < transfers_.size(); ++i) {
    const TransferFit& fit = transfers_[i];
    Json entry{{"session", inputs_.opaque[i]},
               {"distance_mm", fit.distance_mm},
               {"is_scattering", fit.scattering.is_scattering},
               {"chi2_blur", fit.scattering.chi2_blur},
               {"chi2_scattering", fit.scattering.chi2_scattering}};
    for (int band = 0; band < fit.band_count; ++band)
      entry["blur_px"].push_back(json_of(fit.bands[static_cast<std::size_t>(band)].blur_px));
    json["transfer"].push_back(entry);
  }
  if (color_)
    json["color"] = {{"chart", inputs_.chart},
                     {"residual_rms", color_->residual_rms},
                     {"residual_max", color_->residual_max}};
  json["warnings"] = warnings();
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Result<fs::path> RadiometryJob::store(const fs::path& path,
                                      std::chrono::system_clock::time_point now) const {
  const auto before = estimation::read_text(path);
  if (!before) return tl::unexpected(before.error());
  auto calibration = estimation::parse_calibration(*before, path.string());
  if (!calibration) return tl::unexpected(calibration.error());
  const auto beside = [&](const char* what) {
    std::string name = path.stem().string();
    name.append(".").append(what).append(".").append(estimation::date_stamp(now));
    return name.append(".exr");
  };
  if (illumination_) {
    const std::string file = beside("vignetting");
    const auto written =
        estimation::write_exr(path.parent_path() / file, {{"Y", illumination_->vignetting.view()}},
                              {{"unit", "1"}, {"software", "ssrig"}});
    if (!written) return tl::unexpected(written.error());
    estimation::Irradiance irradiance{.signal_per_us = {},
                                      .reference_distance_mm = illumination_->reference_distance_mm,
                                      .vignetting_file = file};
    calibration->projector_black_dn_per_us.clear();
    for (int band = 0; band < illumination_->band_count; ++band) {
      const auto b = static_cast<std::size_t>(band);
      irradiance.signal_per_us.push_back(illumination_->signal_per_us[b].value);
      if (illumination_->has_black)
        calibration->projector_black_dn_per_us.push_back(
            illumination_->projector_black_dn_per_us[b].value);
    }
    calibration->irradiance = irradiance;
  }
  if (!transfers_.empty() && is_target_opaque()) {
    if (are_depths(transfers_)) {
      calibration->stripe_transfer = estimation::transfer_by_depth(transfers_);
    } else if (field_variation(transfers_.front()) < kFieldVariation) {
      calibration->stripe_transfer = estimation::transfer_by_band(transfers_.front());
    } else {
      const auto maps = estimation::transfer_maps(transfers_.front(), *camera_);
      std::vector<estimation::ExrChannel> channels;
      channels.reserve(maps.size());
      for (const auto& [name, image] : maps) channels.push_back({name, image.view()});
      const std::string file = beside("transfer");
      const auto written = estimation::write_exr(path.parent_path() / file, channels,
                                                 {{"unit", "1"}, {"software", "ssrig"}});
      if (!written) return tl::unexpected(written.error());
      calibration->stripe_transfer = estimation::TransferFile{file};
    }
  }
  if (color_) calibration->color_matrix = color_->matrix;
  const auto text = estimation::format_calibration(
      *before, *calibration, {estimation::CalibrationPart::kRadiometry, record_json(now)});
  if (!text) return tl::unexpected(named(text.error(), path.string()));
  return estimation::write_calibration(path, *text);
}

}  // namespace capture
