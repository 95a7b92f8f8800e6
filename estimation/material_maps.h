// The second half of the estimation: from merged signals and the surface to each band's material.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/estimator.h"
#include "estimation/geometry/correspondence.h"
#include "estimation/geometry/surface.h"
#include "estimation/models/scattering_model.h"
#include "estimation/profile/profile_point.h"
#include "estimation/profile/stripe_transfer.h"
#include "estimation/radiometry/noise.h"
#include "estimation/radiometry/signal_store.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"

namespace estimation {

// Everything borrowed. The manifest holds what the contract wants for radiometry.
struct MaterialInput {
  const Manifest& manifest;
  const EstimatorOptions& options;
  const ScatteringModel& model;
  const HarmonicTransfer& transfer;
  const Image<float>& vignetting;
  const SignalStore::Signals& signals;
  const Correspondence& correspondence;
  const Surface& surface;
  std::span<const MergedNoise> noise;
  double common_variance = 0;     // BandRadiometry
  bool is_noise_measured = true;  // else told by the data or assumed
};

struct MaterialResult {
  std::vector<std::string> notes;
  std::vector<ProfilePoint> profiles;
  // [height][width] what is to be added to the projector coordinate along the stripes, which
  // oblique light had moved; empty for models that do not know by how much.
  Image<float> phase_px;
  Axis phase_axis = Axis::kColumn;
};

// Fills the maps of the bands. Runs in the caller's oneTBB arena; same bits for any number of
// threads.
MaterialResult estimate_material(const MaterialInput& input, Maps& maps);

}  // namespace estimation
