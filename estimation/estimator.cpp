#include "estimation/estimator.h"

#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <optional>
#include <utility>

#include "estimation/geometry/correspondence.h"
#include "estimation/geometry/surface.h"
#include "estimation/models/scattering_model.h"
#include "estimation/profile/fill_sites.h"
#include "estimation/profile/profile_point.h"
#include "estimation/profile/profile_table.h"
#include "estimation/profile/scene_fit.h"
#include "estimation/profile/stripe_set.h"
#include "estimation/profile/stripe_transfer.h"
#include "estimation/radiometry/illumination.h"
#include "estimation/radiometry/merge.h"
#include "estimation/radiometry/noise.h"
#include "estimation/radiometry/signal_store.h"
#include "estimation/session/frame_io.h"

namespace estimation {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// Beyond this angle "our data is unreliable" (the paper, section 5): one degree of normal is then
// 6.5% of irradiance.
constexpr double kGrazingDegrees = 75;

// Frames read ahead of the merge by estimate_session.
constexpr std::size_t kReadAhead = 16;

// What the contract marks G: without these, geometry alone.
std::vector<std::string> missing_for_radiometry(const Manifest& manifest) {
  std::vector<std::string> missing;
  if (!manifest.camera.black_level_dn && manifest.camera.dark_frames.empty())
    missing.push_back("camera.black_level");
  if (!manifest.camera.saturation_level_dn) missing.push_back("camera.saturation_level");
  if (!manifest.calibration.irradiance || manifest.calibration.irradiance->signal_per_us.empty())
    missing.push_back("calibration.irradiance.signal_per_us");
  return missing;
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

// The same error with the manifest's key that names the file.
InputError named_by(const std::string& key, InputError error) {
  error.place = error.place.empty() ? key : key + ", " + error.place;
  return error;
}

Result<std::map<std::string, Image<float>>> read_channels(const std::filesystem::path& session,
                                                          const std::string& name,
                                                          const std::string& place) {
  const auto path = resolve_in_session(session, name, place);
  if (!path) return tl::unexpected(path.error());
  auto channels = read_exr(*path);
  if (!channels) return tl::unexpected(named_by(place, channels.error()));
  return channels;
}

// A single-channel EXR of a required size; an empty image if no file is named.
Result<Image<float>> read_single(const std::filesystem::path& session,
                                 const std::optional<std::string>& name, const std::string& place,
                                 int height_px, int width_px) {
  if (!name) return Image<float>();
  auto channels = read_channels(session, *name, place);
  if (!channels) return tl::unexpected(channels.error());
  const auto wrong = [&](const std::string& expectation) {
    return tl::unexpected(
        InputError{InputFault::kInvalid, (session / *name).string(), place, expectation});
  };
  if (channels->size() != 1)
    return wrong("has " + std::to_string(channels->size()) + " channels; expected one");
  Image<float>& image = channels->begin()->second;
  if (image.height_px() != height_px || image.width_px() != width_px)
    return wrong("is " + std::to_string(image.width_px()) + " x " +
                 std::to_string(image.height_px()) + " px; expected " + std::to_string(width_px) +
                 " x " + std::to_string(height_px));
  return std::move(image);
}

Result<CameraBlack> read_black(const Manifest& manifest, const std::filesystem::path& session) {
  if (manifest.camera.black_level_dn) return CameraBlack(*manifest.camera.black_level_dn);
  if (manifest.camera.dark_frames.empty()) return CameraBlack(0.0);  // geometry needs no black
  std::vector<CameraBlack::Dark> darks;
  for (const DarkFrame& dark : manifest.camera.dark_frames) {
    auto frame = read_frame(session, manifest, dark.file);
    if (!frame)
      return tl::unexpected(
          named_by("/camera/dark_frames/" + std::to_string(darks.size()) + "/file", frame.error()));
    darks.push_back({dark.exposure_us, std::move(*frame)});
  }
  return CameraBlack(std::move(darks));
}

// Of the calibration, read and checked once.
struct Auxiliary {
  CameraBlack black{0.0};
  Image<float> flat_field, vignetting;
  HarmonicTransfer transfer;
};

Result<Auxiliary> read_auxiliary(const Manifest& manifest, const std::filesystem::path& session) {
  const CameraInfo& camera = manifest.camera;
  const Calibration& calibration = manifest.calibration;
  auto black = read_black(manifest, session);
  if (!black) return tl::unexpected(black.error());
  auto flat_field = read_single(session, camera.flat_field_file, "/camera/flat_field",
                                camera.height_px, camera.width_px);
  if (!flat_field) return tl::unexpected(flat_field.error());
  auto vignetting = read_single(
      session, calibration.irradiance ? calibration.irradiance->vignetting_file : std::nullopt,
      "/calibration/irradiance/vignetting", manifest.projector.height_px,
      manifest.projector.width_px);
  if (!vignetting) return tl::unexpected(vignetting.error());
  std::map<std::string, Image<float>> transfer_maps;
  if (calibration.stripe_transfer)
    if (const auto* file = std::get_if<TransferFile>(&*calibration.stripe_transfer)) {
      auto channels = read_channels(session, file->file, "/calibration/stripe_transfer");
      if (!channels) return tl::unexpected(channels.error());
      transfer_maps = std::move(*channels);
    }
  auto transfer = HarmonicTransfer::create(calibration.stripe_transfer, transfer_maps, camera);
  if (!transfer) return tl::unexpected(transfer.error());
  return Auxiliary{.black = std::move(*black),
                   .flat_field = std::move(*flat_field),
                   .vignetting = std::move(*vignetting),
                   .transfer = std::move(*transfer)};
}

// One sample a pixel for the geometry: the sum of an RGB frame's bands.
Image<float> sum_of_channels(const Image<float>& rate) {
  Image<float> sum(rate.height_px(), rate.width_px());
  tbb::parallel_for(0, rate.height_px(), [&](int row) {
    for (int col = 0; col < rate.width_px(); ++col)
      for (int channel = 0; channel < rate.channel_count(); ++channel)
        sum.at(row, col) += rate.at(row, col, channel);
  });
  return sum;
}

// The mean of the signals that one shift was seen in more than once.
Image<float> mean_of(const std::vector<PatternRate>& patterns,
                     const std::vector<std::size_t>& sources) {
  Image<float> mean = patterns[sources[0]].rate;
  for (std::size_t i = 1; i < sources.size(); ++i)
    for (std::size_t k = 0; k < mean.samples().size(); ++k)
      mean.samples()[k] += patterns[sources[i]].rate.samples()[k];
  for (float& sample : mean.samples()) sample /= static_cast<float>(sources.size());
  return mean;
}

// Signals of a stripe set in the order of its shifts.
struct StripeSignals {
  std::vector<Image<float>> means;  // owns those seen more than once
  std::vector<ImageView<const float>> views;
};

StripeSignals signals_of(const StripeSet& stripes, const std::vector<PatternRate>& patterns) {
  StripeSignals signals;
  signals.means.reserve(stripes.sources.size());
  for (const auto& sources : stripes.sources) {
    if (sources.size() > 1) signals.means.push_back(mean_of(patterns, sources));
    signals.views.push_back(sources.size() > 1 ? signals.means.back().view()
                                               : patterns[sources[0]].rate.view());
  }
  return signals;
}

// Neighbouring shifts are so close that their differences are noise: fourth differences of 16
// shifts a period keep 0.3% of a sinusoid, those of 8 keep 4%, which would pass for a very noisy
// camera.
bool is_fine_sweep(const StripeSet& stripes) {
  constexpr int kLeastShiftsPerPeriod = 16;
  std::vector<int> gaps_px;
  for (std::size_t i = 1; i < stripes.shifts_px.size(); ++i)
    gaps_px.push_back(stripes.shifts_px[i] - stripes.shifts_px[i - 1]);
  if (gaps_px.empty()) return false;
  const auto middle = gaps_px.begin() + static_cast<std::ptrdiff_t>(gaps_px.size() / 2);
  std::nth_element(gaps_px.begin(), middle, gaps_px.end());
  return kLeastShiftsPerPeriod * *middle <= stripes.shape.period_px;
}

}  // namespace

Result<void> EstimatorOptions::validate() const {
  std::vector<std::string> problems;
  if (method != "lut") problems.push_back("method is '" + method + "'; known is: lut");
  if (const auto made = make_scattering_model(model, {.eta = eta}); !made)
    problems.push_back(made.error().text());
  if (thread_count < 0)
    problems.push_back("thread_count is " + std::to_string(thread_count) +
                       "; expected 0 (all) or more");
  if (problems.empty()) return {};
  std::string text;
  for (const std::string& problem : problems) text += (text.empty() ? "" : "; ") + problem;
  return tl::unexpected(InputError{InputFault::kInvalid, "", "options", text});
}

class Estimator::Implementation {
 public:
  Implementation(const Manifest& manifest, const EstimatorOptions& options, Auxiliary auxiliary,
                 std::unique_ptr<ScatteringModel> model)
      : manifest_(manifest),
        options_(options),
        black_(auxiliary.black),
        vignetting_(std::move(auxiliary.vignetting)),
        transfer_(std::move(auxiliary.transfer)),
        model_(std::move(model)),
        arena_(options.thread_count > 0 ? options.thread_count : tbb::task_arena::automatic),
        store_(manifest_, std::move(auxiliary.black), saturation_dn(),
               std::move(auxiliary.flat_field)) {}

  Result<void> add_frame(std::size_t frame_index, ImageView<const std::uint16_t> frame) {
    return arena_.execute([&] { return store_.add(frame_index, frame); });
  }

  Result<Maps> finish() {
    return arena_.execute([&] { return estimate(); });
  }

  const std::vector<std::string>& notes() const { return notes_; }
  const std::vector<ProfilePoint>& profiles() const { return profiles_; }
  tbb::task_arena& arena() { return arena_; }

 private:
  const CameraInfo& camera() const { return manifest_.camera; }
  int bands() const { return band_count(camera().pixel_format.filter); }
  double saturation_dn() const {
    return camera().saturation_level_dn.value_or((1 << camera().pixel_format.bit_depth) - 1);
  }

  // The outline: signals, correspondence, surface, then each band's parameters.
  Result<Maps> estimate();
  Correspondence correspond(std::span<const MergedNoise> noise);
  struct SceneImages {
    Image<float> gain;
    Image<std::uint32_t> validity;
  };
  SceneGeometry scene_geometry(const Surface& surface, Axis axis, SceneImages& images) const;
  void fit_bands(const Surface& surface, std::span<const MergedNoise> noise, Maps& maps);
  void store_band(int band, const Image<float>& pitch_mm, BandFit fit, Maps& maps) const;
  struct StripeScene {
    const StripeSet& stripes;
    std::span<const ImageView<const float>> signals;
    const SceneGeometry& geometry;
    const Image<float>& pitch_mm;
    std::span<const MergedNoise> noise;
  };
  std::vector<ProfilePoint> profiles_of(const StripeScene& scene, const Maps& maps) const;
  std::vector<MergedNoise> noise_of(const std::optional<StripeSet>& stripes) const;
  BandRadiometry radiometry_of(int band, std::span<const MergedNoise> noise) const;
  const PatternRate* fully_lit() const;

  Manifest manifest_;
  EstimatorOptions options_;
  CameraBlack black_;
  Image<float> vignetting_;
  HarmonicTransfer transfer_;
  std::unique_ptr<ScatteringModel> model_;
  tbb::task_arena arena_;
  SignalStore store_;
  SignalStore::Signals signals_;
  Correspondence correspondence_;
  std::vector<std::string> notes_;
  std::vector<ProfilePoint> profiles_;
};

Result<Maps> Estimator::Implementation::estimate() {
  signals_ = store_.take();
  notes_ = signals_.notes;
  if (signals_.patterns.empty())
    return tl::unexpected(
        InputError{InputFault::kInsufficient, "", "/frames",
                   "holds no frame of stripes, Gray code, fringes or white: nothing can be "
                   "estimated; expected the frames of the projected patterns"});
  std::vector<const PatternKind*> kinds;
  for (const PatternRate& pattern : signals_.patterns) kinds.push_back(&pattern.pattern->kind);
  const std::optional<StripeSet> stripes = choose_stripe_set(kinds);
  const std::vector<MergedNoise> noise = noise_of(stripes);

  correspondence_ = correspond(noise);
  SurfaceOptions surface_options;
  surface_options.min_cos_projector = surface_options.min_cos_camera =
      std::cos(kGrazingDegrees * std::numbers::pi / 180);
  Maps maps;
  maps.height_px = camera().height_px;
  maps.width_px = camera().width_px;
  maps.band_count = bands();
  maps.method = options_.method;
  maps.scattering_model = model_->name();
  if (correspondence_.column_px.empty() && correspondence_.row_px.empty()) {
    notes_.push_back("no correspondence could be decoded: there is no map but validity");
    for (int band = 0; band < bands(); ++band)
      maps.validity[static_cast<std::size_t>(band)] = correspondence_.validity;
    return maps;
  }
  Surface surface = reconstruct_surface(manifest_.calibration, camera(), manifest_.projector,
                                        correspondence_, surface_options);
  for (int band = 0; band < bands(); ++band)
    maps.validity[static_cast<std::size_t>(band)] = surface.validity;

  const std::vector<std::string> missing = missing_for_radiometry(manifest_);
  if (!options_.is_geometry_only && !missing.empty())
    notes_.push_back("geometry only: the session has no " + joined(missing));
  if (!options_.is_geometry_only && missing.empty()) fit_bands(surface, noise, maps);

  maps.position_mm = std::move(surface.position_mm);
  maps.normal = std::move(surface.normal);
  maps.position_sd_mm = std::move(surface.position_sd_mm);
  maps.correspondence_px = {std::move(correspondence_.column_px),
                            std::move(correspondence_.row_px)};
  maps.correspondence_sd_px = {std::move(correspondence_.column_sd_px),
                               std::move(correspondence_.row_sd_px)};
  return maps;
}

Correspondence Estimator::Implementation::correspond(std::span<const MergedNoise> noise) {
  std::vector<Image<float>> sums;
  sums.reserve(signals_.patterns.size());
  std::vector<PatternSignal> signals;
  for (const PatternRate& pattern : signals_.patterns) {
    if (std::holds_alternative<ImageFile>(pattern.pattern->kind)) continue;
    if (pattern.rate.channel_count() > 1) sums.push_back(sum_of_channels(pattern.rate));
    signals.push_back({&pattern.pattern->kind, pattern.rate.channel_count() > 1
                                                   ? sums.back().view()
                                                   : pattern.rate.view()});
  }
  CorrespondenceOptions options;
  options.noise.assign(noise.begin(), noise.end());
  Correspondence found = decode_correspondence(signals, manifest_.projector, options);
  notes_.insert(notes_.end(), found.notes.begin(), found.notes.end());
  // Their work is done; at full size they are half of all signals.
  for (PatternRate& pattern : signals_.patterns)
    if (std::holds_alternative<GrayCode>(pattern.pattern->kind)) pattern.rate = {};
  return found;
}

std::vector<MergedNoise> Estimator::Implementation::noise_of(
    const std::optional<StripeSet>& stripes) const {
  const PatternRate& typical =
      signals_.patterns[stripes ? stripes->sources.front().front() : std::size_t{0}];
  const double longest_us = typical.exposures_us.back();
  const double headroom_dn = saturation_dn() - black_.mean_dn(longest_us);
  if (camera().gain_e_per_dn.value_or(0) > 0 && camera().read_noise_e)
    return merged_noise(typical.exposures_us, {*camera().gain_e_per_dn, *camera().read_noise_e},
                        headroom_dn);
  if (stripes && is_fine_sweep(*stripes))
    if (const auto estimated = noise_from_stripes(signals_of(*stripes, signals_.patterns).views))
      return {*estimated};
  // Nothing to tell it from: a 20 ke- full well and 10 e- read noise, as cameras of this class
  // have.
  return merged_noise(typical.exposures_us, {20000 / std::max(headroom_dn, 1.0), 10}, headroom_dn);
}

BandRadiometry Estimator::Implementation::radiometry_of(int band,
                                                        std::span<const MergedNoise> noise) const {
  const auto of_band = [&](const std::vector<double>& values) {
    return values[std::min(static_cast<std::size_t>(band), values.size() - 1)];
  };
  const double signal_per_us = of_band(manifest_.calibration.irradiance->signal_per_us);
  const std::vector<double>& black = manifest_.calibration.projector_black_dn_per_us;
  // A black pattern's frames hold the projector's black already.
  const bool is_left_in = !signals_.is_black_subtracted && !black.empty();
  return {.band = band,
          .signal_per_us = signal_per_us,
          .projector_black_frac = is_left_in ? of_band(black) / signal_per_us : 0,
          .noise = noise};
}

const PatternRate* Estimator::Implementation::fully_lit() const {
  for (const PatternRate& pattern : signals_.patterns)
    if (std::holds_alternative<White>(pattern.pattern->kind)) return &pattern;
  return nullptr;
}

SceneGeometry Estimator::Implementation::scene_geometry(const Surface& surface, Axis axis,
                                                        SceneImages& images) const {
  images.gain = Image<float>(camera().height_px, camera().width_px, 1, kNan);
  images.validity = surface.validity;
  const Illumination light{
      .vignetting = vignetting_.view(),
      .reference_distance_mm = manifest_.calibration.irradiance->reference_distance_mm};
  const bool is_column = axis == Axis::kColumn;
  const Image<float>& position_px = is_column ? correspondence_.column_px : correspondence_.row_px;
  const Image<float>& pitch_mm = is_column ? surface.column_pitch_mm : surface.row_pitch_mm;
  const auto sample = [](const Image<float>& image, int row, int col) {
    return static_cast<double>(image.empty() ? kNan : image.at(row, col));
  };
  tbb::parallel_for(0, camera().height_px, [&](int row) {
    for (int col = 0; col < camera().width_px; ++col) {
      const double gain = light.at(
          sample(correspondence_.column_px, row, col), sample(correspondence_.row_px, row, col),
          sample(surface.cos_projector, row, col), sample(surface.projector_distance_mm, row, col));
      images.gain.at(row, col) = static_cast<float>(gain);
      std::uint32_t& validity = images.validity.at(row, col);
      const bool is_placed = gain > 0 && std::isfinite(sample(position_px, row, col)) &&
                             std::isfinite(sample(pitch_mm, row, col));
      if (!is_placed && (validity & kValidityErrors) == 0) validity |= kNoCorrespondence;
    }
  });
  return {.position_px = position_px.view(),
          .gain = images.gain.view(),
          .projector_distance_mm = surface.projector_distance_mm.view(),
          .validity = images.validity.view()};
}

void Estimator::Implementation::fit_bands(const Surface& surface,
                                          std::span<const MergedNoise> noise, Maps& maps) {
  std::vector<const PatternKind*> kinds;
  for (const PatternRate& pattern : signals_.patterns) {
    // Without correspondence along an axis its stripes have no known phase.
    const auto* stripes_kind = std::get_if<Stripes>(&pattern.pattern->kind);
    static const PatternKind kNone = Black{};
    const bool is_usable =
        stripes_kind == nullptr ||
        !(stripes_kind->axis == Axis::kColumn ? correspondence_.column_px : correspondence_.row_px)
             .empty();
    kinds.push_back(is_usable ? &pattern.pattern->kind : &kNone);
  }
  const std::optional<StripeSet> stripes = choose_stripe_set(kinds);
  const PatternRate* white = fully_lit();
  if (!stripes) {
    notes_.push_back(
        "no stripes with enough shifts along a decoded axis: sigma_a, sigma_s_prime, translucency "
        "and "
        "indirect were not computed");
    if (white == nullptr) {
      notes_.push_back("no white pattern either: diffuse_reflectance was not computed");
      return;
    }
    notes_.push_back("diffuse_reflectance is from the white pattern and contains indirect light");
  }
  SceneImages images;
  const bool is_column = !correspondence_.column_px.empty();
  const Axis axis = stripes ? stripes->axis : (is_column ? Axis::kColumn : Axis::kRow);
  const SceneGeometry geometry = scene_geometry(surface, axis, images);
  if (!stripes) {
    for (int band = 0; band < bands(); ++band)
      store_band(
          band, {},
          reflectance_of_band(camera(), radiometry_of(band, noise), white->rate.view(), geometry),
          maps);
    return;
  }
  const StripeSignals signals = signals_of(*stripes, signals_.patterns);
  const ProfileTable wide(*model_, stripes->shape, TableRange{});
  const Image<float>& pitch_mm =
      stripes->axis == Axis::kColumn ? surface.column_pitch_mm : surface.row_pitch_mm;
  for (int band = 0; band < bands(); ++band)
    store_band(band, pitch_mm,
               fit_band(camera(), radiometry_of(band, noise), *stripes, signals.views, geometry,
                        transfer_, *model_, wide),
               maps);
  profiles_ = profiles_of({*stripes, signals.views, geometry, pitch_mm, noise}, maps);
}

std::vector<ProfilePoint> Estimator::Implementation::profiles_of(const StripeScene& scene,
                                                                 const Maps& maps) const {
  std::vector<ProfilePoint> points = choose_profile_points(camera(), maps.validity);
  for (ProfilePoint& point : points) {
    point.period_px = scene.stripes.shape.period_px;
    for (int band = 0; band < bands(); ++band) {
      const auto b = static_cast<std::size_t>(band);
      ProfileBand& profile = point.bands[b];
      const auto at_site = [&profile](const Image<float>& map) {
        return static_cast<double>(map.at(profile.row, profile.col));
      };
      const double translucency_mm = at_site(maps.translucency_mm[b]);
      const SiteMaterial found{.row = profile.row,
                               .col = profile.col,
                               .diffuse_reflectance = at_site(maps.diffuse_reflectance[b]),
                               .translucency_px = translucency_mm / at_site(scene.pitch_mm),
                               .indirect = at_site(maps.indirect[b])};
      profile = profile_of_site(camera(), radiometry_of(band, scene.noise), scene.stripes,
                                scene.signals, scene.geometry, transfer_, *model_, found);
      profile.translucency_mm = translucency_mm;
    }
  }
  return points;
}

void Estimator::Implementation::store_band(int band, const Image<float>& pitch_mm, BandFit fit,
                                           Maps& maps) const {
  const auto b = static_cast<std::size_t>(band);
  maps.validity[b] = std::move(fit.validity);
  maps.diffuse_reflectance[b] = std::move(fit.diffuse_reflectance);
  if (fit.translucency_px.empty()) return;
  maps.indirect[b] = std::move(fit.indirect);
  maps.translucency_mm[b] = std::move(fit.translucency_px);
  const Image<float> blank(camera().height_px, camera().width_px, 1, kNan);
  maps.sigma_a_per_mm[b] = blank;
  maps.sigma_s_prime_per_mm[b] = blank;
  tbb::parallel_for(0, camera().height_px, [&](int row) {
    for (int col = 0; col < camera().width_px; ++col) {
      float& translucency = maps.translucency_mm[b].at(row, col);
      translucency *= pitch_mm.at(row, col);
      if (!std::isfinite(translucency)) continue;
      const Coefficients medium =
          model_->coefficients(static_cast<double>(maps.diffuse_reflectance[b].at(row, col)),
                               static_cast<double>(translucency));
      maps.sigma_a_per_mm[b].at(row, col) = static_cast<float>(medium.sigma_a_per_mm);
      maps.sigma_s_prime_per_mm[b].at(row, col) = static_cast<float>(medium.sigma_s_prime_per_mm);
    }
  });
}

Estimator::Estimator(std::unique_ptr<Implementation> implementation)
    : implementation_(std::move(implementation)) {}
Estimator::~Estimator() = default;

Result<std::unique_ptr<Estimator>> Estimator::create(const Manifest& manifest,
                                                     const std::filesystem::path& session,
                                                     const EstimatorOptions& options) {
  if (const auto valid = options.validate(); !valid) return tl::unexpected(valid.error());
  auto auxiliary = read_auxiliary(manifest, session);
  if (!auxiliary) return tl::unexpected(auxiliary.error());
  auto model = make_scattering_model(options.model, {.eta = options.eta});
  if (!model) return tl::unexpected(model.error());
  auto implementation =
      std::make_unique<Implementation>(manifest, options, std::move(*auxiliary), std::move(*model));
  return std::unique_ptr<Estimator>(new Estimator(std::move(implementation)));
}

Result<void> Estimator::add_frame(std::size_t frame_index, ImageView<const std::uint16_t> frame) {
  return implementation_->add_frame(frame_index, frame);
}

Result<Maps> Estimator::finish() { return implementation_->finish(); }

const std::vector<std::string>& Estimator::notes() const { return implementation_->notes(); }

const std::vector<ProfilePoint>& Estimator::profiles() const { return implementation_->profiles(); }

namespace {

// Frames `first` to `last` of the manifest, read in parallel; the first failure in their order.
Result<std::vector<Image<std::uint16_t>>> read_batch(const std::filesystem::path& session,
                                                     const Manifest& manifest, std::size_t first,
                                                     std::size_t last) {
  std::vector<Result<Image<std::uint16_t>>> read(last - first);
  tbb::parallel_for(first, last, [&](std::size_t i) {
    read[i - first] = read_frame(session, manifest, manifest.frames[i].file);
  });
  std::vector<Image<std::uint16_t>> frames;
  for (auto& frame : read) {
    if (!frame)
      return tl::unexpected(
          named_by("/frames/" + std::to_string(first + frames.size()) + "/file", frame.error()));
    frames.push_back(std::move(*frame));
  }
  return frames;
}

}  // namespace

Result<SessionEstimate> estimate_session(
    const std::filesystem::path& session, const EstimatorOptions& options,
    const std::function<void(const EstimateProgress&)>& on_progress) {
  const auto manifest = read_manifest(session);
  if (!manifest) return tl::unexpected(manifest.error());
  // What the Estimator finds wrong with the manifest, it does not know the file of.
  const auto failed = [&](InputError error) {
    if (error.file.empty() && error.place.starts_with('/'))
      error.file = (session / "session.json").string();
    return tl::unexpected(std::move(error));
  };
  auto estimator = Estimator::create(*manifest, session, options);
  if (!estimator) return failed(estimator.error());
  tbb::task_arena readers(options.thread_count > 0 ? options.thread_count
                                                   : tbb::task_arena::automatic);
  const std::size_t frame_count = manifest->frames.size();
  for (std::size_t first = 0; first < frame_count; first += kReadAhead) {
    const std::size_t last = std::min(first + kReadAhead, frame_count);
    const auto frames =
        readers.execute([&] { return read_batch(session, *manifest, first, last); });
    if (!frames) return tl::unexpected(frames.error());
    for (std::size_t i = first; i < last; ++i)
      if (const auto added = (*estimator)->add_frame(i, (*frames)[i - first].view()); !added)
        return tl::unexpected(added.error());
    if (on_progress) on_progress({.stage = "frames", .done = last, .total = frame_count});
  }
  if (on_progress) on_progress({.stage = "maps", .done = 0, .total = 1});
  auto maps = (*estimator)->finish();
  if (!maps) return failed(maps.error());
  if (on_progress) on_progress({.stage = "maps", .done = 1, .total = 1});
  return SessionEstimate{.maps = std::move(*maps),
                         .notes = (*estimator)->notes(),
                         .profiles = (*estimator)->profiles()};
}

}  // namespace estimation
