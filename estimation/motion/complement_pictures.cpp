// Whether pictures and their complements add up to white and black at every place, as all others
// do. Where a sum is off, the light of the frame beside one of the two, which may have been shown
// in its place, says whether that is why: then places that it would have lit are too bright, and
// places that it would have left dark are too dark, both by the same share. Other light is too much
// everywhere; what happens in a part of the frame has little share in the whole.
#include <algorithm>
#include <cmath>
#include <utility>

#include "estimation/motion/picture_series.h"
#include "estimation/motion/picture_share.h"

namespace estimation {
namespace {

// A pair's own share of wrong light that its motion can feign, for each stretch of light that it
// moved by between the two.
constexpr double kMotionShare = 1.5;
constexpr double kMostFrac = 0.7;            // a limit beyond it finds nothing
constexpr double kMostImpossibleFrac = 0.1;  // of the places
// From here on a mixture is no longer told from a pair that moved by a whole stretch of light.
constexpr double kSurelyWhole = 0.93;
// Noise of what was expected is in the surplus and in the change, and seems a share of its own.
constexpr double kLeastSignal = 6;  // the change's square, of all pairs' surplus' square
constexpr float kLit = 0.3F, kImpossible = 0.15F;  // of white and black
constexpr double kFewestLitFrac = 0.3;             // of the places, to tell light from none
constexpr double kLeastExplained = 0.4;            // of a surplus' square, less what all pairs have
constexpr double kAlike = 0.25;                    // two shares that are the same
constexpr double kTie = 0.9;  // of what the best explains: cannot be told from it
constexpr std::size_t kMostSums = 5;

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
  const PlaceLight& light_of(std::size_t pair, bool is_second) const {
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
  PlaceLight sum_by(const std::vector<std::size_t>& references) const {
    std::vector<PlaceLight> sums;
    for (const std::size_t pair : references) {
      sums.push_back(light_of(pair, false));
      const PlaceLight& second = light_of(pair, true);
      for (std::size_t i = 0; i < second.size(); ++i) sums.back()[i] += second[i];
    }
    // Sorted at each place, all places side by side: neighbours change places, in turns.
    for (std::size_t turn = 0; turn < sums.size(); ++turn)
      for (std::size_t k = turn % 2; k + 1 < sums.size(); k += 2)
        put_in_order(sums[k], sums[k + 1]);
    PlaceLight& middle = sums[sums.size() / 2];
    if (sums.size() % 2 == 0) {
      const PlaceLight& below = sums[sums.size() / 2 - 1];
      for (std::size_t i = 0; i < middle.size(); ++i) middle[i] = (below[i] + middle[i]) / 2;
    }
    return std::move(middle);
  }
  static void put_in_order(PlaceLight& less, PlaceLight& more) {
    for (std::size_t i = 0; i < less.size(); ++i) {
      const float a = less[i], b = more[i];
      less[i] = std::min(a, b);
      more[i] = std::max(a, b);
    }
  }

  // Of one of the pair: what another picture in its place would change.
  struct Expected {
    PlaceLight surplus, light_dn, sum;
  };
  PictureShare share_by(const Expected& expected, const PlaceLight& other) const {
    PlaceLight change(other.size());
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
    const PlaceLight &first = light_of(pair, false), &second = light_of(pair, true);
    expected.surplus.resize(first.size());
    for (std::size_t i = 0; i < first.size(); ++i)
      expected.surplus[i] = first[i] + second[i] - expected.sum[i];
    for (const float surplus : expected.surplus)
      judgement.surplus_square += static_cast<double>(surplus * surplus);
    for (const bool is_second : {false, true}) {
      const PlaceLight& partner = is_second ? first : second;
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
    if (static_cast<double>(impossible_count) > kMostImpossibleFrac * all) {
      judgement.blind.emplace_back(frame, "its complement shows more light than white does");
      return;
    }
    const auto suspect = [&](const PictureShare& share, std::optional<int> seen_pattern) {
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
      const PictureShare share = share_by(expected, light_at(camera_, table_, picture));
      if (!share.is_visible && direction < 0)
        judgement.blind.emplace_back(frame, "looks like the picture that was shown before it");
      if (share.is_visible && direction < 0)
        judgement.visible.emplace_back(frame, share.change_square);
      if (other == partner && is_motion(pair, is_second, expected, share)) continue;
      suspect(share, picture.pattern);
    }
    if (static_cast<double>(lit_count) > kFewestLitFrac * all)
      suspect(share_by(expected, PlaceLight(expected.sum.size(), 0.0F)), std::nullopt);
  }

  // A pair that moved between its two seems a mixture of either with the other, by one share. Of a
  // true mixture the other way round is none, or more than all of it.
  bool is_motion(std::size_t pair, bool is_second, const Expected& expected,
                 const PictureShare& share) const {
    if (share.frac >= kSurelyWhole) return false;
    Expected other_way = expected;
    other_way.light_dn.resize(expected.sum.size());
    const PlaceLight& own = light_of(pair, is_second);
    for (std::size_t i = 0; i < expected.sum.size(); ++i)
      other_way.light_dn[i] = expected.sum[i] - own[i];
    const PictureShare back = share_by(other_way, own);
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
