// What photons say of each camera pixel in a window: its response to the projector's columns, with
// standard errors, as Transport states the surface's.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "hw_sim/photons/adjoint_walk.h"
#include "hw_sim/world/optics.h"
#include "hw_sim/world/seen_points.h"
#include "hw_sim/world/surface.h"

namespace hw_sim {

struct Estimate {
  double value = 0;
  double standard_error = 0;
};

// Reflectance factor by lit projector column (irradiance not normalised), in independent batches of
// paths, so that whatever is computed of it has a standard error.
class ColumnResponse {
 public:
  static constexpr std::size_t kBatches = 16;

  ColumnResponse() = default;
  // [batch][column] sums over `paths_per_batch` paths; zeros at both ends are left out.
  ColumnResponse(std::span<const double> sums, double paths_per_batch);

  int begin() const { return begin_; }  // first column
  int end() const { return begin_ + count_; }
  double at(int column) const;  // mean of the batches
  // One batch's answer to columns lit by `brightness`, indexed by column.
  double lit_by(std::span<const double> brightness, std::size_t batch) const;
  Estimate lit_by(std::span<const double> brightness) const;

 private:
  int begin_ = 0, count_ = 0;
  std::vector<float> by_batch_;  // [batch][column]
};

// The mean of equally good batches.
Estimate estimate_of(std::span<const double> batches);

struct Illumination {
  Pinhole projector;
  int height_px = 0, width_px = 0;
  double reference_distance_mm = 0;
};

struct PhotonOptions {
  int paths_per_sample = 4096;  // rounded up to whole batches
  std::uint64_t seed = 1;
  // Light that leaves the skin and meets it again goes on: all bounces. Else it is gone, as for
  // HeadWorld without indirect light.
  bool has_indirect = false;
};

// One response a sample of `seen`. Runs in the caller's TBB arena; the same bytes for any number of
// threads. `progress` is called from one thread at a time.
std::vector<ColumnResponse> trace_window(const SeenPoints& seen, const Surface& surface,
                                         const ShapeGrid& shape,
                                         const std::array<const Matter*, 3>& matter_of_band,
                                         const Illumination& illumination,
                                         const PhotonOptions& options,
                                         const std::function<void(double done_frac)>& progress);

}  // namespace hw_sim
