#include "rig/devices/projector_monitor.h"

#include <X11/extensions/Xrandr.h>

#include <cmath>
#include <cstdlib>
#include <memory>
#include <span>

#define GLFW_INCLUDE_NONE
#define GLFW_EXPOSE_NATIVE_X11
#include <GLFW/glfw3.h>
#include <GLFW/glfw3native.h>

namespace rig {
namespace {

constexpr int kGammaTolerance = 256;  // of 65535: drivers write i * 256 or i * 257

// XRandR's objects, each freed by its own function.
template <auto free_it>
struct XrrFree {
  template <typename T>
  void operator()(T* object) const {
    free_it(object);
  }
};
using XrrResources = std::unique_ptr<XRRScreenResources, XrrFree<XRRFreeScreenResources>>;
using XrrCrtc = std::unique_ptr<XRRCrtcInfo, XrrFree<XRRFreeCrtcInfo>>;
using XrrGamma = std::unique_ptr<XRRCrtcGamma, XrrFree<XRRFreeGamma>>;

// As GLFW counts it.
int refresh_hz(const XRRScreenResources& resources, RRMode id) {
  for (const XRRModeInfo& mode :
       std::span(resources.modes, static_cast<std::size_t>(resources.nmode)))
    if (mode.id == id && mode.hTotal != 0 && mode.vTotal != 0)
      return static_cast<int>(std::lround(static_cast<double>(mode.dotClock) /
                                          (static_cast<double>(mode.hTotal) * mode.vTotal)));
  return 0;
}

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

std::optional<MonitorMode> read_mode(GLFWmonitor* monitor) {
  Display* const display = glfwGetX11Display();
  const XrrResources resources(XRRGetScreenResourcesCurrent(display, DefaultRootWindow(display)));
  if (!resources) return std::nullopt;
  const XrrCrtc crtc(XRRGetCrtcInfo(display, resources.get(), glfwGetX11Adapter(monitor)));
  if (!crtc || crtc->mode == None) return std::nullopt;
  return MonitorMode{.width_px = static_cast<int>(crtc->width),
                     .height_px = static_cast<int>(crtc->height),
                     .refresh_hz = refresh_hz(*resources, crtc->mode),
                     .x_px = crtc->x,
                     .y_px = crtc->y,
                     .rotation = crtc->rotation};
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
  const XrrGamma ramp(XRRGetCrtcGamma(glfwGetX11Display(), glfwGetX11Adapter(monitor)));
  if (!ramp || ramp->size < 2) return std::nullopt;
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
