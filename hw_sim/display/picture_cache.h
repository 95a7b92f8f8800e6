// Grabs of the screen as Pictures: the same content is the same Picture, so that a world computes
// the light of a pattern once.
#pragma once

#include <cstdint>
#include <deque>
#include <memory>

#include "hw_sim/light.h"

namespace hw_sim {

// Not thread-safe.
class PictureCache {
 public:
  explicit PictureCache(std::size_t limit) : limit_(limit) {}

  // The picture of this brightness; a new one with the next id if it is not among the `limit`
  // latest. Shared with the light time line and with exposures that outlive both.
  std::shared_ptr<const Picture> find(estimation::Image<unsigned char> brightness);

 private:
  struct Entry {
    std::uint64_t hash = 0;
    std::shared_ptr<const Picture> picture;
  };
  std::size_t limit_;
  std::uint64_t last_id_ = 0;
  std::deque<Entry> entries_;  // latest use at the back
};

}  // namespace hw_sim
