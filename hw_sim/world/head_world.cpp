#include "hw_sim/world/head_world.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <list>
#include <mutex>
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
  std::string missing, unsupported;
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
  need(unsupported, irradiance->vignetting_file.has_value(), "vignetting");
  need(unsupported, camera.flat_field_file.has_value(), "a flat field");
  need(unsupported, calibration.stripe_transfer.has_value(), "stripe_transfer");
  const auto& black = calibration.projector_black_dn_per_us;
  need(unsupported, std::any_of(black.begin(), black.end(), [](double b) { return b != 0; }),
       "projector_black");
  if (!unsupported.empty())
    return rig::failure(rig::Fault::kUnsupported, "the simulated optics are perfect: remove " +
                                                      unsupported +
                                                      " from the calibration of this virtual rig");
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

  // Linear images of the pictures used last. Whoever needs one first computes it; others wait in
  // its once_flag.
  struct Prepared {
    std::uint64_t picture_id;
    std::once_flag once;
    Image<float> linear;
  };
  static constexpr std::size_t kPreparedLimit = 6;
  mutable std::mutex prepared_mutex;
  mutable std::list<std::shared_ptr<Prepared>> prepared;  // newest first; guarded by prepared_mutex

  TotalReflectance total_reflectance() const {
    if (scattering)
      return [this](const Scattering& medium) { return scattering->total_reflectance(medium); };
    return [](const Scattering& medium) { return Dipole(medium).total_reflectance(); };
  }
  const ScatterTable* table() const { return scattering ? &*scattering : nullptr; }

  Image<float> linear_image(const Picture& picture) const;
  // Shared: an exposure may still read an image that newer pictures have pushed out.
  std::shared_ptr<const Prepared> prepared_image(const Picture& picture) const;
};

Image<float> HeadWorld::Parts::linear_image(const Picture& picture) const {
  Image<float> image(camera.height_px, camera.width_px, channel_count);
  if (seen.samples.empty()) return image;
  estimation::check(picture.brightness.height_px() == light->height_px() &&
                        picture.brightness.width_px() == light->width_px(),
                    "a picture of another size than the projector's");
  std::vector<float> linear(image.samples().size(), 0.0F);
  arena.execute([&] {
    transport.add_light(picture.brightness.view(), linear);
    if (options.has_indirect) indirect.add_light(picture.brightness.view(), seen, linear);
  });
  const auto& signal_per_us = calibration.irradiance->signal_per_us;
  for (std::size_t i = 0; i < seen.samples.size(); ++i) {
    const auto sample = static_cast<std::size_t>(seen.samples[i].sample);
    image.samples()[sample] =
        linear[sample] *
        static_cast<float>(
            signal_per_us[std::min<std::size_t>(seen.bands[i], signal_per_us.size() - 1)]);
  }
  return image;
}

std::shared_ptr<const HeadWorld::Parts::Prepared> HeadWorld::Parts::prepared_image(
    const Picture& picture) const {
  std::shared_ptr<Prepared> entry;
  {
    const std::lock_guard lock(prepared_mutex);
    const auto found = std::find_if(prepared.begin(), prepared.end(), [&](const auto& each) {
      return each->picture_id == picture.id;
    });
    if (found != prepared.end()) {
      prepared.splice(prepared.begin(), prepared, found);
    } else {
      prepared.push_front(std::make_shared<Prepared>());
      prepared.front()->picture_id = picture.id;
      if (prepared.size() > kPreparedLimit) prepared.pop_back();
    }
    entry = prepared.front();
  }
  std::call_once(entry->once, [&] { entry->linear = linear_image(picture); });
  return entry;
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
    tell(1, "ready");
  });
  return std::unique_ptr<HeadWorld>(new HeadWorld(std::move(parts)));
}

int HeadWorld::width_px() const { return parts_->camera.width_px; }
int HeadWorld::height_px() const { return parts_->camera.height_px; }
int HeadWorld::channel_count() const { return parts_->channel_count; }

void HeadWorld::prepare(const std::shared_ptr<const Picture>& picture) const {
  if (picture) parts_->prepared_image(*picture);
}

Image<float> HeadWorld::linear_image(const Picture& picture) const {
  return parts_->linear_image(picture);
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
  std::vector<Light> lights;
  for (const LightSegment& segment : exposure.light)
    if (segment.picture)
      lights.push_back({p.prepared_image(*segment.picture),
                        std::chrono::duration<float, std::micro>(segment.duration).count()});
  const int row_samples = frame_dn.width_px * frame_dn.channel_count;
  p.arena.execute([&] {
    tbb::parallel_for(tbb::blocked_range<int>(0, frame_dn.height_px, 32),
                      [&](const tbb::blocked_range<int>& rows) {
                        std::vector<float> signal_dn(static_cast<std::size_t>(row_samples));
                        for (int row = rows.begin(); row < rows.end(); ++row) {
                          std::fill(signal_dn.begin(), signal_dn.end(), 0.0F);
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
