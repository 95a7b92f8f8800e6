#include "hw_sim/world/head_light.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "hw_sim/world/transport_cache.h"
#include "hw_sim/world/truth.h"

namespace hw_sim {

using estimation::Image;
using estimation::Vec3;

namespace {

constexpr std::uint64_t kPhotonSeed = 20260;  // one walk serves all scenes
constexpr double kEyeReflectance = 0.4;       // white and iris together

// How much a vignetted lens passes at a place of its picture.
double lens_passes(double lost_frac, double row_px, double col_px, int height_px, int width_px) {
  const double row = row_px - 0.5 * (height_px - 1), col = col_px - 0.5 * (width_px - 1);
  const double corner2 =
      0.25 * ((height_px - 1.0) * (height_px - 1.0) + (width_px - 1.0) * (width_px - 1.0));
  return std::max(0.0, 1 - lost_frac * (row * row + col * col) / std::max(corner2, 1.0));
}

// Projector pixels that a place moves by for each mm its surface moves along its normal: the ray of
// a camera pixel meets the moved tangent plane elsewhere.
Slide slide_of(const SeenPoint& point, const Pinhole& eye, const Pinhole& lamp) {
  const Vec3 towards = point.point_mm - eye.center_mm(), ray = towards / cv::norm(towards);
  constexpr double kStep_mm = 1e-2;
  const double along_mm = kStep_mm / std::min(point.normal.dot(ray), -0.05);
  const ProjectedPoint at = lamp.project(point.point_mm);
  const ProjectedPoint moved = lamp.project(point.point_mm + along_mm * ray);
  Slide slide;
  for (int axis = 0; axis < 3; ++axis)
    slide.normal[static_cast<std::size_t>(axis)] = point.normal[axis];
  slide.px_per_mm = {static_cast<float>((moved.col_px - at.col_px) / kStep_mm),
                     static_cast<float>((moved.row_px - at.row_px) / kStep_mm)};
  return slide;
}

}  // namespace

HeadLight::HeadLight(const estimation::CameraInfo& camera,
                     const estimation::ProjectorInfo& projector,
                     const estimation::Calibration& calibration, const SceneOptions& options,
                     Scene scene, const Progress& progress)
    : camera_(camera),
      calibration_(calibration),
      options_(options),
      eye_(calibration.camera, estimation::Mat3::eye(), {0, 0, 0}),
      lamp_(calibration.projector, calibration.projector_from_camera,
            calibration.projector_from_camera_mm),
      channel_count_(estimation::sample_channel_count(camera.pixel_format.filter)),
      skin_(std::move(scene.skin)) {
  progress(0, "mesh");
  surface_ = std::make_unique<Surface>(std::move(scene.shape));
  light_ =
      std::make_unique<ProjectorLight>(*surface_, lamp_, projector.height_px, projector.width_px,
                                       *calibration.irradiance->reference_distance_mm);
  progress(0.02, "camera rays");
  seen_ = find_seen_points(camera, eye_, lamp_, projector.height_px, projector.width_px, *surface_,
                           *skin_, options.effects.crosstalk_frac);
  prepare_transport(projector, progress);
  if (options.has_indirect) {
    progress(0.9, "interreflection");
    prepare_indirect();
  }
  prepare_samples();
  if (has_wall()) prepare_wall();
  prepare_slots();
  prepare_frame();
  progress(1, "ready");
}

std::size_t HeadLight::frame_sample_count() const {
  return static_cast<std::size_t>(camera_.height_px) * static_cast<std::size_t>(camera_.width_px) *
         static_cast<std::size_t>(channel_count_);
}

std::size_t HeadLight::frame_sample(int row, int col, int channel) const {
  const int sample = (row * camera_.width_px + col) * channel_count_ + channel;
  return static_cast<std::size_t>(sample);
}

double HeadLight::lamp_passes(double row_px, double col_px) const {
  return lens_passes(options_.effects.vignetting_frac, row_px, col_px, light_->height_px(),
                     light_->width_px());
}

TotalReflectance HeadLight::total_reflectance() const {
  if (scattering_)
    return [this](const Scattering& medium) { return scattering_->total_reflectance(medium); };
  return [](const Scattering& medium) { return Dipole(medium).total_reflectance(); };
}

void HeadLight::prepare_transport(const estimation::ProjectorInfo& projector,
                                  const Progress& progress) {
  if (options_.scattering == ScatteringModel::kMonteCarlo && !seen_.samples.empty())
    scattering_ = ScatterTable::cached(
        options_.cache_folder, options_.photons_per_angle, kPhotonSeed,
        [&](double done_frac) { progress(0.03 + 0.3 * done_frac, "photons through skin"); });
  const TransportCache cache(
      options_.cache_folder,
      cache_key(camera_, projector, calibration_, options_.name, options_.scattering,
                options_.photons_per_angle, seen_.samples));
  if (cache.load(transport_, seen_.samples, *light_, table())) {
    progress(0.9, "light transport from the cache");
    return;
  }
  progress(0.33, "projector rays");
  transport_ = Transport::build(seen_.samples, *light_, table(), [&](double done_frac) {
    progress(0.35 + 0.55 * done_frac, "light transport");
  });
  cache.save(transport_);
}

void HeadLight::prepare_indirect() {
  const Effects& effects = options_.effects;
  InterreflectionOptions options{
      .bounces = options_.bounces,
      .backdrop = {effects.backdrop_mm, effects.backdrop_reflectance_frac},
      .lamp_passes = {}};
  if (effects.vignetting_frac > 0)
    options.lamp_passes = [this](double row, double col) { return lamp_passes(row, col); };
  indirect_ = Interreflection(*surface_, *skin_, *light_, seen_, total_reflectance(), options);
}

void HeadLight::prepare_samples() {
  const Effects& effects = options_.effects;
  double greatest_blur_px = 0;
  for (std::size_t i = 0; i < seen_.samples.size(); ++i) {
    const SeenPoint& point = seen_.points[static_cast<std::size_t>(seen_.owners[i])];
    const SeenSample& sample = seen_.samples[i];
    const ProjectedPoint at = lamp_.project(point.point_mm);
    const Vec3 to_lamp = lamp_.center_mm() - point.point_mm;
    const double distance_mm = cv::norm(to_lamp);
    const double blur_px = effects.blurs() ? effects.blur_at(distance_mm) : 0;
    greatest_blur_px = std::max(greatest_blur_px, blur_px);
    if (effects.blurs()) optics_.blur_px.push_back(static_cast<float>(blur_px));
    const double passes = lamp_passes(at.row_px, at.col_px);
    lamp_passes_.push_back(static_cast<float>(passes));
    const Slide slide = effects.drifts() ? slide_of(point, eye_, lamp_) : Slide{};
    if (effects.drifts()) slides_.push_back(slide);
    if (!point.is_lit) continue;
    const double nearness = light_->reference_distance_mm() / distance_mm;
    const double irradiance = passes * point.cos_projector * nearness * nearness;
    DirectSample direct{.sample = sample.sample,
                        .col_px = static_cast<float>(at.col_px),
                        .row_px = static_cast<float>(at.row_px),
                        .blur_px = static_cast<float>(blur_px),
                        .weight = 0,
                        .slide = slide};
    if (!effects.is_cross_polarised) {
      const Vec3 towards_eye = (eye_.center_mm() - point.point_mm) / cv::norm(point.point_mm);
      direct.weight =
          sample.share *
          static_cast<float>(irradiance * shine(point.normal, to_lamp / distance_mm, towards_eye,
                                                effects.skin_roughness_frac));
      direct_.add(direct);
    }
    if (effects.blink_s > 0 && point.skin.is_eye) {
      direct.weight = sample.share * static_cast<float>(irradiance * kEyeReflectance);
      eyes_.add(direct);
    }
  }
  optics_.lamp = LampResponse(effects.gamma, effects.pixel_fill_frac, greatest_blur_px);
}

// What the camera sees beside the subject.
void HeadLight::prepare_wall() {
  const Effects& effects = options_.effects;
  std::vector<bool> is_taken(frame_sample_count(), false);
  for (const SeenSample& sample : seen_.samples)
    is_taken[static_cast<std::size_t>(sample.sample)] = true;
  const auto greatest_blur_px =
      optics_.blur_px.empty() ? 0.0F
                              : *std::max_element(optics_.blur_px.begin(), optics_.blur_px.end());
  for (int row = 0; row < camera_.height_px; ++row)
    for (int col = 0; col < camera_.width_px; ++col) {
      const int first = (row * camera_.width_px + col) * channel_count_;
      if (is_taken[static_cast<std::size_t>(first)]) continue;
      const Vec3 ray = eye_.ray(col + camera_.roi_x_px, row + camera_.roi_y_px).direction;
      const Vec3 point = effects.backdrop_mm / ray[2] * ray;
      const Vec3 to_lamp = lamp_.center_mm() - point;
      const double distance_mm = cv::norm(to_lamp);
      const double cosine = -to_lamp[2] / distance_mm;
      const ProjectedPoint at = lamp_.project(point);
      if (!at.is_in_front || !surface_->is_seen_from(lamp_.center_mm(), point, {0, 0, -1}))
        continue;
      const double nearness = light_->reference_distance_mm() / distance_mm;
      const double weight = effects.backdrop_reflectance_frac * cosine * nearness * nearness *
                            lamp_passes(at.row_px, at.col_px);
      for (int channel = 0; channel < channel_count_; ++channel)
        direct_.add({.sample = first + channel,
                     .col_px = static_cast<float>(at.col_px),
                     .row_px = static_cast<float>(at.row_px),
                     .blur_px = std::min(greatest_blur_px,
                                         static_cast<float>(effects.blur_at(distance_mm))),
                     .weight = static_cast<float>(weight),
                     .slide = {}});
    }
}

void HeadLight::prepare_slots() {
  const ShutterLight::Slots slots = ShutterLight::slots(options_.effects, light_->height_px());
  if (slots.band_count * slots.row_count == 1) return;
  slots_.assign(frame_sample_count(), 0);
  for (int row = 0; row < camera_.height_px; ++row)
    for (int col = 0; col < camera_.width_px; ++col)
      for (int channel = 0; channel < channel_count_; ++channel)
        slots_[frame_sample(row, col, channel)] = static_cast<std::uint32_t>(
            slots.at(estimation::band_at(camera_, row, col, channel), 0));
  const auto set = [&](std::int32_t sample, double row_px) {
    std::uint32_t& slot = slots_[static_cast<std::size_t>(sample)];
    const auto rows = static_cast<std::uint32_t>(slots.row_count);
    slot += static_cast<std::uint32_t>(slots.at(0, row_px)) - slot % rows;
  };
  for (std::size_t i = 0; i < seen_.samples.size(); ++i) {
    const SeenPoint& point = seen_.points[static_cast<std::size_t>(seen_.owners[i])];
    set(seen_.samples[i].sample, lamp_.project(point.point_mm).row_px);
  }
  for (const DirectSample& each : direct_.samples())
    set(each.sample, static_cast<double>(each.row_px));
}

void HeadLight::prepare_frame() {
  const Effects& effects = options_.effects;
  const auto& signal_per_us = calibration_.irradiance->signal_per_us;
  for (int row = 0; row < camera_.height_px; ++row)
    for (int col = 0; col < camera_.width_px; ++col)
      for (int channel = 0; channel < channel_count_; ++channel) {
        const auto band = static_cast<std::size_t>(estimation::band_at(camera_, row, col, channel));
        scale_.push_back(
            static_cast<float>(lens_passes(effects.camera_vignetting_frac, row, col,
                                           camera_.height_px, camera_.width_px) *
                               signal_per_us[std::min(band, signal_per_us.size() - 1)]));
      }
  if (effects.camera_blurs()) {
    double mean_mm = effects.camera_focus_mm;  // of nothing but background
    if (!seen_.points.empty()) mean_mm = 0;
    for (const SeenPoint& point : seen_.points)
      mean_mm += cv::norm(point.point_mm) / static_cast<double>(seen_.points.size());
    if (has_wall()) mean_mm = effects.backdrop_mm;
    Image<float> blur_px(camera_.height_px, camera_.width_px, 1,
                         static_cast<float>(effects.camera_blur_at(mean_mm)));
    for (const SeenPoint& point : seen_.points)
      blur_px.at(point.row, point.col) =
          static_cast<float>(effects.camera_blur_at(cv::norm(point.point_mm)));
    const auto filter = camera_.pixel_format.filter;
    const bool is_mosaic =
        filter != estimation::ColorFilter::kMono && filter != estimation::ColorFilter::kRgb;
    blur_ = CameraBlur(std::move(blur_px), is_mosaic ? 2 : 1);
  }
  if (effects.ambient_frac > 0) {
    room_ = Image<float>(camera_.height_px, camera_.width_px, channel_count_);
    const TotalReflectance reflectance_of = total_reflectance();
    std::vector<bool> is_skin(frame_sample_count(), false);
    for (const SeenSample& sample : seen_.samples) {
      const auto at = static_cast<std::size_t>(sample.sample);
      room_.samples()[at] += sample.share * static_cast<float>(reflectance_of(sample.scattering));
      is_skin[at] = true;
    }
    for (std::size_t i = 0; i < is_skin.size(); ++i) {
      if (!is_skin[i]) room_.samples()[i] = static_cast<float>(effects.backdrop_reflectance_frac);
      room_.samples()[i] *= static_cast<float>(effects.ambient_frac) * scale_[i];
    }
    blur_.apply(room_);
  }
  if (effects.black_frac > 0) {
    Picture white;
    white.brightness = Image<unsigned char>(light_->height_px(), light_->width_px(), 1, 255);
    under_white_ = reflected(white, {});
  }
}

Moment HeadLight::moment(double begin_s, double end_s) const {
  return {options_.effects.drifts() ? options_.effects.displacement_mm((begin_s + end_s) / 2)
                                    : Vec3(0, 0, 0),
          options_.effects.blink_frac(begin_s, end_s)};
}

// [frame sample], relative to the standard.
std::vector<float> HeadLight::reflected(const Picture& picture, const Moment& moment) const {
  const auto brightness = picture.brightness.view();
  LineOptics moved;
  const LineOptics* optics = &optics_;
  if (!slides_.empty()) {
    moved = optics_;
    for (std::size_t axis = 0; axis < 2; ++axis)
      for (const Slide& slide : slides_)
        moved.shift_px[axis].push_back(slide.shift_px(axis, moment.displacement_mm));
    optics = &moved;
  }
  const std::vector<float> scattered = transport_.reflected(brightness, *optics);
  const std::vector<float> bounced = options_.has_indirect
                                         ? indirect_.reflected(brightness, optics_.lamp, seen_)
                                         : std::vector<float>{};
  std::vector<float> linear(frame_sample_count(), 0.0F);
  for (std::size_t i = 0; i < scattered.size(); ++i)
    linear[static_cast<std::size_t>(seen_.samples[i].sample)] +=
        seen_.samples[i].share *
        (lamp_passes_[i] * scattered[i] + (bounced.empty() ? 0.0F : bounced[i]));
  direct_.add_light(brightness, optics_.lamp, moment.displacement_mm, linear);
  if (moment.blink_frac > 0) {
    const auto open = static_cast<float>(moment.blink_frac);
    std::vector<float> eyes(linear.size(), 0.0F);
    eyes_.add_light(brightness, optics_.lamp, moment.displacement_mm, eyes);
    std::vector<bool> is_done(linear.size(), false);
    for (const DirectSample& each : eyes_.samples()) {
      const auto at = static_cast<std::size_t>(each.sample);
      if (is_done[at]) continue;
      is_done[at] = true;
      linear[at] = (1 - open) * linear[at] + open * eyes[at];
    }
  }
  return linear;
}

Image<float> HeadLight::linear_image(const Picture& picture, const Moment& moment) const {
  estimation::check(picture.brightness.height_px() == light_->height_px() &&
                        picture.brightness.width_px() == light_->width_px(),
                    "a picture of another size than the projector's");
  Image<float> image(camera_.height_px, camera_.width_px, channel_count_);
  if (seen_.samples.empty() && direct_.empty()) return image;
  const std::vector<float> linear = reflected(picture, moment);
  const auto black = static_cast<float>(options_.effects.black_frac);
  for (std::size_t i = 0; i < linear.size(); ++i)
    image.samples()[i] =
        scale_[i] * (under_white_.empty() ? linear[i] : linear[i] + black * under_white_[i]);
  blur_.apply(image);
  return image;
}

estimation::Result<void> HeadLight::write_truth(const std::filesystem::path& folder) const {
  const Image<unsigned char> white(light_->height_px(), light_->width_px(), 1, 255);
  std::vector<std::array<float, 3>> received;
  if (options_.has_indirect) received = indirect_.received(white.view(), optics_.lamp);
  return hw_sim::write_truth(folder, camera_, seen_, *light_, received, options_.scattering,
                             total_reflectance());
}

}  // namespace hw_sim
