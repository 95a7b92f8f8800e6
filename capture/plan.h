// What a capture is to collect: patterns, their order of projection, the exposures of each.
#pragma once

#include <chrono>
#include <string>
#include <string_view>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/pattern.h"
#include "rig/fault.h"
#include "rig/projector.h"
#include "rig/rig_file.h"

namespace capture {

// One frame that the plan asks for. `pattern` is both the position in Plan::patterns and the
// pattern's index in the session.
struct SlotId {
  int pattern = 0;
  int bracket = 0;
  bool operator==(const SlotId&) const = default;
};
std::string to_string(SlotId slot);  // "pattern 17 bracket 1"

struct Plan {
  std::string name;
  std::vector<estimation::Pattern> patterns;         // index 0 ... n-1
  std::vector<int> order;                            // of projection: each position once
  std::vector<std::chrono::microseconds> exposures;  // brackets, shortest first

  int slot_count() const {
    return static_cast<int>(patterns.size()) * static_cast<int>(exposures.size());
  }
};

// The plan of that name for a projector: "paper". Its Gray code has the bits that the projector's
// width and height need, so a 1024 x 768 projector gets the paper's 88 patterns. With
// `sequence.is_shuffled` the stripe shifts are projected in a fixed shuffled order, so that drift
// becomes scatter (estimation.md section 4). Errors: kConfiguration for an unknown name.
rig::Result<Plan> make_plan(std::string_view name, const rig::ProjectorSettings& projector,
                            const rig::SequenceSettings& sequence);

// The pictures of a plan for Projector::load(), [pattern][height_px][width_px] 0..255.
std::vector<estimation::Image<unsigned char>> render_pictures(
    const Plan& plan, const rig::ProjectorSettings& projector);

}  // namespace capture
