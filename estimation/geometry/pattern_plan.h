// The signals sorted by what they tell: Gray-code bits and phase families of each axis.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/geometry/correspondence.h"
#include "estimation/geometry/period.h"
#include "estimation/geometry/phase.h"

namespace estimation {

struct BitSource {
  int bit = 0;
  ImageView<const float> plain, inverse;  // either may be empty
};

struct FamilySource {
  PhaseFamily family;
  std::vector<ImageView<const float>> signals;  // [shift]
  Demodulation weights;                         // for all shifts
  PeriodChooser chooser;
  // The first harmonic's amplitude of an unblurred pattern that goes from 0 to 1.
  double amplitude_frac = 0;
};

struct AxisPlan {
  int size_px = 0;                     // of the projector along the axis
  std::vector<BitSource> bits;         // by falling bit
  std::vector<FamilySource> families;  // by falling period
  bool is_decodable = false;
};

struct PatternPlan {
  AxisPlan column, row;
  ImageView<const float> white, black;  // either may be empty
  std::vector<Image<float>> averages;   // of signals given more than once; views point in here
  std::vector<std::string> notes;
};

// Patterns that say nothing about the correspondence (images) are left out.
PatternPlan plan_patterns(std::span<const PatternSignal> signals, const ProjectorInfo& projector,
                          const CorrespondenceOptions& options);

}  // namespace estimation
