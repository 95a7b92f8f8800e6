#include "rig/devices/monitor_list.h"

#include <GLFW/glfw3.h>

namespace rig {

Result<std::vector<Monitor>> list_monitors() {
  if (glfwInit() != GLFW_TRUE) {
    const char* cause = nullptr;
    glfwGetError(&cause);
    return failure(Fault::kNotFound,
                   std::string("the X server cannot be reached (")
                       .append(cause == nullptr ? "no reason given" : cause)
                       .append("); start it, and set DISPLAY to it (and XAUTHORITY if it is "
                               "another user's)"));
  }
  std::vector<Monitor> monitors;
  int count = 0;
  GLFWmonitor** first = glfwGetMonitors(&count);
  for (int i = 0; i < count; ++i) {
    Monitor monitor{.name = glfwGetMonitorName(first[i])};
    if (const GLFWvidmode* mode = glfwGetVideoMode(first[i])) {
      monitor.width_px = mode->width;
      monitor.height_px = mode->height;
      monitor.refresh_hz = mode->refreshRate;
    }
    monitors.push_back(std::move(monitor));
  }
  glfwTerminate();
  return monitors;
}

}  // namespace rig
