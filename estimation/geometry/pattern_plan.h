// The signals sorted by what they tell: Gray-code bits and phase families of each axis.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "estimation/geometry/correspondence.h"
#include "estimation/geometry/period.h"
#include "estimation/geometry/phase.h"
#include "estimation/geometry/signal_rows.h"

namespace estimation {

struct BitSource {
  int bit = 0;
  std::optional<std::size_t> plain, inverse;  // signals; at least one
};

struct FamilySource {
  PhaseFamily family;
  std::vector<std::size_t> signals;  // [shift]
  Demodulation weights;              // for all shifts
  PeriodChooser chooser;
  // The first harmonic's amplitude of an unblurred pattern that goes from 0 to 1.
  double amplitude_frac = 0;
};

struct AxisPlan {
  int size_px = 0;                     // of the projector along the axis
  std::vector<BitSource> bits;         // by falling bit
  std::vector<FamilySource> families;  // by falling period
  bool is_decodable = false;
  bool is_whole = false;  // no place of the projector is like another to it
};

struct PatternPlan {
  AxisPlan column, row;
  std::optional<std::size_t> white, black;  // signals
  std::vector<std::string> notes;
};

// Patterns that say nothing about the correspondence (images) are left out. Signals by their place
// in `signals`.
PatternPlan plan_patterns(const SignalSet& signals, const ProjectorInfo& projector,
                          const CorrespondenceOptions& options);

}  // namespace estimation
