// What merging and fitting a full-size sweep costs, in bare reads of its frames.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace bench {

struct SpeedOptions {
  int height_px = 1726, width_px = 2352;  // a Bayer mosaic: one band a pixel
  double valid_frac = 0.45;               // in an ellipse
  int repetitions = 7;
  int harmonic_count = 0;  // at most; 0: all that rise above the noise
  bool is_indirect_free = true;
  bool is_table_wide = false;         // over every material instead of what the scene holds
  bool is_background_fitted = false;  // no pixel passed over
};

// Medians over the repetitions, which interleave the stages.
struct SpeedStage {
  std::string name;
  double milliseconds = 0;
  double bare_reads = 0;  // of the same repetition
};

struct SpeedReport {
  std::vector<SpeedStage> stages;  // the bare read first, the total last
  double prepare_ms = 0;           // tables and fitters, not in the total
  int thread_count = 0;
  std::size_t pixel_count = 0;  // fitted
  std::size_t frame_bytes = 0;
  std::size_t peak_beyond_frames_bytes = 0;  // of memory, from the merge to the maps
  double invalid_frac = 0;                   // of the pixels fitted
  double log_translucency_pull = 0;          // rms of error / sigma
};

// Makes 40 stripes x 2 exposures of a dipole face (three skins, one a colour, varying over the
// face; blur 0.5 projector px), then measures in the caller's oneTBB arena.
SpeedReport speed_report(const SpeedOptions& options);

// As a Markdown table and a line of figures.
std::string to_text(const SpeedReport& report);

}  // namespace bench
