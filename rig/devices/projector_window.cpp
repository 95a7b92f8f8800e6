#include "rig/devices/projector_window.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <utility>

#include "rig/devices/swap_timing.h"

// epoxy before GLFW, which must not bring its own GL headers.
#include <epoxy/gl.h>
#include <epoxy/glx.h>
#define GLFW_INCLUDE_NONE
#define GLFW_EXPOSE_NATIVE_X11
#define GLFW_EXPOSE_NATIVE_GLX
#include <GLFW/glfw3.h>
#include <GLFW/glfw3native.h>

namespace rig {
namespace {

constexpr const char* kServerGone = "the X server went away; start it and ssrig again";
constexpr int kWarmUpSwaps = 5;  // first frames compile shaders and fault pages in

// Xlib's own handler ends the process, without destructors, when a request meets a monitor that
// has just gone.
int log_x_error(Display* display, XErrorEvent* error) {
  std::array<char, 128> text{};
  XGetErrorText(display, error->error_code, text.data(), static_cast<int>(text.size()));
  std::fprintf(stderr, "ssrig: projector: X error %s in request %d.%d\n", text.data(),
               error->request_code, error->minor_code);
  return 0;
}

// Xlib's own ends the process, before the display's exit handler is asked, which tells the window.
int ignore_lost_server(Display*) { return 0; }

std::string glfw_error_text() {
  const char* text = nullptr;
  glfwGetError(&text);
  return text != nullptr ? text : "no reason given";
}

}  // namespace

Result<std::unique_ptr<ProjectorWindow>> ProjectorWindow::open(const ProjectorSettings& settings,
                                                               const std::stop_token& stop) {
  // Whoever lost his server could not end GLFW, and it cannot be used again.
  if (glfwGetX11Display() != nullptr) return failure(Fault::kDeviceLost, kServerGone);
  XSetErrorHandler(log_x_error);
  if (glfwInit() != GLFW_TRUE)
    return failure(Fault::kNotFound,
                   "the X server cannot be reached (" + glfw_error_text() +
                       "); start it, and set DISPLAY to it (and XAUTHORITY if it is another "
                       "user's)");
  std::unique_ptr<ProjectorWindow> window(new ProjectorWindow(settings));
  if (const Result<void> created = window->create(); !created)
    return tl::unexpected(created.error());
  const ServerWatch::Talk talk = window->talk();
  const Result<void> prepared = window->prepare_drawing();
  if (window->is_server_gone()) return failure(Fault::kDeviceLost, window->server_loss());
  if (!prepared) return tl::unexpected(prepared.error());
  window->report_.is_gamma_identity = window->make_gamma_identity(find_monitor(settings.monitor));
  window->measure_swaps(stop);
  if (window->is_server_gone()) return failure(Fault::kDeviceLost, window->server_loss());
  return window;
}

Result<void> ProjectorWindow::create() {
  GLFWmonitor* monitor = find_monitor(settings_.monitor);
  if (monitor == nullptr)
    return failure(Fault::kNotFound,
                   "no monitor is named \"" + settings_.monitor +
                       "\"; there are: " + monitors_text() +
                       "; correct the rig file's monitor, or switch the projector on");
  const std::optional<MonitorMode> mode = read_mode(monitor);
  if (!mode || mode->width_px != settings_.width_px || mode->height_px != settings_.height_px)
    return failure(
        Fault::kConfiguration,
        "monitor " + settings_.monitor + " shows " +
            (mode ? size_text(mode->width_px, mode->height_px) : std::string("nothing")) +
            " px, the rig file says " + size_text(settings_.width_px, settings_.height_px) +
            "; set the monitor's mode (xrandr) or the rig file's size");
  mode_ = *mode;

  glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
  glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 3);
  glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
  glfwWindowHint(GLFW_AUTO_ICONIFY, GLFW_FALSE);  // the operator works on the other monitor
  glfwWindowHint(GLFW_FOCUS_ON_SHOW, GLFW_FALSE);
  // Without the present rate GLFW picks the highest of that size, which is a mode switch.
  glfwWindowHint(GLFW_REFRESH_RATE, mode_.refresh_hz > 0 ? mode_.refresh_hz : GLFW_DONT_CARE);
  window_ = glfwCreateWindow(settings_.width_px, settings_.height_px, "ssrig projector", monitor,
                             nullptr);
  if (window_ == nullptr)
    return failure(Fault::kUnsupported, "no OpenGL 3.3 window on monitor " + settings_.monitor +
                                            ": " + glfw_error_text());
  XSetErrorHandler(log_x_error);  // GLFW 3.3 leaves Xlib's own behind
  XSetIOErrorHandler(ignore_lost_server);
  // The display's owner is told, instead of the process being ended, when the server dies.
  XSetIOErrorExitHandler(
      glfwGetX11Display(),
      [](Display*, void* is_gone) { static_cast<std::atomic<bool>*>(is_gone)->store(true); },
      &is_server_gone_);
  watch_.emplace(ConnectionNumber(glfwGetX11Display()), settings_.server_deadline);
  glfwSetInputMode(window_, GLFW_CURSOR, GLFW_CURSOR_HIDDEN);
  return {};
}

Result<void> ProjectorWindow::prepare_drawing() {
  glfwMakeContextCurrent(window_);
  glfwSwapInterval(1);
  int width_px = 0;
  int height_px = 0;
  glfwGetFramebufferSize(window_, &width_px, &height_px);
  if (width_px != settings_.width_px || height_px != settings_.height_px)
    return failure(Fault::kConfiguration, "the window on monitor " + settings_.monitor +
                                              " became " + size_text(width_px, height_px) +
                                              " px; turn off scaling on the projector's monitor");
  const Result<PictureBook> book = PictureBook::create(settings_);
  if (!book) return tl::unexpected(book.error());
  book_.emplace(*book);
  if (glfwExtensionSupported("GLX_OML_sync_control") == GLFW_TRUE)
    wait_for_sbc_ = reinterpret_cast<WaitForSbc>(glfwGetProcAddress("glXWaitForSbcOML"));
  report_.monitor = settings_.monitor;
  report_.width_px = width_px;
  report_.height_px = height_px;
  report_.nominal_refresh_hz = mode_.refresh_hz;
  if (const GLubyte* renderer = glGetString(GL_RENDERER); renderer != nullptr)
    report_.renderer = reinterpret_cast<const char*>(renderer);
  return {};
}

ProjectorWindow::~ProjectorWindow() {
  if (is_server_gone_) return;  // GLFW would talk to it; the process is about to end
  std::optional<ServerWatch::Talk> talk;
  if (watch_) talk.emplace(*watch_);
  if (window_ != nullptr) glfwDestroyWindow(window_);
  glfwTerminate();
}

std::string ProjectorWindow::server_loss() const {
  if (!watch_ || !watch_->has_ended_connection()) return kServerGone;
  return "the X server did not answer for " +
         std::to_string(
             std::chrono::duration_cast<std::chrono::seconds>(settings_.server_deadline).count()) +
         " s: it or the graphics driver stands still; start it and ssrig again";
}

// False where the ramp cannot be read or does not take.
bool ProjectorWindow::make_gamma_identity(GLFWmonitor* monitor) {
  std::optional<GammaRamp> ramp = read_gamma(monitor);
  if (ramp && !ramp->is_identity()) {
    if (!original_gamma_) original_gamma_ = ramp;
    write_gamma(monitor, identity_gamma(ramp->red.size()));
    ramp = read_gamma(monitor);
  }
  return ramp && ramp->is_identity();
}

void ProjectorWindow::restore_gamma() {
  GLFWmonitor* monitor = find_monitor(settings_.monitor);
  if (monitor != nullptr && original_gamma_) write_gamma(monitor, *original_gamma_);
}

void ProjectorWindow::measure_swaps(const std::stop_token& stop) {
  const int count = std::max(settings_.timing_check_intervals, 50);
  std::vector<double> intervals_ms;
  HostTime last = show_black();
  for (int i = 0; i < kWarmUpSwaps + count; ++i) {
    if (stop.stop_requested()) return;
    watch_->answered();
    book_->draw_black();
    glfwSwapBuffers(window_);
    glFinish();
    const HostTime now = HostClock::now();
    if (i >= kWarmUpSwaps)
      intervals_ms.push_back(std::chrono::duration<double, std::milli>(now - last).count());
    last = now;
  }
  judge_swaps(std::move(intervals_ms), report_);
  report_.text = describe(report_);
}

Result<void> ProjectorWindow::upload(
    const std::vector<estimation::Image<unsigned char>>& pictures) {
  return book_->upload(pictures);
}

HostTime ProjectorWindow::show(const ShowRequest& request) {
  book_->draw(request);
  return swap();
}

HostTime ProjectorWindow::show_black() {
  book_->draw_black();
  return swap();
}

HostTime ProjectorWindow::swap() {
  const HostTime before = HostClock::now();
  glfwSwapBuffers(window_);
  glFinish();  // else the driver may queue frames ahead and return at once
  watch_->answered();
  return scan_out_time(before, HostClock::now());
}

// The driver's own time of the swap where it has a believable one, else when the swap returned.
HostTime ProjectorWindow::scan_out_time(HostTime before, HostTime after) const {
  std::int64_t time_us = 0;
  std::int64_t frame = 0;
  std::int64_t swap_count = 0;
  if (wait_for_sbc_ == nullptr || is_server_gone_ ||
      wait_for_sbc_(glfwGetX11Display(), glfwGetGLXWindow(window_), 0, &time_us, &frame,
                    &swap_count) != True)
    return after;
  const HostTime reported{std::chrono::microseconds(time_us)};
  return reported >= before && reported <= after ? reported : after;
}

bool ProjectorWindow::covers_monitor() const { return glfwGetWindowMonitor(window_) != nullptr; }

void ProjectorWindow::hide() { glfwHideWindow(window_); }

bool ProjectorWindow::is_in_our_mode(const std::optional<MonitorMode>& mode) const {
  return mode && mode->width_px == settings_.width_px && mode->height_px == settings_.height_px &&
         mode->refresh_hz == mode_.refresh_hz && mode->rotation == mode_.rotation;
}

std::optional<std::string> ProjectorWindow::find_change() const {
  GLFWmonitor* monitor = find_monitor(settings_.monitor);
  if (monitor == nullptr) return "monitor " + settings_.monitor + " is gone; plug it in again";
  if (!covers_monitor()) return "the window lost monitor " + settings_.monitor;
  const std::optional<MonitorMode> mode = read_mode(monitor);
  if (!is_in_our_mode(mode))
    return "the mode of monitor " + settings_.monitor + " changed" +
           (mode ? " to " + size_text(mode->width_px, mode->height_px) + " px at " +
                       std::to_string(mode->refresh_hz) + " Hz" +
                       (mode->rotation == mode_.rotation ? "" : ", turned or mirrored")
                 : std::string()) +
           "; set it to " + size_text(settings_.width_px, settings_.height_px) + " px at " +
           std::to_string(mode_.refresh_hz) + " Hz, as it was";
  if (mode->x_px != mode_.x_px || mode->y_px != mode_.y_px)
    return "monitor " + settings_.monitor + " was moved on the desktop; move it back";
  if (!report_.is_gamma_identity) return std::nullopt;  // it never was: the report says so
  const std::optional<GammaRamp> ramp = read_gamma(monitor);
  if (!ramp || !ramp->is_identity())
    return "the gamma ramp of monitor " + settings_.monitor +
           " was changed by another program; turn off night light and colour profiles";
  return std::nullopt;
}

bool ProjectorWindow::recover() {
  GLFWmonitor* monitor = find_monitor(settings_.monitor);
  if (monitor == nullptr) return false;
  const std::optional<MonitorMode> mode = read_mode(monitor);
  if (!is_in_our_mode(mode)) return false;
  mode_ = *mode;  // wherever on the desktop it was plugged in again
  glfwShowWindow(window_);
  glfwSetWindowMonitor(window_, monitor, 0, 0, settings_.width_px, settings_.height_px,
                       mode_.refresh_hz > 0 ? mode_.refresh_hz : GLFW_DONT_CARE);
  make_gamma_identity(monitor);
  show_black();
  return !find_change();
}

}  // namespace rig
