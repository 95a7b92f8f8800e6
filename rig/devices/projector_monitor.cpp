#include "rig/devices/projector_monitor.h"

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <cstdlib>

namespace rig {
namespace {

constexpr int kGammaTolerance = 256;  // of 65535: drivers write i * 256 or i * 257

std::vector<GLFWmonitor*> monitors() {
  int count = 0;
  GLFWmonitor** first = glfwGetMonitors(&count);
  return {first, first + count};
}

}  // namespace

std::string size_text(int width_px, int height_px) {
  return std::to_string(width_px) + " x " + std::to_string(height_px);
}

GLFWmonitor* find_monitor(const std::string& name) {
  for (GLFWmonitor* monitor : monitors())
    if (name == glfwGetMonitorName(monitor)) return monitor;
  return nullptr;
}

std::string monitors_text() {
  std::string list;
  for (GLFWmonitor* monitor : monitors()) {
    const GLFWvidmode* mode = glfwGetVideoMode(monitor);
    list += (list.empty() ? "" : ", ") + std::string(glfwGetMonitorName(monitor));
    if (mode != nullptr) list += " (" + size_text(mode->width, mode->height) + ")";
  }
  return list.empty() ? "none" : list;
}

bool GammaRamp::is_identity() const {
  const auto is_line = [](const std::vector<unsigned short>& ramp) {
    const int last = static_cast<int>(ramp.size()) - 1;
    for (int i = 0; i <= last; ++i)
      if (std::abs(ramp[static_cast<std::size_t>(i)] - 65535 * i / last) > kGammaTolerance)
        return false;
    return last > 0;
  };
  return is_line(red) && is_line(green) && is_line(blue);
}

std::optional<GammaRamp> read_gamma(GLFWmonitor* monitor) {
  const GLFWgammaramp* ramp = glfwGetGammaRamp(monitor);
  if (ramp == nullptr || ramp->size < 2) return std::nullopt;
  return GammaRamp{{ramp->red, ramp->red + ramp->size},
                   {ramp->green, ramp->green + ramp->size},
                   {ramp->blue, ramp->blue + ramp->size}};
}

void write_gamma(GLFWmonitor* monitor, GammaRamp ramp) {
  const GLFWgammaramp view{ramp.red.data(), ramp.green.data(), ramp.blue.data(),
                           static_cast<unsigned>(ramp.red.size())};
  glfwSetGammaRamp(monitor, &view);
}

GammaRamp identity_gamma(std::size_t size) {
  std::vector<unsigned short> line(size);
  for (std::size_t i = 0; i < size; ++i)
    line[i] = static_cast<unsigned short>(65535 * i / (size - 1));
  return {line, line, line};
}

}  // namespace rig
