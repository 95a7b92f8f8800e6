#include "hw_sim/light.h"

#include <algorithm>
#include <utility>

#include "estimation/base/check.h"

namespace hw_sim {

void LightTimeline::show(rig::HostTime start, std::shared_ptr<const Picture> picture) {
  const std::lock_guard lock(mutex_);
  estimation::check(entries_.empty() || start >= entries_.back().start,
                    "light time line went back");
  entries_.push_back({start, std::move(picture)});
  while (entries_.size() > 1 && entries_[1].start < start - std::chrono::seconds(10))
    entries_.pop_front();
}

void LightTimeline::set_source(Source source) {
  const std::lock_guard lock(source_mutex_);
  source_ = std::move(source);
}

std::vector<LightSegment> LightTimeline::between(rig::HostTime start, rig::HostTime end) const {
  {
    const std::lock_guard lock(source_mutex_);
    if (source_) source_(end);
  }
  const std::lock_guard lock(mutex_);
  std::vector<LightSegment> segments;
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    const rig::HostTime from = std::max(start, entries_[i].start);
    const rig::HostTime to = i + 1 < entries_.size() ? std::min(end, entries_[i + 1].start) : end;
    if (from < to) segments.push_back({entries_[i].picture, to - from});
  }
  return segments;
}

}  // namespace hw_sim
