// What other threads ask of the projector's window.
#pragma once

#include <deque>
#include <mutex>
#include <string>
#include <variant>
#include <vector>

#include "estimation/base/image.h"
#include "rig/fault.h"
#include "rig/projector.h"

namespace rig {

// Thread-safe. States as in glfw_projector.h.
class ProjectorRequests {
 public:
  struct Load {
    std::vector<estimation::Image<unsigned char>> pictures;
  };
  using Request = std::variant<std::monostate, Load, ShowRequest>;  // monostate: none
  enum class State { kReady, kChanged, kClosed };

  ProjectorRequests(const ProjectorSettings& settings, int picture_limit)
      : width_px_(settings.width_px), height_px_(settings.height_px), limit_(picture_limit) {}

  // In the order they came. Errors: kOutOfRange for a picture of another size or one that is not
  // loaded; kDisplayChanged unless ready.
  Result<void> add(Load load);
  Result<void> add(const ShowRequest& show);
  Request take();

  // Errors: kDisplayChanged unless ready, with the reason.
  Result<void> check() const;
  State state() const;
  // Drops what was not yet shown.
  void enter(State state, std::string reason);

 private:
  Result<void> check_pictures(const std::vector<estimation::Image<unsigned char>>& pictures) const;
  Result<void> check_state() const;  // mutex_ is held

  const int width_px_, height_px_, limit_;
  mutable std::mutex mutex_;
  State state_ = State::kReady;   // guarded by mutex_
  std::string reason_;            // guarded by mutex_; why not ready
  int picture_count_ = 0;         // guarded by mutex_; of the newest load
  std::deque<Request> requests_;  // guarded by mutex_
};

}  // namespace rig
