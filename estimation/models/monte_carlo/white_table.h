// From the scores of a white run to the table of one medium.
//
// Where the noise of a node exceeds what neighbouring frequencies allow, RowSmoothing takes it out.
// Light that scattered more than once, at absorptions or frequencies beyond the scores', is scaled
// from the last of them as twofold scattering does: it is a small part of R~ there.
#pragma once

#include <span>

#include "estimation/models/monte_carlo/scattering_table.h"
#include "estimation/models/monte_carlo/white_score.h"

namespace estimation {

// `batches` hold equally many photons each, at least two; their scatter gives the standard errors.
// The caller fills program and seed.
ScatteringTable make_scattering_table(const WalkMedium& medium,
                                      std::span<const WhiteScore> batches);

}  // namespace estimation
