// One pose of the board from its frames under structured light.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "estimation/calibration/board.h"
#include "estimation/calibration/board_view.h"
#include "estimation/geometry/correspondence.h"

namespace estimation {

// What a phase from few shifts errs by: the stripes' harmonics that n shifts cannot tell from the
// first add sin(n a), sin(2 n a) ... at the phase a. Odd about a stripe's middle, as stripes are
// even.
struct PhaseRipple {
  double period_px = 0;  // 0: none
  double zero_px = 0;
  double greatest_px = 0;  // of stripes without any blur
};
struct PhaseRipples {
  PhaseRipple column, row;
};

// Of stripes whose shifts divide their period evenly; none for others.
PhaseRipples phase_ripples(std::span<const PatternSignal> signals);

// Where the projector lights each corner: a quadric through the decoded pixels of the four squares
// around it, fitted robustly, its value at the corner. Pixels beside an edge are left out: their
// light is mostly the white side's, and so is their code.
//   corners         in frame px
//   correspondence  of the same frames; both axes
//   ripples         of the patterns that were decoded: fitted along with the quadric, since rows of
//                   pixels that lie along the stripes err alike
//   grey            the evenly lit board, see grey_picture
//   camera          for the frames' place on the sensor
// A corner with too few decoded pixels around it has no projector coordinate.
std::vector<BoardCorner> light_corners(std::span<const DetectedCorner> corners,
                                       const Correspondence& correspondence,
                                       const PhaseRipples& ripples, ImageView<const float> grey,
                                       const CameraInfo& camera);

// The board as if evenly lit: white frames if there are any, else the sums of Gray code and its
// inverse, else the mean of the stripes' shifts; an empty image without any of them.
Image<float> evenly_lit(std::span<const PatternSignal> signals);

// Corners, decoding and projector coordinates of one pose. Errors: kInsufficient, the reason.
Result<BoardPose> observe_board(const std::string& name, std::span<const PatternSignal> signals,
                                const Board& board, const CameraInfo& camera,
                                const ProjectorInfo& projector,
                                const CorrespondenceOptions& options);

}  // namespace estimation
