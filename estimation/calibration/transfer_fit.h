// The optics' contrast for each harmonic of the stripes, from a flat target under the sweep, and
// whether that target is fit for it: one that scatters blurs as skin does.
#pragma once

#include <array>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/calibration/measured.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace estimation {

// Harmonics n = 1 ... kTransferHarmonics of cycles per 40 projector px. Stripes of width 8 do not
// contain the 5th, which is interpolated.
inline constexpr int kTransferHarmonics = 9;

// A complete sweep of stripes of period 40 over a flat target that fills (part of) the picture.
struct TransferSweep {
  int width_px = 8;           // lit columns
  std::vector<int> shift_px;  // evenly spaced over the period, 20 at least
  // [shift][height][width][channel] DN/us, black subtracted; NaN where saturated.
  std::vector<ImageView<const float>> signals;
  // Along the stripes' axis; as decoded and reconstructed. NaN: not on the target.
  ImageView<const float> position_px;
  ImageView<const float> pitch_mm;  // on the surface
  ImageView<const float> projector_distance_mm;
};

struct TransferCurve {
  std::array<Measured, kTransferHarmonics> contrast;  // [n - 1]
  Measured blur_px;  // standard deviation of the Gaussian that fits best, projector px
  double chi2 = 0;   // of that Gaussian
  int freedom = 0;   // its degrees
};

struct TransferBlock {
  double col_px = 0, row_px = 0;  // its middle in the frame
  double distance_mm = 0;         // from the projector
  double pitch_mm = 0;
  std::array<TransferCurve, 3> bands;
};

// Blur alone against blur of light that has scattered in the target.
struct ScatteringTest {
  double chi2_blur = 0, chi2_scattering = 0;
  double translucency_mm = 0;  // l_d of the scattering that fits best
  bool is_scattering = false;
};

struct TransferFit {
  int band_count = 1;
  std::array<TransferCurve, 3> bands;  // over the whole target
  std::vector<TransferBlock> blocks;   // those with enough pixels
  double distance_mm = 0;              // median from the projector
  ScatteringTest scattering;           // by the band that tells it most
  std::vector<std::string> warnings;
};

// Errors: kInvalid for another sweep, kInsufficient for too few pixels.
Result<TransferFit> fit_transfer(const TransferSweep& sweep, const CameraInfo& camera);

// The field average as a session holds it.
TransferByBand transfer_by_band(const TransferFit& fit);
// Sorted. Of three targets or more: at nine distances over those of all blocks, each block counted
// at its own (a target across the picture is out of focus by more at one side than at the other).
// Of fewer: the field averages at the targets' distances, which differ.
TransferByDepth transfer_by_depth(std::span<const TransferFit> fits);

// On the camera's grid, by name ("R.1", "R.2", ...): quadrics through the blocks' contrasts, held
// beyond the outermost blocks. An R.n alone for mono cameras.
std::map<std::string, Image<float>> transfer_maps(const TransferFit& fit, const CameraInfo& camera);

}  // namespace estimation
