#include "estimation/motion/motion_verdict.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <opencv2/core.hpp>
#include <utility>

namespace estimation {
namespace {

// Standard deviations by which a limit must be passed: less may be noise.
constexpr double kSure = 2;
// Of the variation unexplained: from here gain and ambient light are no longer told apart.
constexpr double kMuddledFrac = 0.15;

std::string fixed(double value, int decimals) {
  char text[32];
  std::snprintf(text, sizeof text, "%.*f", decimals, value);
  return text;
}

std::string percent(double frac) {
  char text[32];
  std::snprintf(text, sizeof text, "%+.1f%%", 100 * frac);
  return text;
}

MotionVerdict worse(MotionVerdict a, MotionVerdict b) {
  return static_cast<int>(a) > static_cast<int>(b) ? a : b;
}

MotionVerdict verdict_of(double size, double sd, const MotionLimits& limits) {
  const double sure = std::abs(size) - kSure * sd;
  if (sure <= limits.good) return MotionVerdict::kGood;
  return sure <= limits.usable ? MotionVerdict::kUsable : MotionVerdict::kRetake;
}

struct Light {
  double frac = 0, sd_frac = 0;
};
Light light_of(const FrameChange& change) {
  if (change.residual_frac > kMuddledFrac) return {change.light_frac + change.ambient_frac, 0};
  return {change.light_frac, change.light_sd_frac};
}
Light ambient_of(const FrameChange& change) {
  if (change.residual_frac > kMuddledFrac) return {};
  return {change.ambient_frac, change.ambient_sd_frac};
}

// Gathers what every repeat says against the capture, the worst of each kind.
class Judgement {
 public:
  Judgement(const MotionScale& scale, const MotionRules& rules) : scale_(scale), rules_(rules) {}

  void hear(const Repeat& repeat, const std::optional<Motion>& motion) {
    if (!repeat.change) return object(MotionVerdict::kRetake, repeat.objection + at(repeat));
    const FrameChange& change = *repeat.change;
    const MotionLimits& stripes =
        rules_.is_shuffled ? rules_.stripes_shuffled_px : rules_.stripes_in_order_px;
    keep_worst(stripes_, verdict_of(motion->stripes_px, motion->stripes_sd_px, stripes),
               motion->stripes_px,
               "the stripes moved by " + fixed(motion->stripes_px, 2) + " projector px" +
                   in_mm(*motion) + at(repeat));
    keep_worst(along_, verdict_of(motion->along_px, motion->along_sd_px, rules_.along_px),
               motion->along_px,
               "the picture moved by " + fixed(motion->along_px, 2) + " px along the stripes" +
                   at(repeat));
    const Light light = light_of(change), ambient = ambient_of(change);
    keep_worst(light_, verdict_of(light.frac, light.sd_frac, rules_.light_frac),
               std::abs(light.frac),
               "the projector's light changed by " + percent(light.frac) + at(repeat));
    keep_worst(
        ambient_, verdict_of(ambient.frac, ambient.sd_frac, rules_.light_frac),
        std::abs(ambient.frac),
        "ambient light changed by " + percent(ambient.frac) + " of the lit picture" + at(repeat));
    for (const LocalChange& place : change.local_changes) {
      // A lit head from hair to neck has its eyes about the middle.
      const bool is_upper = place.height_frac < 0.65;
      keep_worst(local_, MotionVerdict::kUsable, std::abs(place.change_frac),
                 "the light changed by " + percent(place.change_frac) + " around row " +
                     fixed(place.row_px, 0) + ", column " + fixed(place.col_px, 0) +
                     (is_upper ? ", not below the eyes (a blink?)" : "") + at(repeat));
    }
  }

  void hear(const BriefChange& change) {
    std::string text = "the light changed by " + percent(change.change_frac);
    if (change.is_everywhere)
      text += " all over (a flash?)";
    else
      text += " around row " + fixed(change.row_px, 0) + ", column " + fixed(change.col_px, 0) +
              " (a blink?)";
    text += change.patterns.size() == 1 ? " under pattern" : " under patterns";
    for (std::size_t i = 0; i < change.patterns.size(); ++i)
      text += (i == 0 ? " " : ", ") + std::to_string(change.patterns[i]);
    object(MotionVerdict::kUsable, text + " after " + fixed(change.elapsed_s, 1) + " s");
  }

  MotionReport report() const {
    MotionReport report;
    report.verdict = objection_verdict_;
    report.reasons = objections_;
    for (const Worst* worst : {&stripes_, &along_, &light_, &ambient_, &local_}) {
      report.verdict = estimation::worse(report.verdict, worst->verdict);
      if (worst->verdict == MotionVerdict::kUsable || worst->verdict == MotionVerdict::kRetake)
        report.reasons.push_back(worst->text);
    }
    return report;
  }

 private:
  struct Worst {
    MotionVerdict verdict = MotionVerdict::kUnknown;
    double size = -1;
    std::string text;
  };
  static void keep_worst(Worst& worst, MotionVerdict verdict, double size, std::string text) {
    if (size <= worst.size) return;
    worst = {estimation::worse(worst.verdict, verdict), size, std::move(text)};
  }
  void object(MotionVerdict verdict, std::string text) {
    objection_verdict_ = estimation::worse(objection_verdict_, verdict);
    objections_.push_back(std::move(text));
  }
  static std::string at(const Repeat& repeat) {
    return " after " + fixed(repeat.elapsed_s, 1) + " s";
  }
  std::string in_mm(const Motion& motion) const {
    if (!scale_.depth_mm_per_px || !motion.mm) return "";
    return " (" +
           fixed(std::abs(*scale_.depth_mm_per_px) * motion.stripes_px / scale_.projector_px_per_px,
                 2) +
           " mm in depth)";
  }

  const MotionScale& scale_;
  const MotionRules& rules_;
  MotionVerdict objection_verdict_ = MotionVerdict::kUnknown;
  std::vector<std::string> objections_;
  Worst stripes_, along_, light_, ambient_, local_;
};

// Verdict and the largest of what was seen, good or bad.
std::string summary(const MotionReport& report) {
  if (report.repeats.empty()) return "motion and light were not watched: no pattern was repeated";
  std::optional<Motion> most;
  double light_frac = 0, ambient_frac = 0;
  for (std::size_t i = 0; i < report.repeats.size(); ++i) {
    if (!report.repeats[i].change) continue;
    const auto keep = [](double& kept, double frac) {
      if (std::abs(frac) > std::abs(kept)) kept = frac;
    };
    keep(light_frac, light_of(*report.repeats[i].change).frac);
    keep(ambient_frac, ambient_of(*report.repeats[i].change).frac);
    if (!most || report.motions[i]->stripes_px > most->stripes_px) most = report.motions[i];
  }
  std::string text = to_string(report.verdict);
  if (!most) return text + ": " + report.reasons.front();
  text += ": stripes within " + fixed(most->stripes_px, 2) + " px";
  if (most->mm)
    text += ", head within " + fixed(*most->mm, 2) + " +- " + fixed(*most->sd_mm, 2) + " mm";
  text += ", projector light " + percent(light_frac) + ", ambient light " + percent(ambient_frac);
  for (const std::string& reason : report.reasons) text += "; " + reason;
  return text;
}

}  // namespace

std::string to_string(MotionVerdict verdict) {
  switch (verdict) {
    case MotionVerdict::kUnknown:
      return "unknown";
    case MotionVerdict::kGood:
      return "good";
    case MotionVerdict::kUsable:
      return "usable";
    case MotionVerdict::kRetake:
      return "retake";
  }
  return "unknown";
}

Motion motion_of(const Repeat& repeat, const MotionScale& scale) {
  const FrameChange& change = *repeat.change;
  const double across =
      change.shift_row_px * scale.across_row + change.shift_col_px * scale.across_col;
  const double along =
      change.shift_col_px * scale.across_row - change.shift_row_px * scale.across_col;
  const double across_sd = std::hypot(change.shift_row_sd_px * scale.across_row,
                                      change.shift_col_sd_px * scale.across_col);
  const double along_sd = std::hypot(change.shift_col_sd_px * scale.across_row,
                                     change.shift_row_sd_px * scale.across_col);
  Motion motion;
  motion.stripes_px = scale.projector_px_per_px * std::max(change.local_shift_px, std::abs(across));
  motion.stripes_sd_px = scale.projector_px_per_px * across_sd;
  motion.along_px = std::abs(along);
  motion.along_sd_px = along_sd;
  if (repeat.by_surface) {
    const Vec3& t = repeat.by_surface->translation_mm;
    const Vec3& sd = repeat.by_surface->sd_mm;
    motion.mm = cv::norm(t);
    // Along the motion; where there is none, the longest.
    motion.sd_mm = *motion.mm > 0
                       ? cv::norm(Vec3(t[0] * sd[0], t[1] * sd[1], t[2] * sd[2])) / *motion.mm
                       : std::max({sd[0], sd[1], sd[2]});
    return motion;
  }
  if (!scale.lateral_mm_per_px) return motion;
  const double depth_mm_per_px = scale.depth_mm_per_px.value_or(*scale.lateral_mm_per_px);
  motion.mm = std::hypot(across * depth_mm_per_px, along * *scale.lateral_mm_per_px);
  motion.sd_mm = std::hypot(across_sd * depth_mm_per_px, along_sd * *scale.lateral_mm_per_px);
  return motion;
}

MotionReport judge_motion(std::vector<Repeat> repeats, const MotionScale& scale,
                          const MotionRules& rules, std::vector<BriefChange> brief_changes) {
  Judgement judgement(scale, rules);
  std::vector<std::optional<Motion>> motions;
  for (const Repeat& repeat : repeats) {
    motions.push_back(repeat.change ? std::optional(motion_of(repeat, scale)) : std::nullopt);
    judgement.hear(repeat, motions.back());
  }
  for (const BriefChange& change : brief_changes) judgement.hear(change);
  MotionReport report = judgement.report();
  report.brief_changes = std::move(brief_changes);
  report.repeats = std::move(repeats);
  report.motions = std::move(motions);
  report.text = summary(report);
  return report;
}

}  // namespace estimation
