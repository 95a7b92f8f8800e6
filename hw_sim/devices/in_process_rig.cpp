#include "hw_sim/devices/in_process_rig.h"

#include <utility>

namespace hw_sim {

InProcessRig::InProcessRig(const World& world, InProcessOptions options)
    : world_(world),
      options_(std::move(options)),
      camera_(options_.camera, options_.camera_timing, options_.faults, timeline_, world_, light_),
      trigger_(options_.trigger, options_.faults, timeline_,
               [this](const LinePulse& pulse) { camera_.pulse(pulse); }),
      projector_(options_.projector, options_.display_timing, options_.faults, timeline_,
                 [this](const std::shared_ptr<const Picture>& picture, bool is_square_light) {
                   light(picture, is_square_light);
                 }) {}

void InProcessRig::light(const std::shared_ptr<const Picture>& picture, bool is_square_light) {
  light_.show(timeline_.now(), picture);
  world_.prepare(picture);
  trigger_.square(is_square_light);
}

std::shared_ptr<const Picture> InProcessRig::picture_now() const {
  const auto segments =
      light_.between(timeline_.now(), timeline_.now() + std::chrono::nanoseconds(1));
  return segments.empty() ? nullptr : segments.front().picture;
}

}  // namespace hw_sim
