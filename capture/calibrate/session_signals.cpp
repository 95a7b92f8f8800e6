#include "capture/calibrate/session_signals.h"

#include <utility>

#include "estimation/session/frame_io.h"
#include "estimation/session/maps.h"

namespace capture {

using estimation::CameraBlack;
using estimation::Image;
using estimation::InputError;
using estimation::InputFault;
using estimation::Manifest;
using estimation::Result;

namespace {

Result<Image<float>> read_flat_field(const std::filesystem::path& session,
                                     const Manifest& manifest) {
  if (!manifest.camera.flat_field_file) return Image<float>();
  const auto path = estimation::resolve_in_session(session, *manifest.camera.flat_field_file,
                                                   "/camera/flat_field");
  if (!path) return tl::unexpected(path.error());
  auto channels = estimation::read_exr(*path);
  if (!channels) return tl::unexpected(channels.error());
  const bool fits = channels->size() == 1 &&
                    channels->begin()->second.width_px() == manifest.camera.width_px &&
                    channels->begin()->second.height_px() == manifest.camera.height_px;
  if (!fits)
    return tl::unexpected(InputError{InputFault::kInvalid, path->string(), "",
                                     "a flat field has one channel of the camera's size"});
  return std::move(channels->begin()->second);
}

Image<float> sum_of_channels(const Image<float>& rate) {
  Image<float> sum(rate.height_px(), rate.width_px());
  for (int row = 0; row < rate.height_px(); ++row)
    for (int col = 0; col < rate.width_px(); ++col)
      for (int channel = 0; channel < rate.channel_count(); ++channel)
        sum.at(row, col) += rate.at(row, col, channel);
  return sum;
}

std::vector<estimation::MergedNoise> noise_of(const Manifest& manifest,
                                              const estimation::SignalStore::Signals& signals) {
  const auto& camera = manifest.camera;
  if (signals.patterns.empty() || !camera.gain_e_per_dn || !camera.read_noise_e)
    return {estimation::MergedNoise{}};
  return estimation::merged_noise(signals.patterns.back().exposures_us,
                                  {*camera.gain_e_per_dn, *camera.read_noise_e},
                                  saturation_of(manifest) - camera.black_level_dn.value_or(0));
}

}  // namespace

double saturation_of(const Manifest& manifest) {
  return manifest.camera.saturation_level_dn.value_or(
      (1 << manifest.camera.pixel_format.bit_depth) - 1);
}

Result<CameraBlack> read_camera_black(const std::filesystem::path& session,
                                      const Manifest& manifest) {
  if (manifest.camera.black_level_dn) return CameraBlack(*manifest.camera.black_level_dn);
  if (manifest.camera.dark_frames.empty()) return CameraBlack(0.0);
  std::vector<CameraBlack::Dark> darks;
  for (const estimation::DarkFrame& dark : manifest.camera.dark_frames) {
    auto frame = estimation::read_frame(session, manifest, dark.file);
    if (!frame) return tl::unexpected(frame.error());
    darks.push_back({dark.exposure_us, std::move(*frame)});
  }
  return CameraBlack(std::move(darks));
}

std::vector<estimation::PatternSignal> SessionSignals::single_channel() const {
  std::vector<estimation::PatternSignal> single;
  for (std::size_t i = 0; i < signals.patterns.size(); ++i) {
    const estimation::PatternRate& pattern = signals.patterns[i];
    single.push_back(
        {&pattern.pattern->kind, sums_.empty() ? pattern.rate.view() : sums_[i].view()});
  }
  return single;
}

Result<SessionSignals> read_signals(const std::filesystem::path& session) {
  auto manifest = estimation::read_manifest(session);
  if (!manifest) return tl::unexpected(manifest.error());
  SessionSignals read;
  read.manifest = std::make_unique<Manifest>(std::move(*manifest));
  auto black = read_camera_black(session, *read.manifest);
  if (!black) return tl::unexpected(black.error());
  auto flat_field = read_flat_field(session, *read.manifest);
  if (!flat_field) return tl::unexpected(flat_field.error());
  estimation::SignalStore store(*read.manifest, std::move(*black), saturation_of(*read.manifest),
                                std::move(*flat_field));
  for (std::size_t i = 0; i < read.manifest->frames.size(); ++i) {
    const auto frame =
        estimation::read_frame(session, *read.manifest, read.manifest->frames[i].file);
    if (!frame) return tl::unexpected(frame.error());
    if (const auto added = store.add(i, frame->view()); !added)
      return tl::unexpected(added.error());
  }
  read.signals = store.take();
  read.noise = noise_of(*read.manifest, read.signals);
  if (estimation::sample_channel_count(read.manifest->camera.pixel_format.filter) > 1) {
    for (const estimation::PatternRate& pattern : read.signals.patterns)
      read.sums_.push_back(sum_of_channels(pattern.rate));
    // The noise of three bands together.
    for (estimation::MergedNoise& noise : read.noise) {
      noise.up_to_dn_per_us *= 3;
      noise.read_variance *= 3;
    }
  }
  return read;
}

}  // namespace capture
