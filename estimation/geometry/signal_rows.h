// Samples along one image row of every signal: from merged images, or straight from the frames.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/geometry/correspondence.h"
#include "estimation/radiometry/merge.h"
#include "estimation/radiometry/merge_row.h"

namespace estimation {

// One pattern's signal.
struct SignalSource {
  const PatternKind* kind = nullptr;
  ImageView<const float> merged;     // or, where this is empty,
  std::vector<ExposedFrame> frames;  // by rising exposure
};

// All signals, each pattern once: what a pattern was seen more often than that is averaged, or its
// frames are one bracket.
struct SignalSet {
  int height_px = 0, width_px = 0;
  std::vector<SignalSource> sources;
  std::vector<Image<float>> averages;  // views point in here
  const CameraBlack* black = nullptr;  // of the frames; null: every signal is merged
  float saturation_dn = 0;             // a whole number; samples below it are used
};

SignalSet collect_signals(std::span<const PatternSignal> signals, const FrameLevels& levels);

// One signal along the open row.
struct SampleRow {
  const float* merged = nullptr;          // DN/us; or, if null,
  std::span<const ExposedRow> exposures;  // as recorded
  std::ptrdiff_t to_next_row = 0;         // in the frames' samples
};

// Scratch of one worker. Not thread-safe; borrows its set.
class SignalRows {
 public:
  explicit SignalRows(const SignalSet& set);

  void open(int row);
  SampleRow at(std::size_t signal) const;

  // DN/us as merge_brackets has it, of one sample and of the whole row.
  float sample(std::size_t signal, std::size_t col) const;
  void copy(std::size_t signal, std::span<float> out) const;

 private:
  struct Black {
    double exposure_us = 0;
    std::vector<float> dn;
  };

  const SignalSet& set_;
  int row_ = 0;
  std::vector<Black> blacks_;        // by exposure, each once
  std::vector<ExposedRow> exposed_;  // all signals' frames of the open row
  std::vector<std::size_t> first_;   // [signal] in exposed_, one more at the end
};

}  // namespace estimation
