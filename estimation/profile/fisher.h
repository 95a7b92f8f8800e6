// How well a pixel's unknowns can be known at all: Fisher information, its inverse, and when that
// is worth a value (design/estimation.md, section 3).
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <span>

#include "estimation/profile/likelihood.h"

namespace estimation {

// Lower triangle by covariance_index.
using SymmetricMatrix = std::array<double, 10>;

// Inverse of an information matrix of (t, ln l, B, phase); with kZero the rows of B are ignored and
// come back as zeros. nullopt if it is singular to rounding.
std::optional<SymmetricMatrix> inverse_information(const SymmetricMatrix& information,
                                                   IndirectLight indirect);

// Whether the data tell the unknowns apart: the standard deviation of ln l at most 0.5, and the
// condition of the information matrix, scaled to a unit diagonal, at most 1e5.
bool is_identifiable(const SymmetricMatrix& information, const SymmetricMatrix& covariance,
                     IndirectLight indirect);

struct PixelTruth {
  ShapePoint shape;
  double indirect = 0;
  double phase_px = 0;
};

// The Cramer-Rao bound of a pixel with these true values: the least covariance that any unbiased
// estimate from these samples can have. The batch's samples only say which are lost (none if it has
// no samples). nullopt: singular, or outside of the model.
std::optional<SymmetricMatrix> cramer_rao_bound(const FitProblem& problem, const PixelBatch& batch,
                                                std::size_t pixel, const PixelTruth& truth);

// The samples' true reflectance factors there, in the order of the shifts that are not lost; empty
// outside of the model.
std::vector<double> expected_reflectance(const FitProblem& problem, const PixelBatch& batch,
                                         std::size_t pixel, const PixelTruth& truth);

}  // namespace estimation
