// --refine: least squares with geometry (the paper's section 8), for the pixels near which the
// surface, its light or its material breaks off or bends.
#pragma once

#include <optional>

#include "estimation/geometry/correspondence.h"
#include "estimation/geometry/surface.h"
#include "estimation/material_maps.h"
#include "estimation/radiometry/signal_store.h"
#include "estimation/session/maps.h"

namespace estimation {

// The objects that `material` refers to, to be changed, and how the surface was reconstructed.
struct RefinementInput {
  const MaterialInput& material;
  SignalStore::Signals& signals;
  Correspondence& correspondence;
  Surface& surface;
  const SurfaceOptions& surface_options;
};

// Adds the warning kNearDiscontinuity within three l_d of a border of the surface, its light or
// its material, from the maps of the ordinary fit. Does nothing without them.
void mark_near_discontinuity(const MaterialInput& input, Maps& maps);

// From the maps of the ordinary fit: takes out of the correspondence what scattering moved it by,
// reconstructs the surface anew, fits, then takes what the surroundings of the pixels near
// discontinuities add from their samples and fits again, a few times. The stripes' signals are left
// as the last fit saw them. Runs in the caller's oneTBB arena; the same bits for any number of
// threads. Nullopt, and nothing changed, without stripes.
std::optional<MaterialResult> refine_material(const RefinementInput& input, Maps& maps);

}  // namespace estimation
