#include "hw_sim/world/board_world.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <limits>
#include <list>
#include <mutex>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

#include "hw_sim/world/board_light.h"
#include "hw_sim/world/optics.h"
#include "hw_sim/world/sensor.h"

namespace hw_sim {

using estimation::Calibration;
using estimation::CameraInfo;
using estimation::Image;
using estimation::Vec3;

namespace {

constexpr std::size_t kPreparedLimit = 4;
// A pixel's reflectance is the mean over so many places of it, squared; an edge that runs along the
// pixels is placed to a 256th of one where it crosses them.
constexpr int kParts = 4, kEdgeParts = 16;

// A capture's target as each camera sample has it, all [height_px * width_px].
struct Sight {
  std::vector<float> column_px, row_px;  // where the projector lights it
  std::vector<float> blur_px;
  std::vector<float> share;    // of a reflectance of 1 that faces the projector at its distance
  std::vector<float> ambient;  // of the room's light
  double least_blur_px = 0, greatest_blur_px = 0;
};

// How much a vignetted lens passes at a place of its picture.
double passes(double lost_frac, double col_px, double row_px, int width_px, int height_px) {
  const double col = 2 * col_px / (width_px - 1) - 1, row = 2 * row_px / (height_px - 1) - 1;
  const double width2 = std::pow(width_px - 1, 2), height2 = std::pow(height_px - 1, 2);
  const double radius2 = (width2 * col * col + height2 * row * row) / (width2 + height2);
  return std::max(0.0, 1 - lost_frac * radius2);
}

struct Patch {
  double mean = 0;
  bool is_even = true;
};

// Of a pixel whose corners are these places of the target: [row][col].
Patch sampled_reflectance(const Target& target, const std::array<cv::Vec2d, 4>& corners,
                          int parts) {
  Patch patch;
  double first = 0;
  for (int i = 0; i < parts * parts; ++i) {
    // In rows and columns of their own: an edge along a row crosses all of them, not a whole row of
    // them at once.
    const int down = i / parts, across = i % parts;
    const double x = (across + (down + 0.5) / parts) / parts;
    const double y = (down + (across + 0.5) / parts) / parts;
    const cv::Vec2d at = (1 - y) * ((1 - x) * corners[0] + x * corners[1]) +
                         y * ((1 - x) * corners[2] + x * corners[3]);
    const double reflectance = target.reflectance_at(at[0], at[1]);
    if (i == 0) first = reflectance;
    patch.is_even = patch.is_even && reflectance == first;
    patch.mean += reflectance / (parts * parts);
  }
  return patch;
}

double mean_reflectance(const Target& target, const std::array<cv::Vec2d, 4>& corners) {
  const Patch patch = sampled_reflectance(target, corners, kParts);
  return patch.is_even ? patch.mean : sampled_reflectance(target, corners, kEdgeParts).mean;
}

rig::Result<void> check_inputs(const CameraInfo& camera, const Calibration& calibration,
                               const Effects& effects) {
  const auto bands = static_cast<std::size_t>(estimation::band_count(camera.pixel_format.filter));
  const bool is_known = camera.black_level_dn && camera.gain_e_per_dn && camera.read_noise_e;
  if (!is_known)
    return rig::failure(rig::Fault::kConfiguration,
                        "a simulated camera needs black_level_dn, gain_e_per_dn and read_noise_e "
                        "in the rig file");
  const auto& light = calibration.irradiance;
  if (!light || light->signal_per_us.size() < bands || !light->reference_distance_mm)
    return rig::failure(rig::Fault::kConfiguration,
                        "a simulated projector needs irradiance.signal_per_us for each band and "
                        "irradiance.reference_distance_mm in the calibration");
  if (effects.drifts() || (effects.ambient_frac > 0 && effects.flicker_frac > 0))
    return rig::failure(rig::Fault::kUnsupported,
                        "targets do not drift and their room does not flicker; leave subject.* and "
                        "room.flicker_frac out of the effects");
  return {};
}

}  // namespace

struct TargetWorld::Parts {
  CameraInfo camera;
  estimation::ProjectorInfo projector;
  Calibration calibration;
  TargetScene scene;
  Effects effects;
  SensorModel sensor;
  int channel_count = 1;
  CaptureCount captures_begun;

  struct Prepared {
    std::uint64_t picture_id = 0;
    std::size_t step = 0;
    std::once_flag once;
    std::vector<float> light;  // [sample] relative to white on a reflectance of 1
  };
  mutable std::mutex mutex;
  mutable std::list<std::shared_ptr<Prepared>> prepared;  // newest first; guarded by mutex
  mutable std::shared_ptr<const Sight> last_sight;        // of `sight_step`; guarded by mutex
  mutable std::size_t sight_step = std::numeric_limits<std::size_t>::max();  // guarded by mutex

  std::size_t step_now() const {
    const std::size_t begun = captures_begun();
    return std::min(begun > 0 ? begun - 1 : 0, scene.steps.size() - 1);
  }
  Sight look_at(const Target& target) const;
  std::shared_ptr<const Sight> sight_of(std::size_t step) const;
  std::shared_ptr<const Prepared> prepared_light(const Picture& picture) const;
  std::vector<float> lit(const Picture& picture, std::size_t step) const;
};

Sight TargetWorld::Parts::look_at(const Target& target) const {
  const int width = camera.width_px, height = camera.height_px;
  const Pinhole eye(calibration.camera, estimation::Mat3::eye(), {0, 0, 0});
  const Pinhole lamp(calibration.projector, calibration.projector_from_camera,
                     calibration.projector_from_camera_mm);
  const estimation::Mat3 rotation = target.rotation();
  const Vec3 normal = -(rotation * Vec3(0, 0, 1));
  const auto meet = [&](double col, double row) {
    const Vec3 ray = eye.ray(col + camera.roi_x_px, row + camera.roi_y_px).direction;
    return Vec3(ray * (normal.dot(target.middle_mm) / normal.dot(ray)));
  };
  // Own coordinates at the pixels' corners, [height + 1][width + 1].
  std::vector<cv::Vec2d> corners(static_cast<std::size_t>(width + 1) *
                                 static_cast<std::size_t>(height + 1));
  const auto corner = [&](int row, int col) -> cv::Vec2d& {
    return corners[static_cast<std::size_t>(row) * static_cast<std::size_t>(width + 1) +
                   static_cast<std::size_t>(col)];
  };
  tbb::parallel_for(0, height + 1, [&](int row) {
    for (int col = 0; col <= width; ++col) {
      const Vec3 own = rotation.t() * (meet(col - 0.5, row - 0.5) - target.middle_mm);
      corner(row, col) = {own[0], own[1]};
    }
  });
  Sight sight;
  const auto count = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  for (auto* values :
       {&sight.column_px, &sight.row_px, &sight.blur_px, &sight.share, &sight.ambient})
    values->assign(count, 0.0F);
  tbb::parallel_for(0, height, [&](int row) {
    for (int col = 0; col < width; ++col) {
      const double reflectance = mean_reflectance(
          target,
          {corner(row, col), corner(row, col + 1), corner(row + 1, col), corner(row + 1, col + 1)});
      const Vec3 point = meet(col, row), towards = lamp.center_mm() - point;
      const double distance_mm = cv::norm(towards);
      const ProjectedPoint lit = lamp.project(point);
      const auto i = static_cast<std::size_t>(row) * static_cast<std::size_t>(width) +
                     static_cast<std::size_t>(col);
      const double seen =
          reflectance * passes(effects.camera_vignetting_frac, col, row, width, height);
      sight.column_px[i] = static_cast<float>(lit.col_px);
      sight.row_px[i] = static_cast<float>(lit.row_px);
      sight.blur_px[i] = static_cast<float>(effects.blur_at(distance_mm));
      sight.ambient[i] = static_cast<float>(effects.ambient_frac * seen);
      sight.share[i] = static_cast<float>(
          seen * std::max(0.0, towards.dot(normal) / distance_mm) *
          std::pow(*calibration.irradiance->reference_distance_mm / distance_mm, 2) *
          passes(effects.vignetting_frac, lit.col_px, lit.row_px, projector.width_px,
                 projector.height_px));
    }
  });
  const auto [least, greatest] = std::minmax_element(sight.blur_px.begin(), sight.blur_px.end());
  sight.least_blur_px = static_cast<double>(*least);
  sight.greatest_blur_px = static_cast<double>(*greatest);
  return sight;
}

std::shared_ptr<const Sight> TargetWorld::Parts::sight_of(std::size_t step) const {
  const std::lock_guard lock(mutex);
  if (sight_step != step) {
    last_sight = std::make_shared<const Sight>(look_at(scene.steps[step]));
    sight_step = step;
  }
  return last_sight;
}

std::vector<float> TargetWorld::Parts::lit(const Picture& picture, std::size_t step) const {
  const std::shared_ptr<const Sight> sight_now = sight_of(step);
  const Sight& s = *sight_now;
  const BlurredPicture blurred(picture.brightness, s.least_blur_px, s.greatest_blur_px);
  std::vector<float> light(s.share.size(), 0.0F);
  tbb::parallel_for(0, camera.height_px, [&](int row) {
    for (int col = 0; col < camera.width_px; ++col) {
      const auto i = static_cast<std::size_t>(row) * static_cast<std::size_t>(camera.width_px) +
                     static_cast<std::size_t>(col);
      if (!(s.share[i] > 0)) continue;
      const auto column = static_cast<double>(s.column_px[i]),
                 line = static_cast<double>(s.row_px[i]);
      const bool is_in_beam = column > -0.5 && line > -0.5 && column < projector.width_px - 0.5 &&
                              line < projector.height_px - 0.5;
      const double black = is_in_beam ? effects.black_frac : 0;
      light[i] =
          s.share[i] *
          static_cast<float>(blurred.at(column, line, static_cast<double>(s.blur_px[i])) + black);
    }
  });
  return light;
}

std::shared_ptr<const TargetWorld::Parts::Prepared> TargetWorld::Parts::prepared_light(
    const Picture& picture) const {
  const std::size_t step = step_now();
  std::shared_ptr<Prepared> entry;
  {
    const std::lock_guard lock(mutex);
    const auto found = std::find_if(prepared.begin(), prepared.end(), [&](const auto& each) {
      return each->picture_id == picture.id && each->step == step;
    });
    if (found != prepared.end()) {
      prepared.splice(prepared.begin(), prepared, found);
    } else {
      prepared.push_front(std::make_shared<Prepared>());
      prepared.front()->picture_id = picture.id;
      prepared.front()->step = step;
      if (prepared.size() > kPreparedLimit) prepared.pop_back();
    }
    entry = prepared.front();
  }
  std::call_once(entry->once, [&] { entry->light = lit(picture, step); });
  return entry;
}

TargetWorld::TargetWorld(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
TargetWorld::~TargetWorld() = default;

rig::Result<std::unique_ptr<TargetWorld>> TargetWorld::create(
    const CameraInfo& camera, const estimation::ProjectorInfo& projector,
    const Calibration& calibration, TargetScene scene, const Effects& effects, std::uint64_t seed,
    CaptureCount captures_begun) {
  if (auto checked = check_inputs(camera, calibration, effects); !checked)
    return tl::unexpected(checked.error());
  auto parts = std::make_unique<Parts>();
  parts->camera = camera;
  parts->projector = projector;
  parts->calibration = calibration;
  parts->scene = std::move(scene);
  parts->effects = effects;
  parts->sensor = {*camera.black_level_dn, *camera.gain_e_per_dn, *camera.read_noise_e,
                   (1 << camera.pixel_format.bit_depth) - 1, seed};
  parts->channel_count = estimation::sample_channel_count(camera.pixel_format.filter);
  parts->captures_begun = std::move(captures_begun);
  return std::unique_ptr<TargetWorld>(new TargetWorld(std::move(parts)));
}

int TargetWorld::width_px() const { return parts_->camera.width_px; }
int TargetWorld::height_px() const { return parts_->camera.height_px; }
int TargetWorld::channel_count() const { return parts_->channel_count; }

void TargetWorld::prepare(const std::shared_ptr<const Picture>& picture) const {
  const Parts& p = *parts_;
  if (picture && p.scene.steps[p.step_now()].is_there()) p.prepared_light(*picture);
}

void TargetWorld::expose(const Exposure& exposure,
                         estimation::ImageView<std::uint16_t> frame_dn) const {
  const Parts& p = *parts_;
  estimation::check(frame_dn.height_px == height_px() && frame_dn.width_px == width_px() &&
                        frame_dn.channel_count == p.channel_count,
                    "a frame of another size than the camera's");
  struct Light {
    std::shared_ptr<const Parts::Prepared> prepared;
    double time_us;
  };
  std::vector<Light> lights;
  std::shared_ptr<const Sight> room;
  if (const std::size_t step = p.step_now(); p.scene.steps[step].is_there()) {
    for (const LightSegment& segment : exposure.light)
      if (segment.picture)
        lights.push_back({p.prepared_light(*segment.picture),
                          std::chrono::duration<double, std::micro>(segment.duration).count()});
    if (p.effects.ambient_frac > 0) room = p.sight_of(step);
  }
  const auto& signal_per_us = p.calibration.irradiance->signal_per_us;
  const int row_samples = frame_dn.width_px * p.channel_count;
  tbb::parallel_for(0, frame_dn.height_px, [&](int row) {
    std::vector<float> signal_dn(static_cast<std::size_t>(row_samples));
    for (int sample = 0; sample < row_samples; ++sample) {
      const int col = sample / p.channel_count;
      const auto i = static_cast<std::size_t>(row) * static_cast<std::size_t>(frame_dn.width_px) +
                     static_cast<std::size_t>(col);
      double light_us = 0;
      for (const Light& each : lights)
        light_us += each.time_us * static_cast<double>(each.prepared->light[i]);
      if (room)
        light_us +=
            static_cast<double>(exposure.duration.count()) * static_cast<double>(room->ambient[i]);
      const auto band = static_cast<std::size_t>(
          estimation::band_at(p.camera, row, col, sample % p.channel_count));
      signal_dn[static_cast<std::size_t>(sample)] =
          static_cast<float>(light_us * signal_per_us[std::min(band, signal_per_us.size() - 1)]);
    }
    p.sensor.digitise(signal_dn.data(), exposure.trigger_number,
                      static_cast<std::int64_t>(row) * row_samples, row_samples,
                      frame_dn.row(row).data());
  });
}

estimation::Result<void> TargetWorld::write_truth(const std::filesystem::path& folder,
                                                  std::size_t step) const {
  const Target& target = parts_->scene.steps[std::min(step, parts_->scene.steps.size() - 1)];
  const Vec3 normal = -(target.rotation() * Vec3(0, 0, 1));
  const auto list = [](const Vec3& v) { return nlohmann::json{v[0], v[1], v[2]}; };
  const nlohmann::json json{{"name", target.name},
                            {"middle_mm", list(target.middle_mm)},
                            {"normal", list(normal)},
                            {"reflectance", target.reflectance}};
  std::error_code ignored;  // then the file cannot be opened
  std::filesystem::create_directories(folder, ignored);
  std::ofstream file(folder / "target.json");
  file << json.dump(1) << "\n";
  if (file.flush()) return {};
  return tl::unexpected(estimation::InputError{estimation::InputFault::kUnwritable,
                                               (folder / "target.json").string(), "",
                                               "the truth cannot be written"});
}

}  // namespace hw_sim
