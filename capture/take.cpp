#include "capture/take.h"

#include <algorithm>
#include <utility>

namespace capture {

std::optional<SlotId> Take::session_slot(SlotId slot) const {
  const TakeEntry& own = entry(slot);
  if (own.is_repeat || !own.is_open[static_cast<std::size_t>(slot.bracket)]) return std::nullopt;
  return SlotId{own.pattern, slot.bracket};
}

int Take::repeat_number(int position) const {
  return static_cast<int>(std::count_if(entries.begin(), entries.begin() + position + 1,
                                        [](const TakeEntry& each) { return each.is_repeat; }));
}

int Take::open_slot_count() const {
  int count = 0;
  for (const TakeEntry& each : entries)
    count += static_cast<int>(std::count(each.is_open.begin(), each.is_open.end(), true));
  return count;
}

std::string Take::name_of(SlotId slot) const {
  const TakeEntry& own = entry(slot);
  const std::string name = to_string(SlotId{own.pattern, slot.bracket});
  if (!own.is_repeat) return name;
  return "repeat " + std::to_string(repeat_number(slot.pattern)) + " of " + name;
}

Take make_take(const Plan& session_plan, const std::vector<bool>& is_open, int repeated,
               int repeat_every) {
  Take take;
  take.plan.name = session_plan.name;
  take.plan.exposures = session_plan.exposures;
  if (repeat_every > 0) take.repeated = repeated;
  const std::size_t bracket_count = session_plan.exposures.size();
  const auto add = [&](int pattern, bool is_repeat, std::vector<bool> open_brackets) {
    const int position = static_cast<int>(take.entries.size());
    const auto& kind = session_plan.patterns[static_cast<std::size_t>(pattern)].kind;
    take.plan.patterns.push_back({position, kind});
    take.entries.push_back({pattern, is_repeat, std::move(open_brackets)});
    return position;
  };
  // The session's own first, so that a whole plan keeps its numbers.
  std::vector<int> position(session_plan.patterns.size(), -1);
  for (std::size_t i = 0; i < position.size(); ++i) {
    const auto first = is_open.begin() + static_cast<std::ptrdiff_t>(i * bracket_count);
    std::vector<bool> open(first, first + static_cast<std::ptrdiff_t>(bracket_count));
    const bool is_wanted = std::find(open.begin(), open.end(), true) != open.end();
    if (is_wanted) position[i] = add(static_cast<int>(i), false, std::move(open));
  }
  int since_repeat = 0;
  const auto repeat = [&] {
    take.plan.order.push_back(add(repeated, true, std::vector<bool>(bracket_count, false)));
  };
  for (const int pattern : session_plan.order) {
    if (position[static_cast<std::size_t>(pattern)] < 0) continue;
    take.plan.order.push_back(position[static_cast<std::size_t>(pattern)]);
    if (repeat_every == 0) continue;
    if (pattern == repeated) repeat();
    if (++since_repeat < repeat_every) continue;
    repeat();
    since_repeat = 0;
  }
  if (since_repeat > 0) repeat();
  return take;
}

Take make_take(const Plan& session_plan, int repeat_every) {
  const std::vector<bool> all(static_cast<std::size_t>(session_plan.slot_count()), true);
  return make_take(session_plan, all, session_plan.order.front(), repeat_every);
}

Take make_repeat(const Plan& session_plan, int pattern) {
  Take take;
  take.plan = {session_plan.name, {}, {}, session_plan.exposures};
  for (const int position : {0, 1}) {
    const auto& kind = session_plan.patterns[static_cast<std::size_t>(pattern)].kind;
    take.plan.patterns.push_back({position, kind});
    take.plan.order.push_back(position);
    take.entries.push_back(
        {pattern, true, std::vector<bool>(session_plan.exposures.size(), false)});
  }
  take.repeated = pattern;
  return take;
}

}  // namespace capture
