#include "estimation/radiometry/signal_store.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <tuple>
#include <utility>

namespace estimation {
namespace {

InputError wrong_frame(std::size_t frame_index, const std::string& expectation) {
  return {InputFault::kInvalid, "", "/frames/" + std::to_string(frame_index), expectation};
}

Image<std::uint16_t> copy_of(ImageView<const std::uint16_t> frame) {
  Image<std::uint16_t> copy(frame.height_px, frame.width_px, frame.channel_count);
  for (int row = 0; row < frame.height_px; ++row) {
    const auto from = frame.row(row);
    std::copy(from.begin(), from.end(), copy.view().row(row).begin());
  }
  return copy;
}

// The mean of the black patterns' signals; empty if there are none.
Image<float> mean_black(const std::vector<PatternRate>& patterns) {
  Image<float> mean;
  float count = 0;
  for (const PatternRate& pattern : patterns) {
    if (!std::holds_alternative<Black>(pattern.pattern->kind)) continue;
    if (mean.empty()) {
      mean = pattern.rate;
    } else {
      for (std::size_t i = 0; i < mean.samples().size(); ++i)
        mean.samples()[i] += pattern.rate.samples()[i];
    }
    ++count;
  }
  for (float& sample : mean.samples()) sample /= count;
  return mean;
}

void subtract(const Image<float>& black, Image<float>& rate) {
  tbb::parallel_for(0, rate.height_px(), [&](int row) {
    const std::span<float> out = rate.view().row(row);
    const std::span<const float> dark = black.view().row(row);
    for (std::size_t i = 0; i < out.size(); ++i) out[i] -= dark[i];
  });
}

// The black pattern's signal on average over samples spread over the picture, each weighted by its
// light in `patterns`: what counts is the subject, not what is behind it.
double mean_where_lit(const Image<float>& black, const std::vector<PatternRate>& patterns) {
  constexpr std::size_t kAboutSamples = 10000;
  // Odd, lest it fall on one colour of a Bayer sensor.
  const std::size_t step = black.samples().size() / kAboutSamples | 1U;
  double sum = 0, weights = 0;
  for (std::size_t i = 0; i < black.samples().size(); i += step) {
    const double dark = static_cast<double>(black.samples()[i]);
    if (!(dark > 0)) continue;
    double light = 0;
    for (const PatternRate& pattern : patterns) {
      if (pattern.rate.empty()) continue;
      const double lit = static_cast<double>(pattern.rate.samples()[i]);
      if (lit > 0) light += lit;
    }
    sum += light * dark;
    weights += light;
  }
  return weights > 0 ? sum / weights : 0;
}

}  // namespace

SignalStore::SignalStore(const Manifest& manifest, CameraBlack black, double saturation_dn,
                         Image<float> flat_field, CodeFrames code_frames)
    : manifest_(manifest),
      black_(std::move(black)),
      saturation_dn_(saturation_dn),
      flat_field_(std::move(flat_field)),
      slots_(manifest.patterns.size()),
      slot_of_frame_(manifest.frames.size()),
      waiting_(manifest.frames.size()),
      has_come_(manifest.frames.size(), false) {
  for (std::size_t slot = 0; slot < slots_.size(); ++slot)
    slots_[slot].merged.pattern = &manifest_.patterns[slot];
  for (std::size_t i = 0; i < manifest_.frames.size(); ++i) {
    const Pattern* pattern = manifest_.find_pattern(manifest_.frames[i].pattern);
    check(pattern != nullptr, "a checked manifest's frames name its patterns");
    slot_of_frame_[i] = static_cast<std::size_t>(pattern - manifest_.patterns.data());
    slots_[slot_of_frame_[i]].expected.push_back(i);
  }
  // A manifest may list a pattern's frames in the order they came: sums must not depend on it.
  for (Slot& slot : slots_)
    std::sort(slot.expected.begin(), slot.expected.end(), [&](std::size_t a, std::size_t b) {
      const FrameRecord &left = manifest_.frames[a], &right = manifest_.frames[b];
      return std::tie(left.exposure_us, left.file) < std::tie(right.exposure_us, right.file);
    });
  if (code_frames == CodeFrames::kLeft && flat_field_.empty() &&
      sample_channel_count(manifest.camera.pixel_format.filter) == 1)
    leave_code_frames();
}

void SignalStore::leave_code_frames() {
  for (Slot& slot : slots_) {
    const auto* code = std::get_if<GrayCode>(&slot.merged.pattern->kind);
    if (code == nullptr) continue;
    GrayCode inverse = *code;
    inverse.inverted = !code->inverted;
    for (std::size_t other = 0; other < slots_.size(); ++other)
      if (slots_[other].merged.pattern->kind == PatternKind(inverse)) slot.inverse = other;
  }
}

Result<void> SignalStore::add(std::size_t frame_index, ImageView<const std::uint16_t> frame) {
  if (frame_index >= has_come_.size())
    return tl::unexpected(wrong_frame(frame_index, "is not in the manifest"));
  if (has_come_[frame_index]) return tl::unexpected(wrong_frame(frame_index, "was given twice"));
  const CameraInfo& camera = manifest_.camera;
  if (frame.width_px != camera.width_px || frame.height_px != camera.height_px ||
      frame.channel_count != sample_channel_count(camera.pixel_format.filter))
    return tl::unexpected(wrong_frame(
        frame_index,
        "is " + std::to_string(frame.width_px) + " x " + std::to_string(frame.height_px) +
            " px of " + std::to_string(frame.channel_count) + " channels; expected " +
            std::to_string(camera.width_px) + " x " + std::to_string(camera.height_px) + " of " +
            std::to_string(sample_channel_count(camera.pixel_format.filter))));
  has_come_[frame_index] = true;
  waiting_[frame_index] = copy_of(frame);
  Slot& slot = slots_[slot_of_frame_[frame_index]];
  slot.arrived.push_back(frame_index);
  if (slot.arrived.size() == slot.expected.size() && !slot.inverse) merge(slot);
  return {};
}

void SignalStore::merge(Slot& slot) {
  std::vector<ExposedFrame> frames;
  for (const std::size_t index : slot.expected) {
    if (!has_come_[index]) continue;
    frames.push_back({manifest_.frames[index].exposure_us, waiting_[index].view()});
    slot.merged.exposures_us.push_back(manifest_.frames[index].exposure_us);
  }
  slot.merged.rate = merge_brackets(frames, black_, saturation_dn_, flat_field_.view());
  for (const std::size_t index : slot.expected) waiting_[index] = {};
}

void SignalStore::leave(Slot& slot) {
  for (const std::size_t index : slot.expected) {
    if (!has_come_[index]) continue;
    slot.merged.exposures_us.push_back(manifest_.frames[index].exposure_us);
    slot.merged.frames.push_back(std::move(waiting_[index]));
  }
}

SignalStore::Signals SignalStore::take() {
  Signals signals;
  std::size_t unseen = 0;
  for (Slot& slot : slots_) {
    const bool is_pair = slot.inverse && !slots_[*slot.inverse].arrived.empty();
    if (slot.arrived.empty()) {
      ++unseen;
      continue;
    }
    if (slot.arrived.size() < slot.expected.size()) {
      signals.notes.push_back("pattern " + std::to_string(slot.merged.pattern->index) + " (" +
                              describe(slot.merged.pattern->kind) + ") has " +
                              std::to_string(slot.arrived.size()) + " of " +
                              std::to_string(slot.expected.size()) + " frames");
      if (!slot.inverse) merge(slot);
    }
    if (is_pair)
      leave(slot);
    else if (slot.inverse)
      merge(slot);
    signals.patterns.push_back(std::move(slot.merged));
  }
  if (unseen > 0)
    signals.notes.push_back(std::to_string(unseen) + " of " + std::to_string(slots_.size()) +
                            " patterns have no frame");
  // Pictures may be captured along; nothing is estimated from them.
  std::erase_if(signals.patterns, [](const PatternRate& pattern) {
    return std::holds_alternative<ImageFile>(pattern.pattern->kind);
  });
  const Image<float> black = mean_black(signals.patterns);
  if (black.empty()) return signals;
  signals.is_black_subtracted = true;
  for (const PatternRate& pattern : signals.patterns)
    if (std::holds_alternative<Black>(pattern.pattern->kind))
      signals.background_exposures_us.push_back(pattern.exposures_us);
  std::erase_if(signals.patterns, [](const PatternRate& pattern) {
    return std::holds_alternative<Black>(pattern.pattern->kind);
  });
  for (PatternRate& pattern : signals.patterns)
    if (!pattern.rate.empty()) subtract(black, pattern.rate);
  signals.background_dn_per_us = mean_where_lit(black, signals.patterns);
  return signals;
}

}  // namespace estimation
