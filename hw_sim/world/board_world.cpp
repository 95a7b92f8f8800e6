#include "hw_sim/world/board_world.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <list>
#include <mutex>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

#include "hw_sim/world/board_sight.h"
#include "hw_sim/world/sensor.h"
#include "hw_sim/world/shutter_light.h"

namespace hw_sim {

using estimation::Calibration;
using estimation::CameraInfo;
using estimation::Image;
using estimation::Vec3;

namespace {

constexpr std::size_t kPreparedLimit = 4;
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
  if (effects.drifts() || (effects.ambient_frac > 0 && effects.flicker_frac > 0) ||
      effects.pixel_fill_frac != 1)
    return rig::failure(
        rig::Fault::kUnsupported,
        "targets do not drift, their room does not flicker and the projector's pixels fill their "
        "squares; leave subject.*, room.flicker_frac and projector.pixel_fill_frac out of the "
        "effects");
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
  ShutterLight::Slots slots;
  CaptureCount captures_begun;

  struct Prepared {
    std::uint64_t picture_id = 0;
    std::size_t step = 0;
    std::once_flag once;
    Image<float> light;  // as TargetSight::lit
  };
  mutable std::mutex mutex;
  mutable std::list<std::shared_ptr<Prepared>> prepared;  // newest first; guarded by mutex
  mutable std::shared_ptr<const TargetSight> last_sight;  // of `sight_step`; guarded by mutex
  mutable std::size_t sight_step = std::numeric_limits<std::size_t>::max();  // guarded by mutex

  std::size_t step_now() const {
    const std::size_t begun = captures_begun();
    return std::min(begun > 0 ? begun - 1 : 0, scene.steps.size() - 1);
  }
  std::shared_ptr<const TargetSight> sight_of(std::size_t step) const;
  std::shared_ptr<const Prepared> prepared_light(const Picture& picture) const;
};

std::shared_ptr<const TargetSight> TargetWorld::Parts::sight_of(std::size_t step) const {
  const std::lock_guard lock(mutex);
  if (sight_step != step) {
    last_sight = std::make_shared<const TargetSight>(camera, projector, calibration,
                                                     scene.steps[step], effects);
    sight_step = step;
  }
  return last_sight;
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
  std::call_once(entry->once, [&] { entry->light = sight_of(step)->lit(picture); });
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
  parts->sensor = {*camera.black_level_dn,
                   *camera.gain_e_per_dn,
                   *camera.read_noise_e,
                   (1 << camera.pixel_format.bit_depth) - 1,
                   seed,
                   effects.full_well_e,
                   effects.pixel_gain_sd_frac,
                   effects.pixel_offset_sd_dn,
                   effects.hot_pixel_frac,
                   effects.hot_pixel_dn_per_s};
  parts->slots = ShutterLight::slots(effects, projector.height_px);
  parts->channel_count = estimation::sample_channel_count(camera.pixel_format.filter);
  parts->captures_begun = std::move(captures_begun);
  return std::unique_ptr<TargetWorld>(new TargetWorld(std::move(parts)));
}

int TargetWorld::width_px() const { return parts_->camera.width_px; }
int TargetWorld::height_px() const { return parts_->camera.height_px; }
int TargetWorld::channel_count() const { return parts_->channel_count; }

LampTiming TargetWorld::lamp_timing() const {
  const Effects& effects = parts_->effects;
  return {effects.input_lag_refreshes,
          std::chrono::nanoseconds(std::llround(effects.scanout_ms * 1e6))};
}

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
    const std::vector<float>* time_us;  // [slot]
  };
  const ShutterLight shutter(exposure, p.effects, p.slots);
  std::vector<Light> lights;
  std::shared_ptr<const TargetSight> sight;
  if (const std::size_t step = p.step_now(); p.scene.steps[step].is_there()) {
    for (std::size_t i = 0; i < exposure.light.size(); ++i)
      if (exposure.light[i].picture && shutter.is_lit(i))
        lights.push_back({p.prepared_light(*exposure.light[i].picture), &shutter.time_us(i)});
    sight = p.sight_of(step);
  }
  const auto& signal_per_us = p.calibration.irradiance->signal_per_us;
  const int row_samples = frame_dn.width_px * p.channel_count;
  tbb::parallel_for(0, frame_dn.height_px, [&](int row) {
    std::vector<float> signal_dn(static_cast<std::size_t>(row_samples));
    for (int sample = 0; sample < row_samples; ++sample) {
      const int col = sample / p.channel_count;
      const int band_index = estimation::band_at(p.camera, row, col, sample % p.channel_count);
      const auto band = static_cast<std::size_t>(band_index);
      double light_us = 0;
      if (sight) {
        const std::size_t slot = p.slots.at(band_index, sight->projector_row_px(row, col));
        for (const Light& each : lights)
          light_us += static_cast<double>((*each.time_us)[slot]) *
                      static_cast<double>(each.prepared->light.at(row, col));
        light_us += static_cast<double>(exposure.duration.count()) *
                    static_cast<double>(sight->ambient().at(row, col));
      }
      signal_dn[static_cast<std::size_t>(sample)] =
          static_cast<float>(light_us * signal_per_us[std::min(band, signal_per_us.size() - 1)]);
    }
    p.sensor.digitise(signal_dn.data(), exposure.trigger_number,
                      static_cast<std::int64_t>(row) * row_samples, row_samples,
                      frame_dn.row(row).data(),
                      std::chrono::duration<double>(exposure.duration).count());
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
