// What one run of the sequence shows, and what each showing is for: slots of the session, or
// repeats of a pattern that tell whether subject and light have stayed as they were.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "capture/plan.h"

namespace capture {

struct TakeEntry {
  int pattern = 0;  // of the session
  bool is_repeat = false;
  std::vector<bool> is_open;  // [bracket] its frame is for the session, which lacks it
};

struct Take {
  Plan plan;                       // as the sequence runs it: a repeat is a pattern of its own
  std::vector<TakeEntry> entries;  // [position in plan.patterns]
  std::optional<int> repeated;     // the session's pattern that is shown again

  // The slot of the session that a slot of `plan` fills; nullopt: none.
  std::optional<SlotId> session_slot(SlotId slot) const;
  const TakeEntry& entry(SlotId slot) const {
    return entries[static_cast<std::size_t>(slot.pattern)];
  }
  int open_slot_count() const;
  // "pattern 17 bracket 1", "repeat 2 of pattern 0 bracket 1".
  std::string name_of(SlotId slot) const;

 private:
  int repeat_number(int position) const;  // 1, 2, ...
};

// The whole plan, the first pattern repeated at once, after every `repeat_every` showings and at
// the end; 0: never. At once: under the square's other level, so that a camera that sees the square
// has the first showing under both (capture/motion_watch.h), whatever retakes do to the levels
// later.
Take make_take(const Plan& session_plan, int repeat_every);

// The patterns that have an open slot, [pattern * brackets + bracket], in the plan's order;
// `repeated`, which need not be open, is repeated in the same way, at once only if it is shown.
Take make_take(const Plan& session_plan, const std::vector<bool>& is_open, int repeated,
               int repeat_every);

// Two showings of `pattern` as repeats, one under each level of the square, and nothing else.
Take make_repeat(const Plan& session_plan, int pattern);

}  // namespace capture
