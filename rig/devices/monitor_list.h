// Which monitors there are, without opening a window on one.
#pragma once

#include <string>
#include <vector>

#include "rig/fault.h"

namespace rig {

struct Monitor {
  std::string name;  // of the connector, "HDMI-1"
  int width_px = 0;  // of its present mode
  int height_px = 0;
  int refresh_hz = 0;  // 0 where it does not say
};

// As GlfwProjector sees them. From the main thread, before a projector is opened. Errors: kNotFound
// if the X server cannot be reached.
Result<std::vector<Monitor>> list_monitors();

}  // namespace rig
