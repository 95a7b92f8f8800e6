#include "capture/picture_watch.h"

#include <chrono>

namespace capture {

PictureWatch::PictureWatch(const estimation::Manifest& manifest, std::size_t frame_count)
    : camera_(manifest.camera),
      patterns_(manifest.patterns),
      sampler_(manifest.camera),
      queue_(frame_count),
      thread_([this] { run(); }) {}

PictureWatch::~PictureWatch() { queue_.close(); }

void PictureWatch::know(std::vector<estimation::SeenPicture> pictures) {
  const std::lock_guard lock(mutex_);
  for (estimation::SeenPicture& picture : pictures) keep(std::move(picture));
}

void PictureWatch::add(const CapturedFrame& frame) { push({frame, true}); }
void PictureWatch::add_repeat(const CapturedFrame& frame) { push({frame, false}); }

void PictureWatch::push(Item item) {
  {
    const std::lock_guard lock(mutex_);
    ++waiting_count_;
  }
  queue_.push(std::move(item));
}

void PictureWatch::run() {
  while (auto item = queue_.pop()) {
    const CapturedFrame& frame = item->frame;
    estimation::SeenPicture picture{
        frame.slot.pattern, frame.slot.bracket,
        std::chrono::duration<double>(frame.evidence.edge.time_since_epoch()).count(),
        item->is_of_session, sampler_.take(FrameSamples(*frame.frame).view())};
    item.reset();  // the buffer goes back to the camera
    {
      const std::lock_guard lock(mutex_);
      keep(std::move(picture));
      --waiting_count_;
    }
    seen_.notify_all();
  }
}

// mutex_ is held.
void PictureWatch::keep(estimation::SeenPicture picture) {
  if (!picture.is_of_session) return repeats_.push_back(std::move(picture));
  const std::pair slot(picture.pattern, picture.bracket);
  slots_.insert_or_assign(slot, std::move(picture));
}

estimation::PictureCheck PictureWatch::judge() {
  std::unique_lock lock(mutex_);
  seen_.wait(lock, [this] { return waiting_count_ == 0; });
  std::vector<estimation::SeenPicture> pictures = repeats_;
  for (const auto& [slot, picture] : slots_) pictures.push_back(picture);
  lock.unlock();
  return check_pictures(camera_, patterns_, pictures);
}

}  // namespace capture
