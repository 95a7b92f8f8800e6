// What tests of a projector share: plain pictures, and waiting for the answer to a show().
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <optional>
#include <variant>
#include <vector>

#include "estimation/base/image.h"
#include "rig/event.h"
#include "rig/projector.h"

namespace rig::contract {

// Generous: it bounds a failure, not a success.
inline constexpr auto kEventPatience = std::chrono::seconds(20);

inline std::vector<estimation::Image<unsigned char>> plain_pictures(
    const ProjectorSettings& settings, int count) {
  std::vector<estimation::Image<unsigned char>> pictures;
  pictures.reserve(static_cast<std::size_t>(count));
  for (int i = 0; i < count; ++i)
    pictures.emplace_back(settings.height_px, settings.width_px, 1,
                          static_cast<unsigned char>(10 * (i + 1)));
  return pictures;
}

// The next event, which must be a PictureShown.
inline std::optional<PictureShown> wait_for_shown(EventSource& events) {
  const std::optional<Event> event = events.wait(events.now() + kEventPatience, {});
  if (!event) {
    ADD_FAILURE() << "no event came";
    return std::nullopt;
  }
  if (const auto* fault = std::get_if<DeviceFault>(&*event))
    ADD_FAILURE() << "fault: " << fault->error.detail;
  const auto* shown = std::get_if<PictureShown>(&*event);
  return shown != nullptr ? std::optional(*shown) : std::nullopt;
}

}  // namespace rig::contract
