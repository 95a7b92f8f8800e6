#include "estimation/estimator.h"

#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include "estimation/auxiliary.h"
#include "estimation/geometry/bend_shift.h"
#include "estimation/geometry/correspondence.h"
#include "estimation/geometry/surface.h"
#include "estimation/material_maps.h"
#include "estimation/models/scattering_model.h"
#include "estimation/profile/profile_point.h"
#include "estimation/profile/stripe_set.h"
#include "estimation/profile/stripe_transfer.h"
#include "estimation/radiometry/merge.h"
#include "estimation/radiometry/noise.h"
#include "estimation/radiometry/signal_store.h"
#include "estimation/refinement.h"
#include "estimation/sample_noise.h"

namespace estimation {
namespace {

// Beyond this angle "our data is unreliable" (the paper, section 5): one degree of normal is then
// 6.5% of irradiance.
constexpr double kGrazingDegrees = 75;

// More than any pattern of ours shows.
constexpr int kMostHarmonics = 64;

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

}  // namespace

Result<void> EstimatorOptions::validate() const {
  std::vector<std::string> problems;
  const auto expect_one_of = [&](const std::string& name, const std::string& value,
                                 const std::vector<std::string>& known) {
    if (std::find(known.begin(), known.end(), value) == known.end())
      problems.push_back(name + " is '" + value + "'; known are: " + joined(known));
  };
  expect_one_of("method", method, {"likelihood", "lut"});
  expect_one_of("indirect", indirect, {"auto", "free", "zero"});
  expect_one_of("sweep_errors", sweep_errors, {"auto", "correct", "report", "off"});
  if (const auto made = make_scattering_model(model, {.eta = eta, .anisotropy = anisotropy}); !made)
    problems.push_back(made.error().text());
  if (harmonic_count < 0 || harmonic_count > kMostHarmonics)
    problems.push_back("harmonic_count is " + std::to_string(harmonic_count) +
                       "; expected 0 (all) to " + std::to_string(kMostHarmonics));
  if (method == "lut") {
    const EstimatorOptions usual;
    const auto refuse = [&](const std::string& name, bool is_given) {
      if (is_given) problems.push_back(name + " is for the method likelihood; lut has none");
    };
    refuse("indirect", indirect != usual.indirect);
    refuse("harmonic_count", harmonic_count != usual.harmonic_count);
    refuse("sweep_errors", sweep_errors != usual.sweep_errors);
  }
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
               std::move(auxiliary.flat_field), CodeFrames::kLeft),
        notes_(std::move(auxiliary.notes)) {}

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
  // What geometry_signals makes for what it returns: sums of an RGB frame's bands, frames by
  // exposure.
  struct GeometryInput {
    std::vector<Image<float>> sums;
    std::vector<std::vector<ExposedFrame>> frames;
  };
  // The patterns as the geometry sees them.
  std::vector<PatternSignal> geometry_signals(GeometryInput& made) const;
  Correspondence correspond(std::span<const MergedNoise> noise);
  // The surface, its bends' shift of the stripes taken off the correspondence.
  Surface reconstruct(const SurfaceOptions& options, PhaseSource source);
  void move_correspondence(const MaterialResult& material);

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
  Image<float> decoded_column_sd_px_, decoded_row_sd_px_;
  std::vector<std::string> notes_;
  std::vector<ProfilePoint> profiles_;
};

Result<Maps> Estimator::Implementation::estimate() {
  signals_ = store_.take();
  notes_.insert(notes_.end(), signals_.notes.begin(), signals_.notes.end());
  if (signals_.patterns.empty())
    return tl::unexpected(
        InputError{InputFault::kInsufficient, "", "/frames",
                   "holds no frame of stripes, Gray code, fringes or white: nothing can be "
                   "estimated; expected the frames of the projected patterns"});
  std::vector<const PatternKind*> kinds;
  for (const PatternRate& pattern : signals_.patterns) kinds.push_back(&pattern.pattern->kind);
  const std::optional<StripeSet> stripes = choose_stripe_set(kinds);
  const SampleNoise noise = sample_noise(camera(), black_, saturation_dn(), signals_, stripes);

  correspondence_ = correspond(noise.merged);
  decoded_column_sd_px_ = correspondence_.column_sd_px;
  decoded_row_sd_px_ = correspondence_.row_sd_px;
  SurfaceOptions surface_options;
  surface_options.min_cos_projector = surface_options.min_cos_camera =
      std::cos(kGrazingDegrees * std::numbers::pi / 180);
  Maps maps;
  maps.height_px = camera().height_px;
  maps.width_px = camera().width_px;
  maps.band_count = bands();
  maps.method = options_.method;
  maps.scattering_model = model_->name();
  maps.is_noise_measured = noise.is_measured;
  if (correspondence_.column_px.empty() && correspondence_.row_px.empty()) {
    notes_.push_back("no correspondence could be decoded: there is no map but validity");
    for (int band = 0; band < bands(); ++band)
      maps.validity[static_cast<std::size_t>(band)] = correspondence_.validity;
    return maps;
  }
  Surface surface = reconstruct(surface_options, PhaseSource::kFirstHarmonic);
  for (int band = 0; band < bands(); ++band)
    maps.validity[static_cast<std::size_t>(band)] = surface.validity;

  const std::vector<std::string> missing = missing_for_radiometry(manifest_);
  if (!options_.is_geometry_only && !missing.empty())
    notes_.push_back("geometry only: the session has no " + joined(missing));
  if (!options_.is_geometry_only && missing.empty()) {
    const MaterialInput input{
        .manifest = manifest_,
        .options = options_,
        .model = *model_,
        .transfer = transfer_,
        .vignetting = vignetting_,
        .signals = signals_,
        .correspondence = correspondence_,
        .surface = surface,
        .noise = noise.merged,
        .common_variance = background_variance(camera(), black_, saturation_dn(), signals_, noise),
        .is_noise_measured = noise.is_measured};
    MaterialResult material = estimate_material(input, maps);
    if (!material.phase_px.empty()) {
      // Oblique light comes out shifted: the fit knows by how much, and the surface moves with it.
      move_correspondence(material);
      surface = reconstruct(surface_options, PhaseSource::kAllHarmonics);
      material = estimate_material(input, maps);
    }
    if (options_.is_refined)
      if (auto refined =
              refine_material({input, signals_, correspondence_, surface, surface_options}, maps))
        material = std::move(*refined);
    mark_near_discontinuity(input, maps);
    notes_.insert(notes_.end(), material.notes.begin(), material.notes.end());
    profiles_ = std::move(material.profiles);
  }

  maps.position_mm = std::move(surface.position_mm);
  maps.normal = std::move(surface.normal);
  maps.position_sd_mm = std::move(surface.position_sd_mm);
  maps.correspondence_px = {std::move(correspondence_.column_px),
                            std::move(correspondence_.row_px)};
  maps.correspondence_sd_px = {std::move(correspondence_.column_sd_px),
                               std::move(correspondence_.row_sd_px)};
  return maps;
}

// The fit's own phases hold what the surface's bends do to them, whatever it was given.
void Estimator::Implementation::move_correspondence(const MaterialResult& material) {
  Image<float>& position_px =
      material.phase_axis == Axis::kColumn ? correspondence_.column_px : correspondence_.row_px;
  for (std::size_t i = 0; i < position_px.samples().size(); ++i)
    position_px.samples()[i] += material.phase_px.samples()[i];
  correspondence_.column_sd_px = decoded_column_sd_px_;
  correspondence_.row_sd_px = decoded_row_sd_px_;
}

Surface Estimator::Implementation::reconstruct(const SurfaceOptions& options, PhaseSource source) {
  GeometryInput made;
  return reconstruct_bent_surface(geometry_signals(made), manifest_.calibration, camera(),
                                  manifest_.projector, options, {.source = source},
                                  correspondence_);
}

std::vector<PatternSignal> Estimator::Implementation::geometry_signals(GeometryInput& made) const {
  made.sums.reserve(signals_.patterns.size());
  made.frames.reserve(signals_.patterns.size());
  std::vector<PatternSignal> signals;
  for (const PatternRate& pattern : signals_.patterns) {
    if (std::holds_alternative<ImageFile>(pattern.pattern->kind)) continue;
    if (!pattern.frames.empty()) {
      std::vector<ExposedFrame>& frames = made.frames.emplace_back();
      for (std::size_t i = 0; i < pattern.frames.size(); ++i)
        frames.push_back({pattern.exposures_us[i], pattern.frames[i].view()});
      signals.push_back({.kind = &pattern.pattern->kind, .signal = {}, .frames = frames});
    }
    if (pattern.rate.empty()) continue;
    if (pattern.rate.channel_count() > 1) made.sums.push_back(sum_of_channels(pattern.rate));
    signals.push_back({&pattern.pattern->kind, pattern.rate.channel_count() > 1
                                                   ? std::as_const(made.sums.back()).view()
                                                   : pattern.rate.view()});
  }
  return signals;
}

Correspondence Estimator::Implementation::correspond(std::span<const MergedNoise> noise) {
  GeometryInput made;
  const std::vector<PatternSignal> signals = geometry_signals(made);
  CorrespondenceOptions options;
  options.levels = {.black = &black_, .saturation_dn = saturation_dn()};
  options.noise.assign(noise.begin(), noise.end());
  Correspondence found = decode_correspondence(signals, manifest_.projector, options);
  notes_.insert(notes_.end(), found.notes.begin(), found.notes.end());
  // Their work is done; at full size they are half of all signals.
  for (PatternRate& pattern : signals_.patterns)
    if (std::holds_alternative<GrayCode>(pattern.pattern->kind)) {
      pattern.rate = {};
      pattern.frames.clear();
    }
  return found;
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
  auto model =
      make_scattering_model(options.model, {.eta = options.eta, .anisotropy = options.anisotropy});
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

}  // namespace estimation
