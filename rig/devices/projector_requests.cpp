#include "rig/devices/projector_requests.h"

#include <utility>

#include "rig/devices/projector_monitor.h"

namespace rig {

Result<void> ProjectorRequests::add(Load load) {
  if (Result<void> checked = check_pictures(load.pictures); !checked) return checked;
  const std::lock_guard lock(mutex_);
  if (Result<void> accepting = check_state(); !accepting) return accepting;
  picture_count_ = static_cast<int>(load.pictures.size());
  requests_.emplace_back(std::move(load));
  return {};
}

Result<void> ProjectorRequests::add(const ShowRequest& show) {
  const std::lock_guard lock(mutex_);
  if (Result<void> accepting = check_state(); !accepting) return accepting;
  if (show.picture < kBlackPicture || show.picture >= picture_count_)
    return failure(Fault::kOutOfRange, "picture " + std::to_string(show.picture) +
                                           " is not loaded; there are " +
                                           std::to_string(picture_count_));
  requests_.emplace_back(show);
  return {};
}

ProjectorRequests::Request ProjectorRequests::take() {
  const std::lock_guard lock(mutex_);
  if (requests_.empty()) return {};
  Request request = std::move(requests_.front());
  requests_.pop_front();
  return request;
}

Result<void> ProjectorRequests::check() const {
  const std::lock_guard lock(mutex_);
  return check_state();
}

ProjectorRequests::State ProjectorRequests::state() const {
  const std::lock_guard lock(mutex_);
  return state_;
}

void ProjectorRequests::enter(State state, std::string reason) {
  const std::lock_guard lock(mutex_);
  state_ = state;
  reason_ = std::move(reason);
  requests_.clear();
}

Result<void> ProjectorRequests::check_pictures(
    const std::vector<estimation::Image<unsigned char>>& pictures) const {
  if (static_cast<int>(pictures.size()) > limit_)
    return failure(Fault::kOutOfRange, std::to_string(pictures.size()) +
                                           " pictures, the graphics card holds " +
                                           std::to_string(limit_));
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const estimation::Image<unsigned char>& picture = pictures[i];
    if (picture.width_px() != width_px_ || picture.height_px() != height_px_ ||
        picture.channel_count() != 1)
      return failure(Fault::kOutOfRange, "picture " + std::to_string(i) + " is " +
                                             size_text(picture.width_px(), picture.height_px()) +
                                             " px with " + std::to_string(picture.channel_count()) +
                                             " channels, the monitor shows " +
                                             size_text(width_px_, height_px_) + " of one");
  }
  return {};
}

Result<void> ProjectorRequests::check_state() const {
  if (state_ == State::kReady) return {};
  return failure(Fault::kDisplayChanged, reason_);
}

}  // namespace rig
