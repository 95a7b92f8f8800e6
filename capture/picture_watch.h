// Looks at every frame of a capture for whether it shows its pattern, by how all of them fit each
// other (estimation/motion/picture_identity.h): beside the evidence by time, and independent of it.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <map>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "capture/bounded_queue.h"
#include "capture/captured_frame.h"
#include "estimation/motion/picture_identity.h"
#include "estimation/motion/picture_samples.h"
#include "estimation/session/manifest.h"

namespace capture {

// Calls come from the session thread; frames are looked at on a thread of its own, which keeps some
// thousand samples of each and lets the frame go.
class PictureWatch {
 public:
  // At most `frame_count` frames wait at a time: as many as a run has, and add() does not block.
  PictureWatch(const estimation::Manifest& manifest, std::size_t frame_count);
  ~PictureWatch();
  PictureWatch(const PictureWatch&) = delete;
  PictureWatch& operator=(const PictureWatch&) = delete;

  // Of a session that is gone on with, before any frame.
  void know(std::vector<estimation::SeenPicture> pictures);
  // `frame.slot` is the session's. A later frame of a slot takes the place of an earlier one.
  void add(const CapturedFrame& frame);
  // A repeat of `frame.slot`: what was shown before some other frame.
  void add_repeat(const CapturedFrame& frame);

  // Waits for the frames on their way, then judges all there are. As often as more have come.
  estimation::PictureCheck judge();

 private:
  struct Item {
    CapturedFrame frame;
    bool is_of_session = true;
  };
  void push(Item item);
  void run();
  void keep(estimation::SeenPicture picture);

  const estimation::CameraInfo camera_;
  const std::vector<estimation::Pattern> patterns_;
  const estimation::PictureSampler sampler_;
  std::mutex mutex_;
  std::condition_variable seen_;
  std::size_t waiting_count_ = 0;                                 // guarded by mutex_, as all below
  std::map<std::pair<int, int>, estimation::SeenPicture> slots_;  // by pattern and bracket
  std::vector<estimation::SeenPicture> repeats_;
  BoundedQueue<Item> queue_;
  std::jthread thread_;
};

}  // namespace capture
