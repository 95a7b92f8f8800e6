#include "capture/motion_watch.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "estimation/base/check.h"

namespace capture {
namespace {

estimation::Axis axis_of(const estimation::PatternKind& kind) {
  if (const auto* stripes = std::get_if<estimation::Stripes>(&kind)) return stripes->axis;
  if (const auto* gray = std::get_if<estimation::GrayCode>(&kind)) return gray->axis;
  if (const auto* fringe = std::get_if<estimation::Fringe>(&kind)) return fringe->axis;
  return estimation::Axis::kColumn;
}

// In the projector's picture; 0: the pattern has none.
double period_px(const estimation::PatternKind& kind) {
  if (const auto* stripes = std::get_if<estimation::Stripes>(&kind)) return stripes->period_px;
  if (const auto* fringe = std::get_if<estimation::Fringe>(&kind)) return fringe->period_px;
  // A bit of Gray code is lit every other pair of runs.
  if (const auto* gray = std::get_if<estimation::GrayCode>(&kind))
    return std::ldexp(4.0, gray->bit);
  return 0;
}

estimation::MotionScale scale_of(const estimation::Manifest& manifest, int pattern) {
  const estimation::Pattern* repeated = manifest.find_pattern(pattern);
  estimation::check(repeated != nullptr, "the pattern that is repeated is none of the session's");
  return estimation::motion_scale(manifest.camera, manifest.calibration, axis_of(repeated->kind));
}

estimation::MotionRules rules_for(bool is_shuffled) {
  estimation::MotionRules rules;
  rules.is_shuffled = is_shuffled;
  return rules;
}

}  // namespace

MotionWatch::MotionWatch(const estimation::Manifest& manifest, int pattern,
                         std::size_t bracket_count, std::size_t frame_count, bool is_shuffled)
    : camera_(manifest.camera),
      calibration_(manifest.calibration),
      axis_(axis_of(manifest.find_pattern(pattern)->kind)),
      scale_(scale_of(manifest, pattern)),
      period_px_(period_px(manifest.find_pattern(pattern)->kind) / scale_.projector_px_per_px),
      rules_(rules_for(is_shuffled)),
      patterns_(manifest.patterns),
      grid_(estimation::block_grid(camera_, axis_, period_px_)),
      bracket_count_(bracket_count),
      queue_(frame_count),
      thread_([this] { run(); }) {}

MotionWatch::~MotionWatch() { queue_.close(); }

void MotionWatch::push(Use use, int number, const CapturedFrame& frame) {
  last_arrival_ = std::max(last_arrival_.value_or(frame.frame->received), frame.frame->received);
  queue_.push(std::make_shared<const Item>(
      Item{use, number, frame.slot.bracket, frame.evidence.edge, frame.frame, {}}));
}

void MotionWatch::add_first(const CapturedFrame& frame) { push(Use::kFirst, 0, frame); }

void MotionWatch::add_any(const CapturedFrame& frame) {
  push(Use::kAny, frame.slot.pattern, frame);
}

void MotionWatch::add_first(int bracket, rig::HostTime edge, estimation::Image<std::uint16_t> dn) {
  queue_.push(
      std::make_shared<const Item>(Item{Use::kFirst, 0, bracket, edge, nullptr, std::move(dn)}));
}

void MotionWatch::add_repeat(int repeat, const CapturedFrame& frame) {
  push(Use::kRepeat, repeat, frame);
}

void MotionWatch::know(estimation::Repeat repeat) { known_.push_back(std::move(repeat)); }

void MotionWatch::run() {
  while (const auto item = queue_.pop()) {
    switch ((*item)->use) {
      case Use::kAny:
        look_at(**item);
        continue;
      case Use::kFirst:
        firsts_[(*item)->bracket] = *item;
        if (firsts_.size() == bracket_count_) choose_bracket();
        break;
      case Use::kRepeat:
        waiting_.push_back(*item);
        break;
    }
    if (!bracket_) continue;
    for (const auto& waiting : std::exchange(waiting_, {}))
      if (waiting->bracket == *bracket_) {
        compare(waiting->number, *waiting);
        compared_[waiting->number] = waiting;
      }
  }
  brief_changes_ = estimation::find_brief_changes(camera_, grid_, patterns_, seen_);
}

void MotionWatch::look_at(const Item& item) {
  if (!first_seen_) first_seen_ = item.edge;
  const double elapsed_s = std::chrono::duration<double>(item.edge - *first_seen_).count();
  with_samples(item, [&](estimation::ImageView<const std::uint16_t> dn) {
    seen_.push_back({item.number, item.bracket, elapsed_s, block_light(camera_, grid_, dn)});
  });
}

template <typename Work>
void MotionWatch::with_samples(const Item& item, const Work& work) {
  if (!item.frame) return work(item.stored.view());
  const FrameSamples samples(*item.frame);
  work(samples.view());
}

bool MotionWatch::hardly_clips(const Item& item) const {
  if (!camera_.saturation_level_dn) return true;
  std::size_t clipped_count = 0, count = 0;
  with_samples(item, [&](estimation::ImageView<const std::uint16_t> dn) {
    for (int row = 0; row < dn.height_px; ++row) {
      for (const std::uint16_t sample : dn.row(row))
        if (sample >= *camera_.saturation_level_dn) ++clipped_count;
      count += dn.row(row).size();
    }
  });
  constexpr double kMostClippedFrac = 0.01;
  return static_cast<double>(clipped_count) <= kMostClippedFrac * static_cast<double>(count);
}

void MotionWatch::choose_bracket() {
  bracket_ = 0;
  for (const auto& [bracket, item] : firsts_)
    if (hardly_clips(*item)) bracket_ = bracket;
  std::erase_if(firsts_, [this](const auto& first) { return first.first != *bracket_; });
}

void MotionWatch::compare(int repeat, const Item& item) {
  const Item& first = *firsts_.at(*bracket_);
  estimation::Repeat& told = repeats_[repeat];
  // Frames from before the computer was started anew have a clock of their own.
  told.elapsed_s = std::max(0.0, std::chrono::duration<double>(item.edge - first.edge).count());
  with_samples(first, [&](estimation::ImageView<const std::uint16_t> before) {
    with_samples(item, [&](estimation::ImageView<const std::uint16_t> after) {
      const auto change = estimation::measure_change(camera_, period_px_, before, after);
      if (change)
        told.change = *change;
      else
        told.objection = change.error().text();
    });
  });
}

estimation::MotionReport MotionWatch::finish() {
  queue_.close();
  thread_.join();
  return judge();
}

estimation::MotionReport MotionWatch::judge() const {
  std::vector<estimation::Repeat> repeats = known_;
  for (const auto& [number, repeat] : repeats_) repeats.push_back(repeat);
  return estimation::judge_motion(std::move(repeats), scale_, rules_, brief_changes_);
}

estimation::MotionReport MotionWatch::finish_by(const estimation::Maps& maps) {
  for (const auto& [number, item] : compared_) {
    estimation::Repeat& repeat = repeats_.at(number);
    if (!repeat.change) continue;
    with_samples(*firsts_.at(*bracket_), [&](estimation::ImageView<const std::uint16_t> before) {
      with_samples(*item, [&](estimation::ImageView<const std::uint16_t> after) {
        const auto motion = estimation::measure_surface_motion(camera_, calibration_, axis_,
                                                               period_px_, maps, before, after);
        if (motion) repeat.by_surface = *motion;  // else the calibrated distance must do
      });
    });
  }
  return judge();
}

}  // namespace capture
