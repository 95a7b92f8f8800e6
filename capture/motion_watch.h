// Compares the repeats of a pattern with its first showing while the capture goes on, and looks at
// every frame for what changes the light for a moment.
#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "capture/bounded_queue.h"
#include "capture/captured_frame.h"
#include "estimation/base/image.h"
#include "estimation/motion/motion_verdict.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"

namespace capture {

// Calls come from the session thread; frames are compared on a thread of its own. Of the brackets
// it takes the longest in which hardly anything clips. The queue has room for every frame: add does
// not block.
class MotionWatch {
 public:
  // `manifest` describes camera, projector and calibration, and has the pattern that is repeated.
  // `frame_count`: at most so many frames come, first showings and repeats together.
  MotionWatch(const estimation::Manifest& manifest, int pattern, std::size_t bracket_count,
              std::size_t frame_count, bool is_shuffled);
  ~MotionWatch();
  MotionWatch(const MotionWatch&) = delete;
  MotionWatch& operator=(const MotionWatch&) = delete;

  // A frame of the first showing: just taken, or read back from the disk.
  void add_first(const CapturedFrame& frame);
  void add_first(int bracket, rig::HostTime edge, estimation::Image<std::uint16_t> dn);
  // A repeat that was compared before, ahead of all others; before any frame.
  void know(estimation::Repeat repeat);
  // A frame of any of the session's patterns, `frame.slot`.
  void add_any(const CapturedFrame& frame);
  // A frame of a repeat; `repeat` is its number from 1 on, whatever the order.
  void add_repeat(int repeat, const CapturedFrame& frame);

  // Waits for the frames on their way, then judges. Once. Repeats whose frames did not come, and
  // all if the first showing's did not, are not judged.
  estimation::MotionReport finish();
  // When the latest of the frames that were added arrived; none: nullopt.
  std::optional<rig::HostTime> last_arrival() const { return last_arrival_; }
  // The same with the head's motion in mm by the surface that was found, where that tells it.
  // After finish(); on the calling thread.
  estimation::MotionReport finish_by(const estimation::Maps& maps);

 private:
  enum class Use { kFirst, kRepeat, kAny };
  struct Item {
    Use use = Use::kFirst;
    int number = 0;  // of a repeat; kAny: of the pattern
    int bracket = 0;
    rig::HostTime edge;
    std::shared_ptr<const rig::Frame> frame;
    estimation::Image<std::uint16_t> stored;  // where there is no frame
  };
  void push(Use use, int number, const CapturedFrame& frame);
  void run();
  void look_at(const Item& item);
  void choose_bracket();
  void compare(int repeat, const Item& item);
  estimation::MotionReport judge() const;
  bool hardly_clips(const Item& item) const;
  // Calls `work` with the samples, which live as long as the call.
  template <typename Work>
  static void with_samples(const Item& item, const Work& work);

  const estimation::CameraInfo camera_;
  const estimation::Calibration calibration_;
  const estimation::Axis axis_;
  const estimation::MotionScale scale_;
  const double period_px_;  // of the pattern in the frame
  const estimation::MotionRules rules_;
  const std::vector<estimation::Pattern> patterns_;
  const estimation::BlockGrid grid_;
  const std::size_t bracket_count_;
  std::vector<estimation::Repeat> known_;
  std::optional<rig::HostTime> last_arrival_;
  // The watch thread's until it has ended.
  std::map<int, std::shared_ptr<const Item>> firsts_;  // by bracket
  std::optional<int> bracket_;                         // that is compared
  std::vector<std::shared_ptr<const Item>> waiting_;   // repeats, for the first showing
  std::map<int, estimation::Repeat> repeats_;
  std::map<int, std::shared_ptr<const Item>> compared_;  // their frames
  std::vector<estimation::SeenFrame> seen_;              // of all patterns
  std::optional<rig::HostTime> first_seen_;
  std::vector<estimation::BriefChange> brief_changes_;  // once it has ended
  BoundedQueue<std::shared_ptr<const Item>> queue_;
  std::jthread thread_;
};

}  // namespace capture
