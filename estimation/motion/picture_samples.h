// A frame at some thousand places, each time the same: what tells its picture from another.
#pragma once

#include <cstdint>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/manifest.h"

namespace estimation {

class PictureSampler {
 public:
  explicit PictureSampler(const CameraInfo& camera);
  // DN as in the frame, of one colour; at most 32768. `frame_dn` has the camera's size.
  std::vector<std::uint16_t> take(ImageView<const std::uint16_t> frame_dn) const;

 private:
  struct Place {
    int row = 0, col = 0;
  };
  std::vector<Place> places_;
  int channel_ = 0;
};

}  // namespace estimation
