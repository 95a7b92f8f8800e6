// From raw frames to maps: the outline of the estimation. Frames go in as they come, live or from
// disk; the maps are the same to the bit, for any order of arrival and number of threads.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/profile/profile_point.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"

namespace estimation {

struct EstimatorOptions {
  std::string method = "likelihood";  // or "lut", the paper's table search
  std::string model = "monte_carlo";  // see make_scattering_model
  double anisotropy = 0.8;            // g of the medium
  double eta = 1.4;                   // refractive index of the medium
  // Indirect light of a pixel: "free", "zero", or "auto": free, but zero where its neighbourhood
  // shows that there is none. Likelihood only.
  std::string indirect = "auto";
  int harmonic_count = 0;  // of the data, the first ones; 0: all. Likelihood only.
  // Blur and drift that the data show beyond the calibration: "off", "report", "correct" where they
  // are significant, or "auto": corrected where they explain the misfit, too. Likelihood only.
  std::string sweep_errors = "auto";
  // Least squares with geometry near discontinuities and bends (refinement.h); both methods.
  bool is_refined = false;
  int thread_count = 0;  // 0: as many as the machine has
  bool is_geometry_only = false;

  // Every bad field in one error, not the first alone.
  Result<void> validate() const;
  bool operator==(const EstimatorOptions&) const = default;
};

// Feed it from one thread; it spreads the work over its own oneTBB arena. finish() is called once.
class Estimator {
 public:
  // `manifest` names the patterns, all frames that may come and the calibration; `session` is where
  // its auxiliary files lie (flat field, vignetting, dark frames, transfer maps), which are read
  // now. Errors: options or files that cannot be used.
  static Result<std::unique_ptr<Estimator>> create(const Manifest& manifest,
                                                   const std::filesystem::path& session,
                                                   const EstimatorOptions& options);
  ~Estimator();
  Estimator(const Estimator&) = delete;
  Estimator& operator=(const Estimator&) = delete;

  // The frame of manifest.frames[frame_index]: [height][width][channel] DN, right-aligned, copied.
  // When the last frame of a pattern is there, the pattern is merged and its frames are forgotten.
  // Errors: kInvalid for an index out of range or given twice, or a wrong size.
  Result<void> add_frame(std::size_t frame_index, ImageView<const std::uint16_t> frame);

  // The maps from the frames that came. What cannot be computed from them is left out of the maps
  // and named in notes(). Error: kInsufficient if there is no frame at all.
  Result<Maps> finish();

  // Which outputs could not be computed and why, one sentence each; complete after finish().
  const std::vector<std::string>& notes() const;

  // The scattering profiles of up to four points (choose_profile_points) with the curves fitted to
  // them; complete after finish(), empty without stripes or radiometry.
  const std::vector<ProfilePoint>& profiles() const;

 private:
  class Implementation;
  explicit Estimator(std::unique_ptr<Implementation> implementation);
  std::unique_ptr<Implementation> implementation_;
};

struct EstimateProgress {
  std::string stage;  // "frames", "maps"
  std::size_t done = 0, total = 0;
};

struct SessionEstimate {
  Maps maps;
  std::vector<std::string> notes;
  std::vector<ProfilePoint> profiles;
};

// `ssrig estimate`: reads the manifest and every frame it names (in parallel, ahead of the merge)
// and feeds the Estimator above. `on_progress` is called on this thread; it may be empty. Errors:
// whatever is wrong with the session or the options.
Result<SessionEstimate> estimate_session(
    const std::filesystem::path& session, const EstimatorOptions& options,
    const std::function<void(const EstimateProgress&)>& on_progress = {});

}  // namespace estimation
