#include "capture/calibrate/lit_scene.h"

#include <cmath>
#include <functional>
#include <map>
#include <optional>
#include <utility>

#include "estimation/session/frame_io.h"

namespace capture {

using estimation::Axis;
using estimation::GrayCode;
using estimation::Image;
using estimation::InputError;
using estimation::InputFault;
using estimation::PatternRate;
using estimation::Result;
using estimation::Stripes;

namespace {

constexpr int kTransferPeriodPx = 40;

tl::unexpected<InputError> insufficient(const std::filesystem::path& session,
                                        const std::string& expectation) {
  return tl::unexpected(InputError{InputFault::kInsufficient, session.string(), "", expectation});
}

class Mean {
 public:
  void add(const Image<float>& image) {
    if (sum_.empty())
      sum_ = image;
    else
      for (std::size_t i = 0; i < sum_.samples().size(); ++i)
        sum_.samples()[i] += image.samples()[i];
    ++count_;
  }
  bool empty() const { return count_ == 0; }
  Image<float> times(float factor) const {
    Image<float> mean = sum_;
    for (float& sample : mean.samples()) sample *= factor / static_cast<float>(count_);
    return mean;
  }

 private:
  Image<float> sum_;
  int count_ = 0;
};

bool is_sweep(const Stripes& stripes) { return stripes.period_px == kTransferPeriodPx; }

// Frames of black patterns, camera black removed.
Result<Image<float>> read_black(const std::filesystem::path& session,
                                const estimation::Manifest& manifest) {
  auto camera_black = read_camera_black(session, manifest);
  if (!camera_black) return tl::unexpected(camera_black.error());
  std::vector<Image<std::uint16_t>> images;
  std::vector<double> exposures_us;
  for (const estimation::FrameRecord& record : manifest.frames) {
    const estimation::Pattern* pattern = manifest.find_pattern(record.pattern);
    if (!pattern || !std::holds_alternative<estimation::Black>(pattern->kind)) continue;
    auto frame = estimation::read_frame(session, manifest, record.file);
    if (!frame) return tl::unexpected(frame.error());
    images.push_back(std::move(*frame));
    exposures_us.push_back(record.exposure_us);
  }
  if (images.empty()) return Image<float>();
  std::vector<estimation::ExposedFrame> frames;
  for (std::size_t i = 0; i < images.size(); ++i)
    frames.push_back({exposures_us[i], images[i].view()});
  return estimation::merge_brackets(frames, *camera_black, saturation_of(manifest), {});
}

// white + black is a Gray code and its inverse; white + (period / width - 1) black is the stripes'
// mean over the period, times period / width: together they tell both.
Result<void> tell_levels(const std::filesystem::path& session, LitScene& scene) {
  Mean white, code, stripes;
  float stripe_ratio = 0;
  for (const PatternRate& pattern : scene.read.signals.patterns) {
    const auto& kind = pattern.pattern->kind;
    if (std::holds_alternative<estimation::White>(kind)) white.add(pattern.rate);
    if (const auto* each = std::get_if<GrayCode>(&kind)) {
      const GrayCode inverse{each->axis, each->bit, !each->inverted};
      for (const PatternRate& other : scene.read.signals.patterns)
        if (other.pattern->kind == estimation::PatternKind(inverse)) code.add(pattern.rate);
    }
    if (const auto* each = std::get_if<Stripes>(&kind); each && is_sweep(*each)) {
      stripes.add(pattern.rate);
      stripe_ratio = static_cast<float>(each->period_px) / static_cast<float>(each->width_px);
    }
  }
  auto black = read_black(session, *scene.read.manifest);
  if (!black) return tl::unexpected(black.error());
  scene.black = std::move(*black);
  if (!white.empty() && !scene.black.empty()) {
    scene.white = white.times(1);
  } else if (!code.empty()) {
    scene.white = code.times(2);
    if (scene.black.empty() && !stripes.empty()) {
      scene.black = stripes.times(stripe_ratio);
      for (std::size_t i = 0; i < scene.white.samples().size(); ++i) {
        float& both = scene.white.samples()[i];
        float& level = scene.black.samples()[i];
        level = (level - both) / (stripe_ratio - 2);
        both -= 2 * level;
      }
    }
  } else if (!white.empty()) {
    scene.white = white.times(1);
  } else {
    return insufficient(session, "has neither white nor Gray code with its inverse");
  }
  return {};
}

}  // namespace

estimation::StandardView LitScene::standard_view() const {
  return {white.view(),
          black.view(),
          correspondence.column_px.view(),
          correspondence.row_px.view(),
          {surface.position_mm[0].view(), surface.position_mm[1].view(),
           surface.position_mm[2].view()}};
}

Result<LitScene> read_lit_scene(const std::filesystem::path& session,
                                const estimation::Calibration& calibration) {
  auto read = read_signals(session);
  if (!read) return tl::unexpected(read.error());
  LitScene scene{std::move(*read), {}, {}, {}, {}};
  const estimation::Manifest& manifest = *scene.read.manifest;
  if (const auto told = tell_levels(session, scene); !told) return tl::unexpected(told.error());
  estimation::CorrespondenceOptions options;
  options.noise = scene.read.noise;
  scene.correspondence =
      estimation::decode_correspondence(scene.read.single_channel(), manifest.projector, options);
  if (scene.correspondence.column_px.empty() || scene.correspondence.row_px.empty())
    return insufficient(session, "the patterns do not tell both projector axes");
  scene.surface = estimation::reconstruct_surface(calibration, manifest.camera, manifest.projector,
                                                  scene.correspondence, {});
  return scene;
}

Result<estimation::TransferSweep> transfer_sweep(LitScene& scene) {
  estimation::TransferSweep sweep;
  std::optional<Axis> axis;
  for (PatternRate& pattern : scene.read.signals.patterns) {
    const auto* stripes = std::get_if<Stripes>(&pattern.pattern->kind);
    if (!stripes || !is_sweep(*stripes) || (axis && stripes->axis != *axis)) continue;
    axis = stripes->axis;
    sweep.width_px = stripes->width_px;
    if (!scene.read.signals.is_black_subtracted && !scene.black.empty())
      for (std::size_t i = 0; i < pattern.rate.samples().size(); ++i)
        pattern.rate.samples()[i] -= scene.black.samples()[i];
    sweep.shift_px.push_back(stripes->shift_px);
    sweep.signals.push_back(pattern.rate.view());
  }
  if (!axis)
    return tl::unexpected(
        InputError{InputFault::kInsufficient, "", "", "has no stripes of period 40"});
  const bool is_column = *axis == Axis::kColumn;
  sweep.position_px =
      (is_column ? scene.correspondence.column_px : scene.correspondence.row_px).view();
  sweep.pitch_mm = (is_column ? scene.surface.column_pitch_mm : scene.surface.row_pitch_mm).view();
  sweep.projector_distance_mm = scene.surface.projector_distance_mm.view();
  return sweep;
}

}  // namespace capture
