#include "hw_sim/world/head_world.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <deque>
#include <fstream>
#include <list>
#include <mutex>
#include <optional>

#include "hw_sim/world/head_light.h"
#include "hw_sim/world/identity_block.h"
#include "hw_sim/world/sensor.h"

namespace hw_sim {

namespace {

using estimation::CameraInfo;
using estimation::Image;

// What must be known before a picture can be simulated, all of it in one message.
rig::Result<void> check_inputs(const CameraInfo& camera, const estimation::ProjectorInfo& projector,
                               const estimation::Calibration& calibration) {
  std::string missing;
  const auto need = [](std::string& list, bool is_wrong, const char* what) {
    if (is_wrong) list += (list.empty() ? "" : ", ") + std::string(what);
  };
  need(missing, camera.width_px <= 0 || camera.height_px <= 0, "the camera's size");
  need(missing, projector.width_px <= 0 || projector.height_px <= 0, "the projector's size");
  need(missing, !camera.black_level_dn, "black_level");
  need(missing, !camera.gain_e_per_dn || *camera.gain_e_per_dn <= 0, "gain_e_per_dn");
  need(missing, !camera.read_noise_e, "read_noise_e");
  const auto& irradiance = calibration.irradiance;
  const auto bands = static_cast<std::size_t>(estimation::band_count(camera.pixel_format.filter));
  need(missing, !irradiance || irradiance->signal_per_us.size() < bands,
       "irradiance.signal_per_us for each band");
  need(missing, !irradiance || !irradiance->reference_distance_mm,
       "irradiance.reference_distance_mm");
  if (!missing.empty())
    return rig::failure(rig::Fault::kConfiguration,
                        "a simulated camera needs " + missing + " in the rig file or calibration");
  return {};
}

}  // namespace

std::filesystem::path default_cache_folder() {
  // getenv is safe here: nothing of ours changes the environment.
  if (const char* cache = std::getenv("XDG_CACHE_HOME"); cache != nullptr && *cache != '\0')
    return std::filesystem::path(cache) / "ssrig";  // NOLINT(concurrency-mt-unsafe)
  if (const char* home = std::getenv("HOME"); home != nullptr && *home != '\0')
    return std::filesystem::path(home) / ".cache" / "ssrig";  // NOLINT(concurrency-mt-unsafe)
  return {};
}

struct HeadWorld::Parts {
  CameraInfo camera;
  SceneOptions options;
  ShutterLight::Slots slots;
  int channel_count = 1;
  int lamp_rows = 0;
  std::unique_ptr<HeadLight> light;
  SensorModel sensor;
  IdentityBlockLayout identity_layout;
  mutable tbb::task_arena arena;

  // Linear images of the pictures used last. Whoever needs one first computes it; others wait in
  // its once_flag.
  struct Prepared {
    std::uint64_t picture_id;
    Moment moment;
    std::once_flag once;
    Image<float> linear;
    std::uint32_t hash = 0;  // of the picture
  };
  static constexpr std::size_t kPreparedLimit = 6;
  // Where the subject was while the shutter was open.
  struct Pose {
    std::uint64_t trigger_number;
    std::chrono::nanoseconds start;
    std::chrono::microseconds duration;
    Moment moment;
  };
  static constexpr std::size_t kPoseLimit = 100'000;
  mutable std::mutex mutex;
  mutable std::list<std::shared_ptr<Prepared>> prepared;           // newest first; guarded by mutex
  mutable std::optional<std::chrono::nanoseconds> first_exposure;  // guarded by mutex
  mutable std::deque<Pose> poses;                                  // guarded by mutex

  // Shared: an exposure may still read an image that newer pictures have pushed out.
  std::shared_ptr<const Prepared> prepared_image(const Picture& picture,
                                                 const Moment& moment) const;
  Moment moment_of(const Exposure& exposure) const;
  // What lights the samples of a frame: images with the time of each of its slots.
  struct Lit {
    std::shared_ptr<const Prepared> image;
    const std::vector<float>* time_us;
  };
  void add_row(const Lit& lit, int row, std::vector<float>& signal_dn) const;
  IdentityBlock identity_of(const Exposure& exposure, const std::vector<Lit>& lights) const;
};

std::shared_ptr<const HeadWorld::Parts::Prepared> HeadWorld::Parts::prepared_image(
    const Picture& picture, const Moment& moment) const {
  std::shared_ptr<Prepared> entry;
  {
    const std::lock_guard lock(mutex);
    const auto found = std::find_if(prepared.begin(), prepared.end(), [&](const auto& each) {
      return each->picture_id == picture.id && each->moment == moment;
    });
    if (found != prepared.end()) {
      prepared.splice(prepared.begin(), prepared, found);
    } else {
      prepared.push_front(std::make_shared<Prepared>());
      prepared.front()->picture_id = picture.id;
      prepared.front()->moment = moment;
      if (prepared.size() > kPreparedLimit) prepared.pop_back();
    }
    entry = prepared.front();
  }
  std::call_once(entry->once, [&] {
    arena.execute([&] { entry->linear = light->linear_image(picture, moment); });
    entry->hash = picture_hash(picture.brightness);
  });
  return entry;
}

Moment HeadWorld::Parts::moment_of(const Exposure& exposure) const {
  const std::lock_guard lock(mutex);
  if (!first_exposure) first_exposure = exposure.start;
  const double begin_s = std::chrono::duration<double>(exposure.start - *first_exposure).count();
  const Moment moment =
      light->moment(begin_s, begin_s + std::chrono::duration<double>(exposure.duration).count());
  poses.push_back({exposure.trigger_number, exposure.start, exposure.duration, moment});
  if (poses.size() > kPoseLimit) poses.pop_front();
  return moment;
}

void HeadWorld::Parts::add_row(const Lit& lit, int row, std::vector<float>& signal_dn) const {
  const auto linear = lit.image->linear.view().row(row);
  const std::vector<std::uint32_t>& slot = light->slots();
  if (slot.empty()) {
    const float time_us = lit.time_us->front();
    for (std::size_t i = 0; i < signal_dn.size(); ++i) signal_dn[i] += time_us * linear[i];
    return;
  }
  const std::size_t first = static_cast<std::size_t>(row) * signal_dn.size();
  for (std::size_t i = 0; i < signal_dn.size(); ++i)
    signal_dn[i] += (*lit.time_us)[slot[first + i]] * linear[i];
}

IdentityBlock HeadWorld::Parts::identity_of(const Exposure& exposure,
                                            const std::vector<Lit>& lights) const {
  IdentityBlock identity;
  identity.trigger_number = static_cast<std::uint32_t>(exposure.trigger_number);
  identity.exposure = exposure.duration;
  identity.picture_count = static_cast<int>(std::min<std::size_t>(lights.size(), 15));
  float longest_us = 0;
  for (const Lit& lit : lights) {
    const float time_us = lit.time_us->back();  // the last row's, scanned out with the square
    if (time_us <= longest_us) continue;
    longest_us = time_us;
    identity.picture_id = lit.image->picture_id;
    identity.picture_hash = lit.image->hash;
  }
  const auto open_us = static_cast<double>(exposure.duration.count());
  if (open_us > 0)
    identity.share_of_255 = static_cast<int>(
        std::lround(std::min(1.0, static_cast<double>(longest_us) / open_us) * 255));
  return identity;
}

HeadWorld::HeadWorld(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
HeadWorld::~HeadWorld() = default;

rig::Result<std::unique_ptr<HeadWorld>> HeadWorld::create(
    const CameraInfo& camera, const estimation::ProjectorInfo& projector,
    const estimation::Calibration& calibration, const SceneOptions& options,
    const std::function<void(double, const std::string&)>& progress) {
  if (auto checked = check_inputs(camera, projector, calibration); !checked)
    return tl::unexpected(checked.error());
  auto scene = make_scene(options.name);
  if (!scene) return tl::unexpected(scene.error());
  auto parts = std::make_unique<Parts>();
  Parts& p = *parts;
  const Effects& effects = options.effects;
  const int adc_max_dn = (1 << camera.pixel_format.bit_depth) - 1;
  p.camera = camera;
  p.options = options;
  p.slots = ShutterLight::slots(effects, projector.height_px);
  p.channel_count = estimation::sample_channel_count(camera.pixel_format.filter);
  p.sensor = {*camera.black_level_dn,
              *camera.gain_e_per_dn,
              *camera.read_noise_e,
              adc_max_dn,
              options.seed,
              effects.full_well_e,
              effects.pixel_gain_sd_frac,
              effects.pixel_offset_sd_dn,
              effects.hot_pixel_frac,
              effects.hot_pixel_dn_per_s};
  p.identity_layout = {static_cast<int>(std::lround(*camera.black_level_dn)), adc_max_dn};
  p.arena.initialize(options.thread_count > 0 ? options.thread_count : tbb::task_arena::automatic);
  p.arena.execute([&] {
    p.light =
        std::make_unique<HeadLight>(camera, projector, calibration, options, *std::move(scene),
                                    [&](double done_frac, const std::string& what) {
                                      if (progress) progress(done_frac, what);
                                    });
  });
  return std::unique_ptr<HeadWorld>(new HeadWorld(std::move(parts)));
}

int HeadWorld::width_px() const { return parts_->camera.width_px; }
int HeadWorld::height_px() const { return parts_->camera.height_px; }
int HeadWorld::channel_count() const { return parts_->channel_count; }

LampTiming HeadWorld::lamp_timing() const {
  const Effects& effects = parts_->options.effects;
  return {effects.input_lag_refreshes,
          std::chrono::nanoseconds(std::llround(effects.scanout_ms * 1e6))};
}

void HeadWorld::prepare(const std::shared_ptr<const Picture>& picture) const {
  // What moves is computed for its moment.
  if (picture && !parts_->options.effects.drifts()) parts_->prepared_image(*picture, {});
}

Image<float> HeadWorld::linear_image(const Picture& picture,
                                     std::chrono::nanoseconds elapsed) const {
  const double elapsed_s = std::chrono::duration<double>(elapsed).count();
  Image<float> linear;
  parts_->arena.execute([&] {
    linear = parts_->light->linear_image(picture, parts_->light->moment(elapsed_s, elapsed_s));
  });
  return linear;
}

void HeadWorld::expose(const Exposure& exposure,
                       estimation::ImageView<std::uint16_t> frame_dn) const {
  const Parts& p = *parts_;
  const Effects& effects = p.options.effects;
  estimation::check(frame_dn.height_px == height_px() && frame_dn.width_px == width_px() &&
                        frame_dn.channel_count == p.channel_count,
                    "a frame of another size than the camera's");
  const Moment moment = p.moment_of(exposure);
  const ShutterLight shutter(exposure, effects, p.slots);
  std::vector<Parts::Lit> lights;
  for (std::size_t i = 0; i < exposure.light.size(); ++i)
    if (exposure.light[i].picture && shutter.is_lit(i))
      lights.push_back({p.prepared_image(*exposure.light[i].picture, moment), &shutter.time_us(i)});
  const Image<float>& room = p.light->room_light();
  const double begin_s = std::chrono::duration<double>(exposure.start).count();
  const double open_s = std::chrono::duration<double>(exposure.duration).count();
  // Light follows the mains' power, twice a period.
  const auto room_us = static_cast<float>(
      open_s * 1e6 *
      mean_ripple(effects.flicker_frac, 2 * effects.mains_hz, 0, begin_s, begin_s + open_s));
  const int row_samples = frame_dn.width_px * frame_dn.channel_count;
  p.arena.execute([&] {
    tbb::parallel_for(tbb::blocked_range<int>(0, frame_dn.height_px, 32),
                      [&](const tbb::blocked_range<int>& rows) {
                        std::vector<float> signal_dn(static_cast<std::size_t>(row_samples));
                        for (int row = rows.begin(); row < rows.end(); ++row) {
                          std::fill(signal_dn.begin(), signal_dn.end(), 0.0F);
                          if (!room.empty())
                            std::transform(room.view().row(row).begin(), room.view().row(row).end(),
                                           signal_dn.begin(),
                                           [&](float per_us) { return room_us * per_us; });
                          for (const Parts::Lit& lit : lights) p.add_row(lit, row, signal_dn);
                          p.sensor.digitise(signal_dn.data(), exposure.trigger_number,
                                            static_cast<std::int64_t>(row) * row_samples,
                                            row_samples, frame_dn.row(row).data(), open_s);
                        }
                      });
  });
  if (p.options.has_identity) p.identity_layout.write(p.identity_of(exposure, lights), frame_dn);
}

estimation::Result<void> HeadWorld::write_truth(const std::filesystem::path& folder) const {
  estimation::Result<void> written;
  parts_->arena.execute([&] { written = parts_->light->write_truth(folder); });
  if (!written) return written;
  const std::filesystem::path file = folder / "poses.csv";
  std::ofstream out(file);
  out << "trigger_number,start_ns,exposure_us,x_mm,y_mm,z_mm,open_eyes_frac\n";
  const std::lock_guard lock(parts_->mutex);
  for (const Parts::Pose& pose : parts_->poses)
    out << pose.trigger_number << ',' << pose.start.count() << ',' << pose.duration.count() << ','
        << pose.moment.displacement_mm[0] << ',' << pose.moment.displacement_mm[1] << ','
        << pose.moment.displacement_mm[2] << ',' << pose.moment.blink_frac << '\n';
  out.flush();
  if (!out)
    return tl::unexpected(estimation::InputError{.fault = estimation::InputFault::kUnwritable,
                                                 .file = file.string(),
                                                 .place = {},
                                                 .expectation = "cannot be written; make room"});
  return {};
}

}  // namespace hw_sim
