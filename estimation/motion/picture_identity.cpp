#include "estimation/motion/picture_identity.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <set>
#include <tuple>
#include <utility>

#include "estimation/motion/picture_series.h"

namespace estimation {
namespace {

constexpr std::size_t kFewestShifts = 16, kFewestPairs = 2;

// By bracket, and in each by the time of showing.
std::vector<BracketPictures> by_bracket(const std::vector<Pattern>& patterns,
                                        const std::vector<SeenPicture>& pictures) {
  std::map<int, const Pattern*> by_index;
  for (const Pattern& pattern : patterns) by_index[pattern.index] = &pattern;
  std::map<int, BracketPictures> brackets;
  for (const SeenPicture& picture : pictures) {
    const auto found = by_index.find(picture.pattern);
    if (found != by_index.end())
      brackets[picture.bracket].shown.push_back({&picture, found->second});
  }
  std::vector<BracketPictures> all;
  for (auto& [bracket, own] : brackets) {
    own.bracket = bracket;
    std::stable_sort(own.shown.begin(), own.shown.end(), [](const auto& a, const auto& b) {
      return a.picture->elapsed_s < b.picture->elapsed_s;
    });
    all.push_back(std::move(own));
  }
  return all;
}

struct Shift {
  std::tuple<bool, Axis, double, int> series;  // is a fringe, axis, period, width
  double shift_px = 0;
};
std::optional<Shift> shift_of(const PatternKind& kind) {
  if (const auto* stripes = std::get_if<Stripes>(&kind))
    return Shift{{false, stripes->axis, stripes->period_px, stripes->width_px},
                 static_cast<double>(stripes->shift_px)};
  if (const auto* fringe = std::get_if<Fringe>(&kind))
    return Shift{{true, fringe->axis, fringe->period_px, 0}, fringe->shift_px};
  return std::nullopt;
}

std::vector<ShiftSeries> shift_series(const BracketPictures& pictures) {
  std::map<std::tuple<bool, Axis, double, int>, ShiftSeries> series;
  std::map<std::tuple<bool, Axis, double, int>, std::set<double>> shifts;
  for (std::size_t i = 0; i < pictures.shown.size(); ++i) {
    if (!pictures.shown[i].picture->is_of_session) continue;
    const auto shift = shift_of(pictures.shown[i].pattern->kind);
    if (!shift) continue;
    ShiftSeries& own = series[shift->series];
    own.period_px = std::get<2>(shift->series);
    own.frames.push_back(i);
    own.phases_rad.push_back(2 * std::numbers::pi * shift->shift_px / own.period_px);
    shifts[shift->series].insert(std::remainder(shift->shift_px, own.period_px));
  }
  std::vector<ShiftSeries> all;
  for (auto& [key, own] : series)
    if (shifts[key].size() >= kFewestShifts) all.push_back(std::move(own));
  return all;
}

// What two complements have in common, the side each is of, and their run.
struct Half {
  std::tuple<int, Axis, int, int> pair;  // kind; axis; bit or period; shift
  bool is_second = false;
  double run_px = 0;
};
std::optional<Half> half_of(const PatternKind& kind) {
  if (const auto* gray = std::get_if<GrayCode>(&kind))
    return Half{{0, gray->axis, gray->bit, 0}, gray->inverted, std::ldexp(2.0, gray->bit)};
  if (std::holds_alternative<White>(kind)) return Half{{1, Axis::kColumn, 0, 0}, false, 0};
  if (std::holds_alternative<Black>(kind)) return Half{{1, Axis::kColumn, 0, 0}, true, 0};
  const auto* stripes = std::get_if<Stripes>(&kind);
  if (stripes == nullptr || 2 * stripes->width_px != stripes->period_px) return std::nullopt;
  const int period_px = stripes->period_px;
  const int shift_px = ((stripes->shift_px % period_px) + period_px) % period_px;
  return Half{{2, stripes->axis, period_px, shift_px % stripes->width_px},
              shift_px >= stripes->width_px,
              static_cast<double>(stripes->width_px)};
}

std::vector<Complement> complements(const BracketPictures& pictures,
                                    const std::vector<bool>& is_taken) {
  std::map<std::tuple<int, Axis, int, int>,
           std::pair<std::optional<std::size_t>, std::optional<std::size_t>>>
      halves;
  std::map<std::tuple<int, Axis, int, int>, double> runs_px;
  for (std::size_t i = 0; i < pictures.shown.size(); ++i) {
    if (is_taken[i] || !pictures.shown[i].picture->is_of_session) continue;
    const auto half = half_of(pictures.shown[i].pattern->kind);
    if (!half) continue;
    auto& pair = halves[half->pair];
    (half->is_second ? pair.second : pair.first) = i;
    runs_px[half->pair] = half->run_px;
  }
  std::vector<Complement> all;
  for (const auto& [key, pair] : halves) {
    if (!pair.first || !pair.second) continue;
    all.push_back(
        {std::min(*pair.first, *pair.second), std::max(*pair.first, *pair.second), runs_px[key]});
  }
  std::sort(all.begin(), all.end(),
            [](const Complement& a, const Complement& b) { return a.first < b.first; });
  return all;
}

// Gathers what the groups of a bracket found.
class Gathering {
 public:
  explicit Gathering(PictureCheck& check) : check_(check) {}

  void hear(const BracketPictures& pictures, const GroupCheck& group) {
    const auto pattern_of = [&](std::size_t i) { return pictures.shown[i].picture->pattern; };
    for (const GroupFinding& found : group.wrong) {
      WrongPicture wrong{pattern_of(found.frame), pictures.bracket, found.share_frac,
                         found.seen_pattern, std::nullopt};
      if (found.or_frame) wrong.or_pattern = pattern_of(*found.or_frame);
      check_.wrong.push_back(wrong);
    }
    for (const auto& [frame, why] : group.unchecked)
      check_.unchecked.push_back({pattern_of(frame), pictures.bracket, why});
    check_.checked_count += static_cast<int>(group.judged_count);
    for (const std::size_t frame : group.wrong_repeats)
      check_.wrong_repeats_s.push_back(pictures.shown[frame].picture->elapsed_s);
  }
  void object(const BracketPictures& pictures, std::size_t frame, const std::string& why) {
    check_.unchecked.push_back({pictures.shown[frame].picture->pattern, pictures.bracket, why});
  }

 private:
  PictureCheck& check_;
};

// Fine stripes that have changed places among themselves are complements as good as before; that
// one bit of the code is the complement of two of them tells it.
bool is_code_against_stripes(const PatternKind& code, const PatternKind& kind) {
  const auto* gray = std::get_if<GrayCode>(&code);
  const auto* stripes = std::get_if<Stripes>(&kind);
  if (gray == nullptr || stripes == nullptr || gray->axis != stripes->axis) return false;
  for (int at_px = 0; at_px < 4 * stripes->period_px; ++at_px) {
    const int row = gray->axis == Axis::kRow ? at_px : 0,
              col = gray->axis == Axis::kRow ? 0 : at_px;
    if (std::abs(brightness(code, row, col) + brightness(kind, row, col) - 1) > 1e-6) return false;
  }
  return true;
}

// By position; a repeat's are its pattern's.
std::vector<PictureRole> roles_of(const BracketPictures& pictures) {
  std::map<int, PictureRole> by_pattern;
  const auto pattern_at = [&pictures](std::size_t i) { return pictures.shown[i].picture->pattern; };
  std::vector<bool> is_taken(pictures.shown.size(), false);
  int number = 0;
  for (const ShiftSeries& series : shift_series(pictures)) {
    for (std::size_t i = 0; i < series.frames.size(); ++i) {
      is_taken[series.frames[i]] = true;
      by_pattern[pattern_at(series.frames[i])] = {number, series.phases_rad[i], {}};
    }
    ++number;
  }
  number = 0;
  const auto add_pair = [&](std::size_t first, std::size_t second) {
    by_pattern[pattern_at(first)].halves.push_back({number, false});
    by_pattern[pattern_at(second)].halves.push_back({number, true});
    ++number;
  };
  const std::vector<Complement> pairs = complements(pictures, is_taken);
  for (const Complement& pair : pairs) add_pair(pair.first, pair.second);
  for (const Complement& pair : pairs)
    for (const std::size_t stripes : {pair.first, pair.second})
      for (const Complement& other : pairs)
        for (const std::size_t code : {other.first, other.second})
          if (is_code_against_stripes(pictures.shown[code].pattern->kind,
                                      pictures.shown[stripes].pattern->kind))
            add_pair(code, stripes);
  std::vector<PictureRole> roles;
  for (std::size_t i = 0; i < pictures.shown.size(); ++i)
    roles.push_back(by_pattern[pattern_at(i)]);
  return roles;
}

GroupCheck check_displaced(const CameraInfo& camera, const BracketPictures& pictures) {
  GroupCheck check;
  const auto run = find_displaced(camera, pictures, roles_of(pictures));
  if (!run) return check;
  for (std::size_t i = run->begin; i < run->end; ++i) {
    GroupFinding found{i, 1};
    const auto shows = static_cast<std::ptrdiff_t>(i) + run->offset;
    if (shows >= 0 && shows < static_cast<std::ptrdiff_t>(pictures.shown.size()))
      found.seen_pattern = pictures.shown[static_cast<std::size_t>(shows)].picture->pattern;
    const SeenPicture& own = *pictures.shown[i].picture;
    if (found.seen_pattern == own.pattern) continue;  // shown twice in a row: it is the same
    if (!own.is_of_session) {
      check.wrong_repeats.push_back(i);
      continue;
    }
    check.wrong.push_back(found);
    ++check.judged_count;
  }
  return check;
}

void check_bracket(const CameraInfo& camera, BracketPictures pictures, Gathering& gathering) {
  const GroupCheck displaced = check_displaced(camera, pictures);
  gathering.hear(pictures, displaced);
  for (auto found = displaced.wrong.rbegin(); found != displaced.wrong.rend(); ++found)
    pictures.shown.erase(pictures.shown.begin() + static_cast<std::ptrdiff_t>(found->frame));
  std::vector<bool> is_taken(pictures.shown.size(), false);
  double speed_px_per_s = 0;
  for (const ShiftSeries& series : shift_series(pictures)) {
    const GroupCheck check = check_shifts(camera, pictures, series);
    for (const std::size_t frame : series.frames) is_taken[frame] = true;
    speed_px_per_s = std::max(speed_px_per_s, check.speed_px_per_s);
    gathering.hear(pictures, check);
  }
  const std::vector<Complement> pairs = complements(pictures, is_taken);
  if (pairs.size() >= kFewestPairs) {
    gathering.hear(pictures, check_complements(camera, pictures, pairs, speed_px_per_s));
    for (const Complement& pair : pairs) is_taken[pair.first] = is_taken[pair.second] = true;
  }
  for (std::size_t i = 0; i < pictures.shown.size(); ++i)
    if (!is_taken[i] && pictures.shown[i].picture->is_of_session)
      gathering.object(pictures, i, "no other patterns tell what it should look like");
}

std::string share_text(double frac) {
  return std::to_string(static_cast<int>(std::lround(100 * std::min(frac, 1.0)))) + "%";
}

}  // namespace

std::string PictureCheck::text() const {
  if (wrong.empty()) {
    std::string said = std::to_string(checked_count) + " frames show their patterns";
    if (!unchecked.empty())
      said += "; " + std::to_string(unchecked.size()) + " could not be checked";
    return said;
  }
  std::string said;
  constexpr std::size_t kMostNamed = 6;
  for (std::size_t i = 0; i < std::min(wrong.size(), kMostNamed); ++i) {
    const WrongPicture& each = wrong[i];
    said += (i == 0 ? "" : "; ") + std::string("pattern ") + std::to_string(each.pattern) +
            " bracket " + std::to_string(each.bracket) + " does not show its picture";
    if (each.or_pattern) said += ", or pattern " + std::to_string(*each.or_pattern) + " does not";
    said += " (" + share_text(each.share_frac) + " is ";
    said += each.seen_pattern ? "pattern " + std::to_string(*each.seen_pattern) + "'s)"
                              : "other light or none)";
  }
  if (wrong.size() > kMostNamed)
    said += "; and " + std::to_string(wrong.size() - kMostNamed) + " more";
  return said;
}

PictureCheck check_pictures(const CameraInfo& camera, const std::vector<Pattern>& patterns,
                            const std::vector<SeenPicture>& pictures) {
  PictureCheck check;
  Gathering gathering(check);
  for (const BracketPictures& bracket : by_bracket(patterns, pictures))
    check_bracket(camera, bracket, gathering);
  const auto by_slot = [](const auto& a, const auto& b) {
    return std::pair(a.pattern, a.bracket) < std::pair(b.pattern, b.bracket);
  };
  std::sort(check.wrong.begin(), check.wrong.end(), by_slot);
  std::sort(check.unchecked.begin(), check.unchecked.end(), by_slot);
  return check;
}

}  // namespace estimation
