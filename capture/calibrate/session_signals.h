// A session's frames as one linear signal a pattern, for calibration.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/geometry/correspondence.h"
#include "estimation/radiometry/merge.h"
#include "estimation/radiometry/noise.h"
#include "estimation/radiometry/signal_store.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace capture {

// What the patterns refer to stays where it is when this is moved.
struct SessionSignals {
  std::unique_ptr<estimation::Manifest> manifest;
  estimation::SignalStore::Signals signals;    // black subtracted where it was seen
  std::vector<estimation::MergedNoise> noise;  // of the patterns' usual exposures; never empty

  // One sample a pixel: an RGB frame's bands are summed. Borrows from this.
  std::vector<estimation::PatternSignal> single_channel() const;

 private:
  friend estimation::Result<SessionSignals> read_signals(const std::filesystem::path&);
  std::vector<estimation::Image<float>> sums_;  // of an RGB session's patterns
};

// Every frame that the manifest names is read. Errors: the session's or a file's.
estimation::Result<SessionSignals> read_signals(const std::filesystem::path& session);

// The black of a session's camera: its level or its dark frames, 0 if it names neither.
estimation::Result<estimation::CameraBlack> read_camera_black(const std::filesystem::path& session,
                                                              const estimation::Manifest& manifest);

double saturation_of(const estimation::Manifest& manifest);

}  // namespace capture
