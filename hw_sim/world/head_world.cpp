#include "hw_sim/world/head_world.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <list>
#include <mutex>
#include <numbers>
#include <optional>

#include "hw_sim/world/interreflection.h"
#include "hw_sim/world/scatter_table.h"
#include "hw_sim/world/scene.h"
#include "hw_sim/world/seen_points.h"
#include "hw_sim/world/sensor.h"
#include "hw_sim/world/transport.h"
#include "hw_sim/world/transport_cache.h"
#include "hw_sim/world/truth.h"

namespace hw_sim {

namespace {

using estimation::CameraInfo;
using estimation::Image;

constexpr std::uint64_t kPhotonSeed = 20260;  // one walk serves all scenes

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
  estimation::Calibration calibration;
  SceneOptions options;
  int channel_count;
  std::unique_ptr<SkinMap> skin;
  std::unique_ptr<Surface> surface;
  std::unique_ptr<ProjectorLight> light;
  SeenPoints seen;
  std::optional<ScatterTable> scattering;  // none: the paper's dipole
  Transport transport;
  Interreflection indirect;
  SensorModel sensor;
  mutable tbb::task_arena arena;

  TotalReflectance total_reflectance() const {
    if (scattering)
      return [this](const Scattering& medium) { return scattering->total_reflectance(medium); };
    return [](const Scattering& medium) { return Dipole(medium).total_reflectance(); };
  }
  const ScatterTable* table() const { return scattering ? &*scattering : nullptr; }

  // Of the effects, what stays: per sample, as Transport takes it.
  LineOptics optics;
  std::array<std::vector<float>, 2> shift_px_per_s;  // [axis][sample]; empty: nobody moves
  std::vector<float> lens;                           // [sample] both lenses' vignetting
  std::vector<float> room;                           // [sample] reflected ambient light
  std::vector<float> under_white;                    // [sample]; empty: the projector's black is

  // Linear images of the pictures used last. Whoever needs one first computes it; others wait in
  // its once_flag.
  struct Prepared {
    std::uint64_t picture_id;
    std::chrono::nanoseconds elapsed;
    std::once_flag once;
    Image<float> linear;
  };
  static constexpr std::size_t kPreparedLimit = 6;
  mutable std::mutex prepared_mutex;
  mutable std::list<std::shared_ptr<Prepared>> prepared;  // newest first; guarded by prepared_mutex
  mutable std::optional<std::chrono::nanoseconds> first_exposure;  // guarded by prepared_mutex

  void prepare_effects(const Pinhole& lamp, const Pinhole& eye);
  std::vector<float> reflected(const Picture& picture, std::chrono::nanoseconds elapsed) const;
  Image<float> linear_image(const Picture& picture, std::chrono::nanoseconds elapsed) const;
  // Shared: an exposure may still read an image that newer pictures have pushed out.
  std::shared_ptr<const Prepared> prepared_image(const Picture& picture,
                                                 std::chrono::nanoseconds elapsed) const;
  std::chrono::nanoseconds elapsed_at(std::chrono::nanoseconds start) const;
  std::vector<float> room_light(const Exposure& exposure) const;  // [frame sample] DN; or empty
  // The room's light over an exposure, relative to its mean.
  double flicker(const Exposure& exposure) const;
};

namespace {

// How much a vignetted lens passes at a place of its picture.
double lens_passes(double lost_frac, double row_px, double col_px, int height_px, int width_px) {
  const double row = row_px - 0.5 * (height_px - 1), col = col_px - 0.5 * (width_px - 1);
  const double corner2 =
      0.25 * ((height_px - 1.0) * (height_px - 1.0) + (width_px - 1.0) * (width_px - 1.0));
  return std::max(0.0, 1 - lost_frac * (row * row + col * col) / std::max(corner2, 1.0));
}

}  // namespace

void HeadWorld::Parts::prepare_effects(const Pinhole& lamp, const Pinhole& eye) {
  const Effects& effects = options.effects;
  const TotalReflectance reflectance_of = total_reflectance();
  for (std::size_t i = 0; i < seen.samples.size(); ++i) {
    const SeenPoint& point = seen.points[static_cast<std::size_t>(seen.owners[i])];
    const ProjectedPoint at = lamp.project(point.point_mm);
    if (effects.blurs())
      optics.blur_px.push_back(
          static_cast<float>(effects.blur_at(cv::norm(point.point_mm - lamp.center_mm()))));
    lens.push_back(static_cast<float>(lens_passes(effects.vignetting_frac, at.row_px, at.col_px,
                                                  light->height_px(), light->width_px()) *
                                      lens_passes(effects.camera_vignetting_frac, point.row,
                                                  point.col, camera.height_px, camera.width_px)));
    if (effects.ambient_frac > 0)
      room.push_back(
          static_cast<float>(effects.ambient_frac * reflectance_of(seen.samples[i].scattering)));
    if (!effects.drifts()) continue;
    // The ray of a pixel meets the moved tangent plane elsewhere, under another projector column.
    const estimation::Vec3 ray =
        eye.ray(point.col + camera.roi_x_px, point.row + camera.roi_y_px).direction;
    constexpr double kStep_s = 1e-3;
    const double along_mm =
        point.normal.dot(effects.drift_mm_per_s) * kStep_s / std::min(point.normal.dot(ray), -0.05);
    const ProjectedPoint moved = lamp.project(point.point_mm + along_mm * ray);
    // Light stays where it is; the sample moves under it.
    shift_px_per_s[0].push_back(static_cast<float>((at.col_px - moved.col_px) / kStep_s));
    shift_px_per_s[1].push_back(static_cast<float>((at.row_px - moved.row_px) / kStep_s));
  }
  if (effects.black_frac > 0) {
    Picture white;
    white.brightness = Image<unsigned char>(light->height_px(), light->width_px(), 1, 255);
    under_white = reflected(white, std::chrono::nanoseconds(0));
  }
}

// Reflected light [frame sample], relative to the standard.
std::vector<float> HeadWorld::Parts::reflected(const Picture& picture,
                                               std::chrono::nanoseconds elapsed) const {
  std::vector<float> linear(static_cast<std::size_t>(camera.height_px) *
                                static_cast<std::size_t>(camera.width_px) *
                                static_cast<std::size_t>(channel_count),
                            0.0F);
  LineOptics moved;
  for (std::size_t axis = 0; axis < 2; ++axis)
    for (const float rate : shift_px_per_s[axis])
      moved.shift_px[axis].push_back(rate * std::chrono::duration<float>(elapsed).count());
  if (!shift_px_per_s[0].empty()) moved.blur_px = optics.blur_px;
  transport.add_light(picture.brightness.view(), shift_px_per_s[0].empty() ? optics : moved,
                      linear);
  if (options.has_indirect) indirect.add_light(picture.brightness.view(), seen, linear);
  return linear;
}

Image<float> HeadWorld::Parts::linear_image(const Picture& picture,
                                            std::chrono::nanoseconds elapsed) const {
  Image<float> image(camera.height_px, camera.width_px, channel_count);
  if (seen.samples.empty()) return image;
  estimation::check(picture.brightness.height_px() == light->height_px() &&
                        picture.brightness.width_px() == light->width_px(),
                    "a picture of another size than the projector's");
  std::vector<float> linear;
  arena.execute([&] { linear = reflected(picture, elapsed); });
  const auto& signal_per_us = calibration.irradiance->signal_per_us;
  const auto black = static_cast<float>(options.effects.black_frac);
  for (std::size_t i = 0; i < seen.samples.size(); ++i) {
    const auto sample = static_cast<std::size_t>(seen.samples[i].sample);
    float value = linear[sample];
    if (!under_white.empty()) value += black * under_white[sample];
    image.samples()[sample] =
        value * lens[i] *
        static_cast<float>(
            signal_per_us[std::min<std::size_t>(seen.bands[i], signal_per_us.size() - 1)]);
  }
  return image;
}

std::shared_ptr<const HeadWorld::Parts::Prepared> HeadWorld::Parts::prepared_image(
    const Picture& picture, std::chrono::nanoseconds elapsed) const {
  if (!options.effects.drifts()) elapsed = std::chrono::nanoseconds(0);
  std::shared_ptr<Prepared> entry;
  {
    const std::lock_guard lock(prepared_mutex);
    const auto found = std::find_if(prepared.begin(), prepared.end(), [&](const auto& each) {
      return each->picture_id == picture.id && each->elapsed == elapsed;
    });
    if (found != prepared.end()) {
      prepared.splice(prepared.begin(), prepared, found);
    } else {
      prepared.push_front(std::make_shared<Prepared>());
      prepared.front()->picture_id = picture.id;
      prepared.front()->elapsed = elapsed;
      if (prepared.size() > kPreparedLimit) prepared.pop_back();
    }
    entry = prepared.front();
  }
  std::call_once(entry->once, [&] { entry->linear = linear_image(picture, elapsed); });
  return entry;
}

std::chrono::nanoseconds HeadWorld::Parts::elapsed_at(std::chrono::nanoseconds start) const {
  const std::lock_guard lock(prepared_mutex);
  if (!first_exposure) first_exposure = start;
  return start - *first_exposure;
}

std::vector<float> HeadWorld::Parts::room_light(const Exposure& exposure) const {
  if (room.empty()) return {};
  std::vector<float> frame_dn(static_cast<std::size_t>(camera.height_px) *
                                  static_cast<std::size_t>(camera.width_px) *
                                  static_cast<std::size_t>(channel_count),
                              0.0F);
  const double time_us = flicker(exposure) * static_cast<double>(exposure.duration.count());
  const auto& signal_per_us = calibration.irradiance->signal_per_us;
  for (std::size_t i = 0; i < seen.samples.size(); ++i)
    frame_dn[static_cast<std::size_t>(seen.samples[i].sample)] = static_cast<float>(
        static_cast<double>(room[i]) * time_us *
        signal_per_us[std::min<std::size_t>(seen.bands[i], signal_per_us.size() - 1)]);
  return frame_dn;
}

double HeadWorld::Parts::flicker(const Exposure& exposure) const {
  // The mean of 1 + f sin(w t) over the exposure; light follows the mains' power, twice a period.
  const double rate = 2 * std::numbers::pi * 2 * options.effects.mains_hz;
  const double begin_s = std::chrono::duration<double>(exposure.start).count();
  const double length_s = std::chrono::duration<double>(exposure.duration).count();
  if (!(length_s > 0)) return 1;
  const double begin = std::fmod(rate * begin_s, 2 * std::numbers::pi);
  return 1 + options.effects.flicker_frac * (std::cos(begin) - std::cos(begin + rate * length_s)) /
                 (rate * length_s);
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
  const auto tell = [&](double done_frac, const std::string& what) {
    if (progress) progress(done_frac, what);
  };

  auto parts = std::make_unique<Parts>();
  Parts& p = *parts;
  p.camera = camera;
  p.calibration = calibration;
  p.options = options;
  p.channel_count = estimation::sample_channel_count(camera.pixel_format.filter);
  p.skin = std::move(scene->skin);
  p.sensor = {*camera.black_level_dn, *camera.gain_e_per_dn, *camera.read_noise_e,
              (1 << camera.pixel_format.bit_depth) - 1, options.seed};
  p.arena.initialize(options.thread_count > 0 ? options.thread_count : tbb::task_arena::automatic);
  p.arena.execute([&] {
    tell(0, "mesh");
    p.surface = std::make_unique<Surface>(std::move(scene->shape));
    const Pinhole eye(calibration.camera, estimation::Mat3::eye(), {0, 0, 0});
    const Pinhole lamp(calibration.projector, calibration.projector_from_camera,
                       calibration.projector_from_camera_mm);
    p.light =
        std::make_unique<ProjectorLight>(*p.surface, lamp, projector.height_px, projector.width_px,
                                         *calibration.irradiance->reference_distance_mm);
    tell(0.02, "camera rays");
    p.seen = find_seen_points(camera, eye, lamp, projector.height_px, projector.width_px,
                              *p.surface, *p.skin);
    if (options.scattering == ScatteringModel::kMonteCarlo && !p.seen.samples.empty())
      p.scattering = ScatterTable::cached(
          options.cache_folder, options.photons_per_angle, kPhotonSeed,
          [&](double done_frac) { tell(0.03 + 0.3 * done_frac, "photons through skin"); });
    const TransportCache cache(
        options.cache_folder,
        cache_key(camera, projector, calibration, options.name, options.scattering,
                  options.photons_per_angle, p.seen.samples));
    if (cache.load(p.transport, p.seen.samples, *p.light, p.table())) {
      tell(0.9, "light transport from the cache");
    } else {
      tell(0.33, "projector rays");
      p.transport = Transport::build(p.seen.samples, *p.light, p.table(), [&](double done_frac) {
        tell(0.35 + 0.55 * done_frac, "light transport");
      });
      cache.save(p.transport);
    }
    if (options.has_indirect) {
      tell(0.9, "interreflection");
      p.light->coarse();  // read for every picture: cast it now, not under the first one
      p.indirect = Interreflection(*p.surface, *p.skin, *p.light, p.seen, p.total_reflectance());
    }
    p.prepare_effects(lamp, eye);
    tell(1, "ready");
  });
  return std::unique_ptr<HeadWorld>(new HeadWorld(std::move(parts)));
}

int HeadWorld::width_px() const { return parts_->camera.width_px; }
int HeadWorld::height_px() const { return parts_->camera.height_px; }
int HeadWorld::channel_count() const { return parts_->channel_count; }

void HeadWorld::prepare(const std::shared_ptr<const Picture>& picture) const {
  // What moves is computed for its moment.
  if (picture && !parts_->options.effects.drifts())
    parts_->prepared_image(*picture, std::chrono::nanoseconds(0));
}

Image<float> HeadWorld::linear_image(const Picture& picture,
                                     std::chrono::nanoseconds elapsed) const {
  return parts_->linear_image(picture, elapsed);
}

void HeadWorld::expose(const Exposure& exposure,
                       estimation::ImageView<std::uint16_t> frame_dn) const {
  const Parts& p = *parts_;
  estimation::check(frame_dn.height_px == height_px() && frame_dn.width_px == width_px() &&
                        frame_dn.channel_count == p.channel_count,
                    "a frame of another size than the camera's");
  struct Light {
    std::shared_ptr<const Parts::Prepared> image;
    float time_us;
  };
  const std::chrono::nanoseconds middle = p.elapsed_at(exposure.start) + exposure.duration / 2;
  std::vector<Light> lights;
  for (const LightSegment& segment : exposure.light)
    if (segment.picture)
      lights.push_back({p.prepared_image(*segment.picture, middle),
                        std::chrono::duration<float, std::micro>(segment.duration).count()});
  const std::vector<float> room = p.room_light(exposure);
  const int row_samples = frame_dn.width_px * frame_dn.channel_count;
  p.arena.execute([&] {
    tbb::parallel_for(tbb::blocked_range<int>(0, frame_dn.height_px, 32),
                      [&](const tbb::blocked_range<int>& rows) {
                        std::vector<float> signal_dn(static_cast<std::size_t>(row_samples));
                        for (int row = rows.begin(); row < rows.end(); ++row) {
                          std::fill(signal_dn.begin(), signal_dn.end(), 0.0F);
                          if (!room.empty())
                            std::copy_n(room.begin() + std::ptrdiff_t{row} * row_samples,
                                        row_samples, signal_dn.begin());
                          for (const Light& each : lights) {
                            const auto linear = each.image->linear.view().row(row);
                            for (std::size_t i = 0; i < signal_dn.size(); ++i)
                              signal_dn[i] += each.time_us * linear[i];
                          }
                          p.sensor.digitise(signal_dn.data(), exposure.trigger_number,
                                            static_cast<std::int64_t>(row) * row_samples,
                                            row_samples, frame_dn.row(row).data());
                        }
                      });
  });
}

estimation::Result<void> HeadWorld::write_truth(const std::filesystem::path& folder) const {
  const Parts& p = *parts_;
  Picture white;
  white.brightness = Image<unsigned char>(p.light->height_px(), p.light->width_px(), 1, 255);
  estimation::Result<void> written;
  p.arena.execute([&] {
    std::vector<std::array<float, 3>> received;
    if (p.options.has_indirect)
      received = p.indirect.received(std::as_const(white.brightness).view());
    written = hw_sim::write_truth(folder, p.camera, p.seen, *p.light, received,
                                  p.options.scattering, p.total_reflectance());
  });
  return written;
}

}  // namespace hw_sim
