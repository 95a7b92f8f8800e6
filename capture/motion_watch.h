// Compares the repeats of a pattern with its first showing while the capture goes on, and looks at
// every frame for what changes the light for a moment.
#pragma once

#include <chrono>
#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "capture/bounded_queue.h"
#include "capture/captured_frame.h"
#include "estimation/base/image.h"
#include "estimation/motion/motion_verdict.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"

namespace capture {

// Calls come from the session thread; frames are compared on a thread of its own. Of the brackets
// it takes the longest in which hardly anything clips.
//
// Where the camera sees the sync square, two showings of a pattern differ by it, unless it had the
// same level at both. So a take shows the pattern that it repeats twice in a row at first, once
// under each level (capture/take.h), and each repeat is compared with the one of its own level.
// Where each bracket is a flip of its own and their number is even, a bracket has one level always.
class MotionWatch {
 public:
  // `manifest` describes camera, projector and calibration, and has the pattern that is repeated.
  // `brackets`: of the first showing, whose frames will come. At most `frame_count` frames wait at
  // a time: as many as a run has, and add does not block.
  MotionWatch(const estimation::Manifest& manifest, int pattern, std::vector<int> brackets,
              std::size_t frame_count);
  ~MotionWatch();
  MotionWatch(const MotionWatch&) = delete;
  MotionWatch& operator=(const MotionWatch&) = delete;

  // A frame of the first showing: just taken, or read back from the disk. A later one of a bracket
  // takes the place of an earlier one; those of other brackets are not looked at.
  void add_first(const CapturedFrame& frame);
  void add_first(int bracket, rig::HostTime edge, estimation::Image<std::uint16_t> dn);
  // A frame of any of the session's patterns, `frame.slot`; a later one of a slot as above.
  void add_any(const CapturedFrame& frame);
  // A frame of a repeat.
  void add_repeat(const CapturedFrame& frame);
  // Repeats that did not show their pattern, by the seconds of their edges: they tell nothing.
  void forget_repeats(const std::vector<double>& edges_s);

  // Waits for the frames on their way, then judges all there are. As often as more have come.
  // Repeats whose frames did not come, and all if the first showing's did not, are not judged.
  estimation::MotionReport judge(const estimation::MotionRules& rules);
  // The same with the head's motion in mm by the surface that was found, where that tells it; on
  // the calling thread.
  estimation::MotionReport judge_by(const estimation::Maps& maps,
                                    const estimation::MotionRules& rules);
  // When the latest of the frames that were added arrived; none: nullopt.
  std::optional<rig::HostTime> last_arrival() const { return last_arrival_; }

 private:
  enum class Use { kFirst, kRepeat, kAny };
  struct Item {
    Use use = Use::kFirst;
    SlotId slot;
    rig::HostTime edge;
    std::optional<bool> is_square_light;  // nullopt: not known
    std::shared_ptr<const rig::Frame> frame;
    estimation::Image<std::uint16_t> stored;  // where there is no frame
  };
  using SharedItem = std::shared_ptr<const Item>;
  // A repeat as it is judged, and the frame that it was compared with.
  struct Told {
    estimation::Repeat repeat;
    const Item* before = nullptr;
    const Item* after = nullptr;
  };

  void push(Use use, const CapturedFrame& frame);
  void push(SharedItem item);
  void wait_until_looked_at();
  void run();
  void look_at(const SharedItem& item);
  void keep_light(const Item& item);
  void keep_first(const SharedItem& item);
  void choose_bracket();
  std::vector<Told> tell_repeats();
  Told tell(const Item& repeat, bool is_first_light, const Item* other_half);
  bool is_first_light();
  const Item* shown_beside(const Item& item, bool is_light) const;
  const estimation::Result<estimation::FrameChange>& change(const Item& before, const Item& after);
  estimation::MotionReport judge(const std::vector<Told>& told,
                                 const estimation::MotionRules& rules) const;
  bool hardly_clips(const Item& item) const;
  // Calls `work` with the samples, which live as long as the call.
  template <typename Work>
  static void with_samples(const Item& item, const Work& work);

  const estimation::CameraInfo camera_;
  const estimation::Calibration calibration_;
  const estimation::Axis axis_;
  const estimation::MotionScale scale_;
  const double period_px_;  // of the pattern in the frame
  const std::vector<estimation::Pattern> patterns_;
  const estimation::BlockGrid grid_;
  const std::vector<int> brackets_;
  std::optional<rig::HostTime> last_arrival_;
  std::mutex mutex_;
  std::condition_variable looked_at_;
  std::size_t waiting_count_ = 0;  // guarded by mutex_
  // The watch thread's while frames wait, the session thread's while none do.
  std::map<int, SharedItem> firsts_;  // by bracket; the chosen one alone once it is
  std::optional<int> bracket_;        // that is compared
  rig::HostTime begun_;               // its first frame's edge
  std::vector<SharedItem> repeats_;  // in the order of showing; of all brackets until one is chosen
  std::map<std::pair<const Item*, const Item*>, estimation::Result<estimation::FrameChange>>
      changes_;
  std::map<std::pair<int, int>, estimation::SeenFrame> seen_;  // by pattern and bracket
  std::optional<rig::HostTime> first_seen_;
  BoundedQueue<SharedItem> queue_;
  std::jthread thread_;
};

}  // namespace capture
