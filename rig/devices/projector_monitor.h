// A monitor and its gamma ramp, as GLFW sees them. From the main thread, between glfwInit() and
// glfwTerminate().
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

struct GLFWmonitor;

namespace rig {

// nullptr if none has this name.
GLFWmonitor* find_monitor(const std::string& name);

// Their names and sizes in one line for the operator.
std::string monitors_text();

std::string size_text(int width_px, int height_px);

// What a monitor shows of the desktop, and how.
struct MonitorMode {
  int width_px = 0, height_px = 0, refresh_hz = 0;  // refresh: 0 where it does not say
  int x_px = 0, y_px = 0;
  unsigned short rotation = 0;  // and reflection, as XRandR has them
};

// nullopt: it shows nothing, or the server is gone. GLFW would crash in the latter case, as with
// the gamma ramp.
std::optional<MonitorMode> read_mode(GLFWmonitor* monitor);

struct GammaRamp {
  std::vector<unsigned short> red, green, blue;

  bool is_identity() const;
};

// nullopt where the driver tells none.
std::optional<GammaRamp> read_gamma(GLFWmonitor* monitor);
void write_gamma(GLFWmonitor* monitor, GammaRamp ramp);
GammaRamp identity_gamma(std::size_t size);

}  // namespace rig
