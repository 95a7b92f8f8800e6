// Frames in, one linear signal per pattern out: keeps raw frames only until their pattern is
// complete.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/radiometry/merge.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace estimation {

struct PatternRate {
  const Pattern* pattern = nullptr;  // of the store's manifest
  Image<float> rate;                 // [height][width][channel] DN/us, see merge_brackets
  std::vector<double> exposures_us;  // merged into it, rising
  // [exposure] instead of `rate`: as they came, black patterns not subtracted.
  std::vector<Image<std::uint16_t>> frames = {};
};

// Whether Gray code and its inverse, in which black and flat field cancel and which the geometry
// alone reads, are merged, or left as frames: it decodes them as they are. Frames of several
// channels, or with a flat field, are merged in either case.
enum class CodeFrames { kMerged, kLeft };

// Feed from one thread. The manifest must outlive the store and what it returns.
class SignalStore {
 public:
  SignalStore(const Manifest& manifest, CameraBlack black, double saturation_dn,
              Image<float> flat_field, CodeFrames code_frames = CodeFrames::kMerged);

  // Copies the frame; merges its pattern (in the caller's oneTBB arena) if it was the last one.
  // Errors: kInvalid for an index out of range or given twice, or a wrong size.
  Result<void> add(std::size_t frame_index, ImageView<const std::uint16_t> frame);

  // The merged patterns in the manifest's order, patterns without frames left out. Where a black
  // pattern was seen its signal (the mean of several), which is ambient light plus projector black,
  // is subtracted from all others, and the black patterns are not returned. Patterns with some
  // frames missing are merged from the others, and named in `notes`. Call once.
  struct Signals {
    std::vector<PatternRate> patterns;
    bool is_black_subtracted = false;
    // What was subtracted, DN/us on average where it and the other patterns' light are, each sample
    // as much as it has of that; 0 without a black pattern.
    double background_dn_per_us = 0;
    std::vector<std::vector<double>> background_exposures_us;  // of each black pattern
    std::vector<std::string> notes;
  };
  Signals take();

 private:
  struct Slot {                         // of one pattern
    std::vector<std::size_t> expected;  // frame indices by exposure, then file name
    std::vector<std::size_t> arrived;
    PatternRate merged;
    std::optional<std::size_t> inverse;  // the slot of it, where both are left as frames
  };
  void leave_code_frames();
  void merge(Slot& slot);
  void leave(Slot& slot);

  const Manifest& manifest_;
  CameraBlack black_;
  double saturation_dn_;
  Image<float> flat_field_;
  std::vector<Slot> slots_;                    // [pattern's place in the manifest]
  std::vector<std::size_t> slot_of_frame_;     // [frame index]
  std::vector<Image<std::uint16_t>> waiting_;  // [frame index], empty before and after
  std::vector<bool> has_come_;                 // [frame index]
};

}  // namespace estimation
