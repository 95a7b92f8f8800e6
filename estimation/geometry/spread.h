// How far light spreads in the subject, as the harmonics of a stripe sweep tell it without a model.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/geometry/correspondence.h"
#include "estimation/session/manifest.h"

namespace estimation {

// R~ of the light's spreading over harmonic numbers t of the sweep: ln R~ = -slope sqrt(tau^2 +
// t^2), an exponential with a rounded start, as diffusion's is. All zero: light that does not
// spread.
struct SpreadShape {
  double slope = 0, tau = 0;

  double log_transfer(double t) const;  // up to a constant
  double first(double t) const;         // R~' / R~, negative
  double second(double t) const;        // R~'' / R~
};

struct CellSpread {
  SpreadShape shape;
  // By how much the coordinate read from the second of the harmonics used differs from that of the
  // first, projector px: light that comes out shifted is shifted differently.
  double second_less_first_px = 0;
};

// Cells of the picture over which light spreads alike; [band][cell].
struct SpreadCells {
  int period_px = 0, width_px = 0;  // of the sweep's stripes
  int side_px = 1;
  int rows = 0, cols = 0;
  int second_harmonic = 2;
  std::array<std::vector<std::optional<CellSpread>>, 3> bands;

  // Of the cell that pixel (row, col) lies in.
  std::size_t index(int row, int col) const {
    return static_cast<std::size_t>(row / side_px) * static_cast<std::size_t>(cols) +
           static_cast<std::size_t>(col / side_px);
  }
};

// |sin x / x| of a stripe pattern's harmonic.
double stripe_harmonic(int period_px, int width_px, int harmonic);

// The band of a geometry signal's sample: a Bayer site's own, else 0 (mono, or an RGB frame's sum).
int spread_band(const CameraInfo& camera, int row, int col);

// From the axis' sweep with the most shifts, where `position_px` is decoded; averaged over a cell
// and its eight neighbours. Nullopt without three harmonics: too few shifts, or a stripe width
// whose harmonics vanish. Runs in the caller's oneTBB arena.
std::optional<SpreadCells> spread_of(std::span<const PatternSignal> signals,
                                     const FrameLevels& levels, Axis axis, const CameraInfo& camera,
                                     ImageView<const float> position_px, int cell_side_px);

}  // namespace estimation
