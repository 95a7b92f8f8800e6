// Whether pictures and their complements add up to white and black at every place, as all others
// do. Where a sum is off, the light of the frame beside one of the two, which may have been shown
// in its place, says whether that is why: then places that it would have lit are too bright, and
// places that it would have left dark are too dark, both by the same share. Other light is too much
// everywhere; what happens in a part of the frame has little share in the whole.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "estimation/motion/picture_series.h"

namespace estimation {
namespace {

using Light = std::vector<float>;

// A pair's own share of wrong light that its motion can feign, for each stretch of light that it
// moved by between the two.
constexpr double kMotionShare = 1.5;
constexpr double kMostFrac = 0.7;       // a limit beyond it finds nothing
constexpr double kLeastContrast = 0.1;  // of the light: less, and two pictures look the same
// Of the light: what makes all places brighter, or all darker, by less may be lamp or room.
constexpr double kLeastOneSided = 0.1;
constexpr double kFewestFrac = 0.005;  // of the places
constexpr double kFewestQuietFrac = 0.1;
constexpr double kMostQuiet = 0.3;  // of the share: what places that cannot change may show
constexpr double kLeastWhole = 0.85, kMostWhole = 1.15;
// From here on a mixture is no longer told from a pair that moved by a whole stretch of light.
constexpr double kSurelyWhole = 0.93;
constexpr double kMostUnexplained = 0.1;  // of the surplus' square
// Noise of what was expected is in the surplus and in the change, and seems a share of its own.
constexpr double kLeastSignal = 6;  // the change's square, of all pairs' surplus' square
constexpr double kWholeContrast = 0.3;
constexpr float kLit = 0.3F, kImpossible = 0.15F;  // of white and black
constexpr double kFewestLitFrac = 0.3;             // of the places, to tell light from none
constexpr double kLeastExplained = 0.4;            // of a surplus' square, less what all pairs have
constexpr double kAlike = 0.25;                    // two shares that are the same
constexpr double kTie = 0.9;  // of what the best explains: cannot be told from it
constexpr std::size_t kMostSums = 5;

// Of a surplus over places where the change would be more, less, or nothing.
struct Sums {
  std::size_t more_count = 0, less_count = 0, quiet_count = 0;
  double more_product = 0, less_product = 0;   // surplus times change
  double more_square = 0, less_square = 0;     // of the change
  double quiet_product = 0, quiet_square = 0;  // surplus times light; of the light
  double surplus_square = 0, change_square = 0, light_square = 0;
};

// `surplus` = seen less expected, `change` = the other picture less expected; `light` white +
// black.
Sums sum_up(const Light& surplus, const Light& change, const Light& light, float bound) {
  Sums sums;
  constexpr std::size_t kRun = 512;
  for (std::size_t begin = 0; begin < surplus.size(); begin += kRun) {
    const std::size_t end = std::min(begin + kRun, surplus.size());
    std::array<float, 11> part{};
    for (std::size_t i = begin; i < end; ++i) {
      const float limit = bound * light[i];
      const float more = change[i] > limit ? 1.0F : 0.0F, less = change[i] < -limit ? 1.0F : 0.0F;
      const float quiet = std::abs(change[i]) < 0.5F * limit ? 1.0F : 0.0F;
      const float product = surplus[i] * change[i], square = change[i] * change[i];
      part[0] += more;
      part[1] += less;
      part[2] += quiet;
      part[3] += more * product;
      part[4] += less * product;
      part[5] += more * square;
      part[6] += less * square;
      part[7] += quiet * surplus[i] * light[i];
      part[8] += quiet * light[i] * light[i];
      part[9] += surplus[i] * surplus[i];
      part[10] += square;
    }
    sums.more_count += static_cast<std::size_t>(part[0]);
    sums.less_count += static_cast<std::size_t>(part[1]);
    sums.quiet_count += static_cast<std::size_t>(part[2]);
    double* const into[] = {&sums.more_product,   &sums.less_product,  &sums.more_square,
                            &sums.less_square,    &sums.quiet_product, &sums.quiet_square,
                            &sums.surplus_square, &sums.change_square};
    for (std::size_t k = 0; k < std::size(into); ++k) *into[k] += static_cast<double>(part[k + 3]);
  }
  return sums;
}

// How much of a frame's light another picture would have, if it were one.
struct Share {
  double frac = 0;       // by places that would be brighter and darker alike
  double explained = 0;  // of the surplus' square
  double surplus_square = 0, change_square = 0;
  bool is_visible = false;
};

Share share_of(const Light& surplus, const Light& change, const Light& light) {
  double square = 0, light_square = 0;
  for (std::size_t i = 0; i < change.size(); ++i) {
    square += static_cast<double>(change[i] * change[i]);
    light_square += static_cast<double>(light[i] * light[i]);
  }
  const double contrast = std::sqrt(square / light_square);
  if (!(contrast > kLeastContrast)) return {};
  const Sums sums = sum_up(surplus, change, light, static_cast<float>(0.5 * contrast));
  const double product = sums.more_product + sums.less_product;
  const double all_square = sums.more_square + sums.less_square;
  Share share{0, 0, sums.surplus_square, square, true};
  if (!(all_square > 0)) return share;
  const double frac = product / all_square;
  const double sd = std::sqrt(std::max(sums.surplus_square - frac * frac * all_square, 0.0) /
                              static_cast<double>(surplus.size()) / all_square * 2);
  const auto enough = [&surplus](std::size_t count, double of) {
    return static_cast<double>(count) >= of * static_cast<double>(surplus.size());
  };
  if (enough(sums.more_count, kFewestFrac) && enough(sums.less_count, kFewestFrac)) {
    share.frac =
        std::min(sums.more_product / sums.more_square, sums.less_product / sums.less_square);
  } else if (enough(sums.quiet_count, kFewestQuietFrac)) {
    const double quiet = sums.quiet_product / sums.quiet_square / contrast;
    if (std::abs(quiet) < kMostQuiet * std::abs(frac)) share.frac = frac;
  } else if (contrast > kWholeContrast && frac > kLeastWhole && frac < kMostWhole &&
             sums.surplus_square - frac * product < kMostUnexplained * sums.surplus_square) {
    share.frac = frac;
  }
  const bool is_two_sided =
      enough(sums.more_count, kFewestFrac) && enough(sums.less_count, kFewestFrac);
  if (!is_two_sided && share.frac * contrast < kLeastOneSided) share.frac = 0;
  if (share.frac < kSureOfPicture * sd) share.frac = 0;
  share.explained = frac * product;
  return share;
}

class ComplementCheck {
 public:
  ComplementCheck(const CameraInfo& camera, const BracketPictures& pictures,
                  std::vector<Complement> pairs, double speed_px_per_s)
      : camera_(camera),
        pictures_(pictures),
        pairs_(std::move(pairs)),
        speed_px_per_s_(speed_px_per_s),
        frames_(frames_of(pairs_)),
        table_(make_table(camera, pictures, frames_)) {}

  GroupCheck run() && {
    if (table_.places.size() < kFewestPlaces) {
      for (const std::size_t frame : frames_)
        check_.unchecked.emplace_back(frame, "too little is lit, or too much of it clipped");
      return std::move(check_);
    }
    is_clean_.assign(pairs_.size(), true);
    for (std::size_t pair = 0; pair < pairs_.size(); ++pair) judgements_.push_back(judge(pair));
    while (find_worst()) {
    }
    tell_unchecked();
    return std::move(check_);
  }

 private:
  struct Suspicion {
    GroupFinding finding;
    double explained = 0, surplus_square = 0, change_square = 0;
  };
  struct Judgement {
    double surplus_square = 0;  // of the pair
    std::vector<Suspicion> suspicions;
    std::vector<std::pair<std::size_t, std::string>> blind;
    std::vector<std::pair<std::size_t, double>> visible;  // frame; square of the change to find
  };

  static std::vector<std::size_t> frames_of(const std::vector<Complement>& pairs) {
    std::vector<std::size_t> frames;
    for (const Complement& pair : pairs) frames.insert(frames.end(), {pair.first, pair.second});
    return frames;
  }
  const Light& light_of(std::size_t pair, bool is_second) const {
    return table_.light_dn[2 * pair + (is_second ? 1 : 0)];
  }
  double shown_s(std::size_t pair) const {
    return pictures_.shown[pairs_[pair].first].picture->elapsed_s;
  }

  // The pairs that tell what this one should add up to: those shown next to it.
  std::vector<std::size_t> references(std::size_t pair) const {
    std::vector<std::size_t> others;
    for (std::size_t other = 0; other < pairs_.size(); ++other)
      if (other != pair && is_clean_[other]) others.push_back(other);
    std::stable_sort(others.begin(), others.end(), [&](std::size_t a, std::size_t b) {
      return std::abs(shown_s(a) - shown_s(pair)) < std::abs(shown_s(b) - shown_s(pair));
    });
    if (others.size() > kMostSums) others.resize(kMostSums);
    return others;
  }

  // White and black together, by the median of the references at each place.
  Light sum_by(const std::vector<std::size_t>& references) const {
    std::vector<Light> sums;
    for (const std::size_t pair : references) {
      sums.push_back(light_of(pair, false));
      const Light& second = light_of(pair, true);
      for (std::size_t i = 0; i < second.size(); ++i) sums.back()[i] += second[i];
    }
    // Sorted at each place, all places side by side: neighbours change places, in turns.
    for (std::size_t turn = 0; turn < sums.size(); ++turn)
      for (std::size_t k = turn % 2; k + 1 < sums.size(); k += 2)
        put_in_order(sums[k], sums[k + 1]);
    Light& middle = sums[sums.size() / 2];
    if (sums.size() % 2 == 0) {
      const Light& below = sums[sums.size() / 2 - 1];
      for (std::size_t i = 0; i < middle.size(); ++i) middle[i] = (below[i] + middle[i]) / 2;
    }
    return std::move(middle);
  }
  static void put_in_order(Light& less, Light& more) {
    for (std::size_t i = 0; i < less.size(); ++i) {
      const float a = less[i], b = more[i];
      less[i] = std::min(a, b);
      more[i] = std::max(a, b);
    }
  }

  // Of one of the pair: what another picture in its place would change.
  struct Expected {
    Light surplus, light_dn, sum;
  };
  Share share_by(const Expected& expected, const Light& other) const {
    Light change(other.size());
    for (std::size_t i = 0; i < change.size(); ++i) change[i] = other[i] - expected.light_dn[i];
    return share_of(expected.surplus, change, expected.sum);
  }

  Judgement judge(std::size_t pair) const {
    const std::vector<std::size_t> others = references(pair);
    Judgement judgement;
    if (others.empty()) {
      for (const std::size_t frame : {pairs_[pair].first, pairs_[pair].second})
        judgement.blind.emplace_back(frame, "no other pair tells what it should add up to");
      return judgement;
    }
    Expected expected{{}, {}, sum_by(others)};
    const Light &first = light_of(pair, false), &second = light_of(pair, true);
    expected.surplus.resize(first.size());
    for (std::size_t i = 0; i < first.size(); ++i)
      expected.surplus[i] = first[i] + second[i] - expected.sum[i];
    for (const float surplus : expected.surplus)
      judgement.surplus_square += static_cast<double>(surplus * surplus);
    for (const bool is_second : {false, true}) {
      const Light& partner = is_second ? first : second;
      expected.light_dn.resize(partner.size());
      for (std::size_t i = 0; i < partner.size(); ++i)
        expected.light_dn[i] = expected.sum[i] - partner[i];
      judge_frame(pair, is_second, expected, judgement);
    }
    return judgement;
  }

  double limit_of(std::size_t pair) const {
    const Complement& own = pairs_[pair];
    if (!(own.run_px > 0)) return kWrongFrac;
    const double apart_s = pictures_.shown[own.second].picture->elapsed_s -
                           pictures_.shown[own.first].picture->elapsed_s;
    return kWrongFrac + kMotionShare * speed_px_per_s_ * apart_s / own.run_px;
  }

  void judge_frame(std::size_t pair, bool is_second, const Expected& expected,
                   Judgement& judgement) const {
    const std::size_t frame = is_second ? pairs_[pair].second : pairs_[pair].first;
    const std::size_t partner = is_second ? pairs_[pair].first : pairs_[pair].second;
    const double limit = limit_of(pair);
    if (limit > kMostFrac) {
      judgement.blind.emplace_back(frame, "the stripes moved too fast");
      return;
    }
    std::size_t lit_count = 0, impossible_count = 0;
    for (std::size_t i = 0; i < expected.sum.size(); ++i) {
      lit_count += expected.light_dn[i] > kLit * expected.sum[i] ? 1U : 0U;
      impossible_count += expected.light_dn[i] < -kImpossible * expected.sum[i] ? 1U : 0U;
    }
    const auto all = static_cast<double>(expected.sum.size());
    // Its complement was brighter than white: other light came in, and says nothing of this one.
    if (static_cast<double>(impossible_count) > kFewestQuietFrac * all) {
      judgement.blind.emplace_back(frame, "its complement shows more light than white does");
      return;
    }
    const auto suspect = [&](const Share& share, std::optional<int> seen_pattern) {
      if (share.frac > limit)
        judgement.suspicions.push_back({{frame, share.frac, seen_pattern, {}},
                                        share.explained,
                                        share.surplus_square,
                                        share.change_square});
    };
    for (const int direction : {-1, 1}) {
      if ((direction < 0 && frame == 0) || (direction > 0 && frame + 1 == pictures_.shown.size()))
        continue;
      const std::size_t other = direction < 0 ? frame - 1 : frame + 1;
      const SeenPicture& picture = *pictures_.shown[other].picture;
      if (picture.pattern == pictures_.shown[frame].picture->pattern) continue;
      const Share share = share_by(expected, light_at(camera_, table_, picture));
      if (!share.is_visible && direction < 0)
        judgement.blind.emplace_back(frame, "looks like the picture that was shown before it");
      if (share.is_visible && direction < 0)
        judgement.visible.emplace_back(frame, share.change_square);
      if (other == partner && is_motion(pair, is_second, expected, share)) continue;
      suspect(share, picture.pattern);
    }
    if (static_cast<double>(lit_count) > kFewestLitFrac * all)
      suspect(share_by(expected, Light(expected.sum.size(), 0.0F)), std::nullopt);
  }

  // A pair that moved between its two seems a mixture of either with the other, by one share. Of a
  // true mixture the other way round is none, or more than all of it.
  bool is_motion(std::size_t pair, bool is_second, const Expected& expected,
                 const Share& share) const {
    if (share.frac >= kSurelyWhole) return false;
    Expected other_way = expected;
    other_way.light_dn.resize(expected.sum.size());
    const Light& own = light_of(pair, is_second);
    for (std::size_t i = 0; i < expected.sum.size(); ++i)
      other_way.light_dn[i] = expected.sum[i] - own[i];
    const Share back = share_by(other_way, own);
    return std::abs(back.frac - share.frac) < kAlike * share.frac;
  }

  // What pairs that are right do not add up to: noise.
  double usual_surplus_square() const {
    std::vector<double> squares;
    for (std::size_t pair = 0; pair < pairs_.size(); ++pair)
      if (is_clean_[pair]) squares.push_back(judgements_[pair].surplus_square);
    return median_of(std::move(squares));
  }

  // Of all pairs; it no longer tells of others, which are judged anew where it did. False: none.
  bool find_worst() {
    const double usual = usual_surplus_square();
    std::size_t worst = pairs_.size();
    const Suspicion* suspicion = nullptr;
    for (std::size_t pair = 0; pair < pairs_.size(); ++pair) {
      for (const Suspicion& each : judgements_[pair].suspicions) {
        if (each.change_square < kLeastSignal * usual) continue;
        if (each.explained < kLeastExplained * (each.surplus_square - usual)) continue;
        if (suspicion != nullptr && each.explained <= suspicion->explained) continue;
        suspicion = &each;
        worst = pair;
      }
    }
    if (suspicion == nullptr) return false;
    GroupFinding finding = suspicion->finding;
    for (const Suspicion& each : judgements_[worst].suspicions) {
      if (each.finding.frame == finding.frame || each.explained < kTie * suspicion->explained)
        continue;
      GroupFinding other = each.finding;
      other.or_frame = finding.frame;
      finding.or_frame = other.frame;
      check_.wrong.push_back(other);
      break;
    }
    check_.wrong.push_back(finding);
    check_.judged_count += 2;
    std::vector<std::size_t> again;
    for (std::size_t pair = 0; pair < pairs_.size(); ++pair) {
      const auto own = references(pair);
      if (is_clean_[pair] && pair != worst && std::find(own.begin(), own.end(), worst) != own.end())
        again.push_back(pair);
    }
    is_clean_[worst] = false;
    judgements_[worst] = {};
    for (const std::size_t pair : again) judgements_[pair] = judge(pair);
    return true;
  }

  void tell_unchecked() {
    const double usual = usual_surplus_square();
    for (std::size_t pair = 0; pair < pairs_.size(); ++pair) {
      if (!is_clean_[pair]) continue;
      for (const auto& [frame, change_square] : judgements_[pair].visible)
        if (change_square < kLeastSignal * usual)
          judgements_[pair].blind.emplace_back(frame, "too little light for its noise");
      check_.judged_count += 2 - judgements_[pair].blind.size();
      check_.unchecked.insert(check_.unchecked.end(), judgements_[pair].blind.begin(),
                              judgements_[pair].blind.end());
    }
  }

  const CameraInfo& camera_;
  const BracketPictures& pictures_;
  const std::vector<Complement> pairs_;
  const double speed_px_per_s_;
  const std::vector<std::size_t> frames_;
  const LitTable table_;  // [2 * pair + is second]
  std::vector<bool> is_clean_;
  std::vector<Judgement> judgements_;
  GroupCheck check_;
};

}  // namespace

GroupCheck check_complements(const CameraInfo& camera, const BracketPictures& pictures,
                             const std::vector<Complement>& pairs, double speed_px_per_s) {
  return ComplementCheck(camera, pictures, pairs, speed_px_per_s).run();
}

}  // namespace estimation
