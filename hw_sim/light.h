// What the simulated projector has shown, and when: pictures on a time line, read by exposures.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <vector>

#include "estimation/base/image.h"
#include "rig/clock.h"

namespace hw_sim {

// Light leaving the projector: 0..255 grey after the display's gamma ramp. `id` is unique per
// distinct picture object, so that a world can keep what it computed for it.
struct Picture {
  std::uint64_t id = 0;
  estimation::Image<unsigned char> brightness;  // [height_px][width_px]
};

struct LightSegment {
  std::shared_ptr<const Picture>
      picture;  // shared: pictures outlive the time line that an exposure was cut from
  std::chrono::nanoseconds duration{0};
};

// Thread-safe.
class LightTimeline {
 public:
  // Makes whoever calls show() tell all that is lit before `until`, even if it is behind; from any
  // thread.
  using Source = std::function<void(rig::HostTime until)>;

  // From `start` on the projector shows `picture`; starts never go back.
  void show(rig::HostTime start, std::shared_ptr<const Picture> picture);
  // What was shown from `start` to `end`, in order, durations adding up to end - start; nothing
  // before the first show() (dark). Pictures older than 10 s before the newest are forgotten.
  // Asks the source first, where there is one.
  std::vector<LightSegment> between(rig::HostTime start, rig::HostTime end) const;
  // The source that is taken away, by {}, is no longer in use when this returns.
  void set_source(Source source);

 private:
  struct Entry {
    rig::HostTime start;
    std::shared_ptr<const Picture> picture;
  };
  mutable std::mutex source_mutex_;  // taken before mutex_, held while the source is asked
  Source source_;                    // guarded by source_mutex_
  mutable std::mutex mutex_;
  std::deque<Entry> entries_;  // guarded by mutex_
};

}  // namespace hw_sim
