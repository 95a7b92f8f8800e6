#include "rig/devices/glfw_projector.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <deque>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <variant>

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

constexpr int kWarmUpSwaps = 5;                // first frames compile shaders and fault pages in
constexpr double kPeriodTolerance_frac = 0.1;  // Psychtoolbox' limit for measured against nominal
constexpr auto kWatchPeriod = std::chrono::milliseconds(250);  // gamma changes send no X event
constexpr double kEventWait_s = 0.1;  // bounds what a lost wake-up can cost
constexpr int kGammaTolerance = 256;  // of 65535: drivers write i * 256 or i * 257

// Xlib's own handler ends the process, without destructors, when a request meets a monitor that
// has just gone.
int log_x_error(Display* display, XErrorEvent* error) {
  std::array<char, 128> text{};
  XGetErrorText(display, error->error_code, text.data(), static_cast<int>(text.size()));
  std::fprintf(stderr, "ssrig: projector: X error %s in request %d.%d\n", text.data(),
               error->request_code, error->minor_code);
  return 0;
}

constexpr const char* kServerGone = "the X server went away; start it and ssrig again";

// Xlib's own ends the process, before the display's exit handler is asked, which tells the window.
int ignore_lost_server(Display*) { return 0; }

std::string glfw_error_text() {
  const char* text = nullptr;
  glfwGetError(&text);
  return text != nullptr ? text : "no reason given";
}

std::string size_text(int width_px, int height_px) {
  return std::to_string(width_px) + " x " + std::to_string(height_px);
}

std::string fixed(double value, int decimals) {
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), "%.*f", decimals, value);
  return text.data();
}

std::vector<GLFWmonitor*> monitors() {
  int count = 0;
  GLFWmonitor** first = glfwGetMonitors(&count);
  return {first, first + count};
}

GLFWmonitor* find_monitor(const std::string& name) {
  for (GLFWmonitor* monitor : monitors())
    if (name == glfwGetMonitorName(monitor)) return monitor;
  return nullptr;
}

std::string list_monitors() {
  std::string list;
  for (GLFWmonitor* monitor : monitors()) {
    const GLFWvidmode* mode = glfwGetVideoMode(monitor);
    list += (list.empty() ? "" : ", ") + std::string(glfwGetMonitorName(monitor));
    if (mode != nullptr) list += " (" + size_text(mode->width, mode->height) + ")";
  }
  return list.empty() ? "none" : list;
}

// A gamma ramp that outlives GLFW's own copy.
struct GammaRamp {
  std::vector<unsigned short> red, green, blue;

  bool is_identity() const {
    const auto is_line = [](const std::vector<unsigned short>& ramp) {
      const int last = static_cast<int>(ramp.size()) - 1;
      for (int i = 0; i <= last; ++i)
        if (std::abs(ramp[static_cast<std::size_t>(i)] - 65535 * i / last) > kGammaTolerance)
          return false;
      return last > 0;
    };
    return is_line(red) && is_line(green) && is_line(blue);
  }
};

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

// Where the sync square lies, [left, right) x [top, bottom).
struct SquarePlace {
  int left_px = 0, top_px = 0, right_px = 0, bottom_px = 0;
};

SquarePlace place_square(const ProjectorSettings& settings) {
  const SyncSquareSettings& square = settings.sync_square;
  const bool is_right = square.corner == Corner::kTopRight || square.corner == Corner::kBottomRight;
  const bool is_bottom =
      square.corner == Corner::kBottomLeft || square.corner == Corner::kBottomRight;
  const int left_px = is_right ? settings.width_px - square.size_px : 0;
  const int top_px = is_bottom ? settings.height_px - square.size_px : 0;
  return {left_px, top_px, left_px + square.size_px, top_px + square.size_px};
}

constexpr const char* kVertexShader = R"(#version 330 core
void main() {  // one triangle over the whole window
  vec2 corner = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
  gl_Position = vec4(corner * 2.0 - 1.0, 0.0, 1.0);
})";

// Integers until the last line, so that the bytes on the screen are those of the picture.
constexpr const char* kFragmentShader = R"(#version 330 core
uniform usampler2DArray pictures;
uniform int layer;          // -1: black
uniform ivec4 square;       // left, top, right, bottom
uniform uint square_level;  // 0..255
uniform int height_px;
out vec4 color;
void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  pixel.y = height_px - 1 - pixel.y;  // picture row 0 is at the top
  uint level = layer < 0 ? 0u : texelFetch(pictures, ivec3(pixel, layer), 0).r;
  if (all(greaterThanEqual(pixel, square.xy)) && all(lessThan(pixel, square.zw)))
    level = square_level;
  color = vec4(vec3(float(level) / 255.0), 1.0);
})";

Result<GLuint> compile(GLenum kind, const char* source) {
  const GLuint shader = glCreateShader(kind);
  glShaderSource(shader, 1, &source, nullptr);
  glCompileShader(shader);
  GLint is_compiled = GL_FALSE;
  glGetShaderiv(shader, GL_COMPILE_STATUS, &is_compiled);
  if (is_compiled == GL_TRUE) return shader;
  std::array<char, 1024> log{};
  glGetShaderInfoLog(shader, static_cast<GLsizei>(log.size()), nullptr, log.data());
  return failure(Fault::kUnsupported,
                 "the graphics driver refuses our shader: " + std::string(log.data()));
}

// The pictures on the graphics card and the program that draws them. Everything goes with its GL
// context.
class PictureBook {
 public:
  static Result<PictureBook> create(const ProjectorSettings& settings) {
    const Result<GLuint> vertex = compile(GL_VERTEX_SHADER, kVertexShader);
    if (!vertex) return tl::unexpected(vertex.error());
    const Result<GLuint> fragment = compile(GL_FRAGMENT_SHADER, kFragmentShader);
    if (!fragment) return tl::unexpected(fragment.error());
    return PictureBook(settings, *vertex, *fragment);
  }

  int limit() const { return limit_; }

  Result<void> upload(const std::vector<estimation::Image<unsigned char>>& pictures) {
    const auto count = static_cast<GLsizei>(pictures.size());
    if (count == 0) return {};
    while (glGetError() != GL_NO_ERROR) continue;  // older errors are not this upload's
    glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, GL_R8UI, width_px_, height_px_, count, 0, GL_RED_INTEGER,
                 GL_UNSIGNED_BYTE, nullptr);
    for (GLsizei i = 0; i < count; ++i)
      glTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, 0, 0, i, width_px_, height_px_, 1, GL_RED_INTEGER,
                      GL_UNSIGNED_BYTE, pictures[static_cast<std::size_t>(i)].samples().data());
    glFinish();
    if (glGetError() == GL_NO_ERROR) return {};
    return failure(Fault::kOutOfRange, "the graphics card has no room for " +
                                           std::to_string(count) + " pictures of " +
                                           size_text(width_px_, height_px_) + " px");
  }

  void draw(const ShowRequest& request) {
    const bool is_white = request.is_square_light != is_inverted_;
    glUniform4i(square_uniform_, square_.left_px, square_.top_px, square_.right_px,
                square_.bottom_px);
    glUniform1ui(square_level_uniform_, is_white ? 255U : 0U);
    draw_layer(request.picture);
  }

  // All dark, the square too.
  void draw_black() {
    glUniform4i(square_uniform_, 0, 0, 0, 0);
    draw_layer(kBlackPicture);
  }

 private:
  PictureBook(const ProjectorSettings& settings, GLuint vertex_shader, GLuint fragment_shader)
      : width_px_(settings.width_px),
        height_px_(settings.height_px),
        is_inverted_(settings.sync_square.is_inverted),
        square_(place_square(settings)) {
    const GLuint program = glCreateProgram();
    glAttachShader(program, vertex_shader);
    glAttachShader(program, fragment_shader);
    glLinkProgram(program);
    glUseProgram(program);
    square_uniform_ = glGetUniformLocation(program, "square");
    square_level_uniform_ = glGetUniformLocation(program, "square_level");
    layer_uniform_ = glGetUniformLocation(program, "layer");
    glUniform1i(glGetUniformLocation(program, "height_px"), height_px_);

    GLuint vertices = 0;
    glGenVertexArrays(1, &vertices);  // a core profile draws nothing without one
    glBindVertexArray(vertices);
    GLuint texture = 0;
    glGenTextures(1, &texture);
    glBindTexture(GL_TEXTURE_2D_ARRAY, texture);
    glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
    glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
    glDisable(GL_DITHER);
    glDisable(GL_FRAMEBUFFER_SRGB);
    glViewport(0, 0, width_px_, height_px_);
    glGetIntegerv(GL_MAX_ARRAY_TEXTURE_LAYERS, &limit_);
  }

  void draw_layer(int layer) {
    glUniform1i(layer_uniform_, layer);
    glDrawArrays(GL_TRIANGLES, 0, 3);
  }

  int width_px_, height_px_;
  bool is_inverted_;
  SquarePlace square_;
  GLint square_uniform_ = -1, square_level_uniform_ = -1, layer_uniform_ = -1;
  GLint limit_ = 0;
};

struct IntervalStatistics {
  double median_ms = 0, sd_ms = 0, max_ms = 0;
};

IntervalStatistics summarise(std::vector<double> intervals_ms) {
  std::sort(intervals_ms.begin(), intervals_ms.end());
  double sum_ms = 0;
  for (const double interval_ms : intervals_ms) sum_ms += interval_ms;
  const double mean_ms = sum_ms / static_cast<double>(intervals_ms.size());
  double sum_of_squares = 0;
  for (const double interval_ms : intervals_ms)
    sum_of_squares += (interval_ms - mean_ms) * (interval_ms - mean_ms);
  return {intervals_ms[intervals_ms.size() / 2],
          std::sqrt(sum_of_squares / static_cast<double>(intervals_ms.size())),
          intervals_ms.back()};
}

// The median, because a busy computer stretches some intervals of a synchronised display too.
// A monitor that does not tell its rate counts as synchronised if the swaps keep time at a rate
// that a monitor can have.
bool intervals_are_of_monitor(const IntervalStatistics& measured, double nominal_hz) {
  if (nominal_hz > 0)
    return std::abs(measured.median_ms * nominal_hz / 1000.0 - 1.0) < kPeriodTolerance_frac;
  return measured.median_ms > 1000.0 / 250.0 && measured.median_ms < 1000.0 / 20.0 &&
         measured.sd_ms < kPeriodTolerance_frac * measured.median_ms;
}

std::string describe(const DisplayReport& report) {
  const std::string nominal = report.nominal_refresh_hz > 0
                                  ? fixed(report.nominal_refresh_hz, 0) + " Hz nominal"
                                  : "nominal rate unknown";
  return "monitor " + report.monitor + ", " + size_text(report.width_px, report.height_px) +
         " px, " + (report.is_vsynced ? "synchronised" : "not synchronised: swaps") + " at " +
         fixed(report.measured_refresh_hz, 2) + " Hz (" + nominal + "; interval sd " +
         fixed(report.interval_sd_ms, 2) + " ms, longest " + fixed(report.interval_max_ms, 1) +
         " ms)" +
         (report.is_vsynced ? "" : "; turn vertical sync on in the driver and the compositor off") +
         ", gamma ramp " +
         (report.is_gamma_identity ? "identity" : "not identity and cannot be set") + ", " +
         report.renderer;
}

}  // namespace

// The fullscreen window and the monitor below it.
class GlfwProjector::Window {
 public:
  static Result<std::unique_ptr<Window>> open(const ProjectorSettings& settings,
                                              const std::stop_token& stop);
  ~Window();
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  const ProjectorSettings& settings() const { return settings_; }
  const DisplayReport& report() const { return report_; }
  int picture_limit() const { return book_->limit(); }
  bool is_server_gone() const { return is_server_gone_; }

  Result<void> upload(const std::vector<estimation::Image<unsigned char>>& pictures) {
    return book_->upload(pictures);
  }
  HostTime show(const ShowRequest& request);
  HostTime show_black();
  void restore_gamma();

  // Whether the window still covers its monitor: no round trip to the server.
  bool covers_monitor() const { return glfwGetWindowMonitor(window_) != nullptr; }
  // What differs from how the display was opened; nullopt: nothing.
  std::optional<std::string> find_change() const;
  void hide() { glfwHideWindow(window_); }
  // Covers the monitor again, black, identity gamma. False while the display is not as it was.
  bool recover();

 private:
  explicit Window(const ProjectorSettings& settings) : settings_(settings) {}
  Result<void> create();
  Result<void> prepare_drawing();
  bool make_gamma_identity(GLFWmonitor* monitor);
  void measure_swaps(const std::stop_token& stop);
  HostTime swap();
  HostTime scan_out_time(HostTime before, HostTime after) const;

  using WaitForSbc = Bool (*)(Display*, GLXDrawable, std::int64_t, std::int64_t*, std::int64_t*,
                              std::int64_t*);

  ProjectorSettings settings_;
  DisplayReport report_;  // constant from open() on: other threads read it
  GLFWwindow* window_ = nullptr;
  int x_px_ = 0, y_px_ = 0, refresh_hz_ = 0;  // of the monitor when it was opened
  std::optional<GammaRamp> original_gamma_;
  std::optional<PictureBook> book_;
  WaitForSbc wait_for_sbc_ = nullptr;         // where the driver has GLX_OML_sync_control
  std::atomic<bool> is_server_gone_ = false;  // set by Xlib, from whichever thread was talking
};

Result<std::unique_ptr<GlfwProjector::Window>> GlfwProjector::Window::open(
    const ProjectorSettings& settings, const std::stop_token& stop) {
  // Whoever lost his server could not end GLFW, and it cannot be used again.
  if (glfwGetX11Display() != nullptr) return failure(Fault::kDeviceLost, kServerGone);
  XSetErrorHandler(log_x_error);
  if (glfwInit() != GLFW_TRUE)
    return failure(Fault::kNotFound,
                   "the X server cannot be reached (" + glfw_error_text() +
                       "); start it, and set DISPLAY to it (and XAUTHORITY if it is another "
                       "user's)");
  std::unique_ptr<Window> window(new Window(settings));
  if (const Result<void> created = window->create(); !created)
    return tl::unexpected(created.error());
  if (const Result<void> prepared = window->prepare_drawing(); !prepared)
    return tl::unexpected(prepared.error());
  window->report_.is_gamma_identity = window->make_gamma_identity(find_monitor(settings.monitor));
  window->measure_swaps(stop);
  if (window->is_server_gone()) return failure(Fault::kDeviceLost, kServerGone);
  return window;
}

Result<void> GlfwProjector::Window::create() {
  GLFWmonitor* monitor = find_monitor(settings_.monitor);
  if (monitor == nullptr)
    return failure(Fault::kNotFound,
                   "no monitor is named \"" + settings_.monitor +
                       "\"; there are: " + list_monitors() +
                       "; correct the rig file's monitor, or switch the projector on");
  const GLFWvidmode* mode = glfwGetVideoMode(monitor);
  if (mode == nullptr || mode->width != settings_.width_px || mode->height != settings_.height_px)
    return failure(
        Fault::kConfiguration,
        "monitor " + settings_.monitor + " shows " +
            (mode == nullptr ? std::string("nothing") : size_text(mode->width, mode->height)) +
            " px, the rig file says " + size_text(settings_.width_px, settings_.height_px) +
            "; set the monitor's mode (xrandr) or the rig file's size");
  refresh_hz_ = mode->refreshRate;
  glfwGetMonitorPos(monitor, &x_px_, &y_px_);

  glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
  glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 3);
  glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
  glfwWindowHint(GLFW_AUTO_ICONIFY, GLFW_FALSE);  // the operator works on the other monitor
  glfwWindowHint(GLFW_FOCUS_ON_SHOW, GLFW_FALSE);
  // Without the present rate GLFW picks the highest of that size, which is a mode switch.
  glfwWindowHint(GLFW_REFRESH_RATE, refresh_hz_ > 0 ? refresh_hz_ : GLFW_DONT_CARE);
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
  glfwSetInputMode(window_, GLFW_CURSOR, GLFW_CURSOR_HIDDEN);
  return {};
}

Result<void> GlfwProjector::Window::prepare_drawing() {
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
  report_.nominal_refresh_hz = refresh_hz_;
  if (const GLubyte* renderer = glGetString(GL_RENDERER); renderer != nullptr)
    report_.renderer = reinterpret_cast<const char*>(renderer);
  return {};
}

GlfwProjector::Window::~Window() {
  if (is_server_gone_) return;  // GLFW would talk to it; the process is about to end
  if (window_ != nullptr) glfwDestroyWindow(window_);
  glfwTerminate();
}

// False where the ramp cannot be read or does not take.
bool GlfwProjector::Window::make_gamma_identity(GLFWmonitor* monitor) {
  std::optional<GammaRamp> ramp = read_gamma(monitor);
  if (ramp && !ramp->is_identity()) {
    if (!original_gamma_) original_gamma_ = ramp;
    write_gamma(monitor, identity_gamma(ramp->red.size()));
    ramp = read_gamma(monitor);
  }
  return ramp && ramp->is_identity();
}

void GlfwProjector::Window::restore_gamma() {
  GLFWmonitor* monitor = find_monitor(settings_.monitor);
  if (monitor != nullptr && original_gamma_) write_gamma(monitor, *original_gamma_);
}

void GlfwProjector::Window::measure_swaps(const std::stop_token& stop) {
  const int count = std::max(settings_.timing_check_intervals, 50);
  std::vector<double> intervals_ms;
  HostTime last = show_black();
  for (int i = 0; i < kWarmUpSwaps + count; ++i) {
    if (stop.stop_requested()) return;
    book_->draw_black();
    glfwSwapBuffers(window_);
    glFinish();
    const HostTime now = HostClock::now();
    if (i >= kWarmUpSwaps)
      intervals_ms.push_back(std::chrono::duration<double, std::milli>(now - last).count());
    last = now;
  }
  const IntervalStatistics measured = summarise(std::move(intervals_ms));
  report_.measured_refresh_hz = 1000.0 / std::max(measured.median_ms, 1e-3);
  report_.interval_sd_ms = measured.sd_ms;
  report_.interval_max_ms = measured.max_ms;
  report_.is_vsynced = intervals_are_of_monitor(measured, report_.nominal_refresh_hz);
  report_.text = describe(report_);
}

HostTime GlfwProjector::Window::show(const ShowRequest& request) {
  book_->draw(request);
  return swap();
}

HostTime GlfwProjector::Window::show_black() {
  book_->draw_black();
  return swap();
}

HostTime GlfwProjector::Window::swap() {
  const HostTime before = HostClock::now();
  glfwSwapBuffers(window_);
  glFinish();  // else the driver may queue frames ahead and return at once
  return scan_out_time(before, HostClock::now());
}

// The driver's own time of the swap where it has a believable one, else when the swap returned.
HostTime GlfwProjector::Window::scan_out_time(HostTime before, HostTime after) const {
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

std::optional<std::string> GlfwProjector::Window::find_change() const {
  GLFWmonitor* monitor = find_monitor(settings_.monitor);
  if (monitor == nullptr) return "monitor " + settings_.monitor + " is gone; plug it in again";
  if (!covers_monitor()) return "the window lost monitor " + settings_.monitor;
  const GLFWvidmode* mode = glfwGetVideoMode(monitor);
  if (mode == nullptr || mode->width != settings_.width_px || mode->height != settings_.height_px ||
      mode->refreshRate != refresh_hz_)
    return "the mode of monitor " + settings_.monitor + " changed" +
           (mode == nullptr ? std::string()
                            : " to " + size_text(mode->width, mode->height) + " px at " +
                                  std::to_string(mode->refreshRate) + " Hz") +
           "; set it to " + size_text(settings_.width_px, settings_.height_px) + " px at " +
           std::to_string(refresh_hz_) + " Hz";
  int x_px = 0;
  int y_px = 0;
  glfwGetMonitorPos(monitor, &x_px, &y_px);
  if (x_px != x_px_ || y_px != y_px_)
    return "monitor " + settings_.monitor + " was moved on the desktop; move it back";
  if (!report_.is_gamma_identity) return std::nullopt;  // it never was: the report says so
  const std::optional<GammaRamp> ramp = read_gamma(monitor);
  if (!ramp || !ramp->is_identity())
    return "the gamma ramp of monitor " + settings_.monitor +
           " was changed by another program; turn off night light and colour profiles";
  return std::nullopt;
}

bool GlfwProjector::Window::recover() {
  GLFWmonitor* monitor = find_monitor(settings_.monitor);
  if (monitor == nullptr) return false;
  const GLFWvidmode* mode = glfwGetVideoMode(monitor);
  if (mode == nullptr || mode->width != settings_.width_px || mode->height != settings_.height_px ||
      mode->refreshRate != refresh_hz_)
    return false;
  glfwGetMonitorPos(monitor, &x_px_, &y_px_);  // wherever it was plugged in again
  glfwShowWindow(window_);
  glfwSetWindowMonitor(window_, monitor, 0, 0, settings_.width_px, settings_.height_px,
                       refresh_hz_ > 0 ? refresh_hz_ : GLFW_DONT_CARE);
  make_gamma_identity(monitor);
  show_black();
  return !find_change();
}

// What other threads ask of the window.
class GlfwProjector::Requests {
 public:
  struct Load {
    std::vector<estimation::Image<unsigned char>> pictures;
  };
  using Request = std::variant<std::monostate, Load, ShowRequest>;  // monostate: none
  enum class State { kReady, kChanged, kClosed };

  Requests(const ProjectorSettings& settings, int picture_limit)
      : width_px_(settings.width_px), height_px_(settings.height_px), limit_(picture_limit) {}

  Result<void> add(Load load) {
    if (Result<void> checked = check_pictures(load.pictures); !checked) return checked;
    const std::lock_guard lock(mutex_);
    if (Result<void> accepting = check_state(); !accepting) return accepting;
    picture_count_ = static_cast<int>(load.pictures.size());
    requests_.emplace_back(std::move(load));
    return {};
  }

  Result<void> add(const ShowRequest& show) {
    const std::lock_guard lock(mutex_);
    if (Result<void> accepting = check_state(); !accepting) return accepting;
    if (show.picture < kBlackPicture || show.picture >= picture_count_)
      return failure(Fault::kOutOfRange, "picture " + std::to_string(show.picture) +
                                             " is not loaded; there are " +
                                             std::to_string(picture_count_));
    requests_.emplace_back(show);
    return {};
  }

  Request take() {
    const std::lock_guard lock(mutex_);
    if (requests_.empty()) return {};
    Request request = std::move(requests_.front());
    requests_.pop_front();
    return request;
  }

  Result<void> check() const {
    const std::lock_guard lock(mutex_);
    return check_state();
  }

  State state() const {
    const std::lock_guard lock(mutex_);
    return state_;
  }

  // Drops what was not yet shown.
  void enter(State state, std::string reason) {
    const std::lock_guard lock(mutex_);
    state_ = state;
    reason_ = std::move(reason);
    requests_.clear();
  }

 private:
  Result<void> check_pictures(const std::vector<estimation::Image<unsigned char>>& pictures) const {
    if (static_cast<int>(pictures.size()) > limit_)
      return failure(Fault::kOutOfRange, std::to_string(pictures.size()) +
                                             " pictures, the graphics card holds " +
                                             std::to_string(limit_));
    for (std::size_t i = 0; i < pictures.size(); ++i) {
      const estimation::Image<unsigned char>& picture = pictures[i];
      if (picture.width_px() != width_px_ || picture.height_px() != height_px_ ||
          picture.channel_count() != 1)
        return failure(Fault::kOutOfRange, "picture " + std::to_string(i) + " is " +
                                               size_text(picture.width_px(), picture.height_px()) +
                                               " px with " +
                                               std::to_string(picture.channel_count()) +
                                               " channels, the monitor shows " +
                                               size_text(width_px_, height_px_) + " of one");
    }
    return {};
  }

  Result<void> check_state() const {  // mutex_ is held
    if (state_ == State::kReady) return {};
    return failure(Fault::kDisplayChanged, reason_);
  }

  const int width_px_, height_px_, limit_;
  mutable std::mutex mutex_;
  State state_ = State::kReady;   // guarded by mutex_
  std::string reason_;            // guarded by mutex_; why not ready
  int picture_count_ = 0;         // guarded by mutex_; of the newest load
  std::deque<Request> requests_;  // guarded by mutex_
};

Result<std::unique_ptr<GlfwProjector>> GlfwProjector::open(const ProjectorSettings& settings,
                                                           EventSink& sink,
                                                           const std::stop_token& stop) {
  Result<std::unique_ptr<Window>> window = Window::open(settings, stop);
  if (!window) return tl::unexpected(window.error());
  return std::unique_ptr<GlfwProjector>(new GlfwProjector(std::move(*window), sink));
}

GlfwProjector::GlfwProjector(std::unique_ptr<Window> window, EventSink& sink)
    : sink_(sink),
      requests_(std::make_unique<Requests>(window->settings(), window->picture_limit())),
      window_(std::move(window)) {}

GlfwProjector::~GlfwProjector() = default;

DisplayReport GlfwProjector::report() const { return window_->report(); }

Result<void> GlfwProjector::load(std::vector<estimation::Image<unsigned char>> pictures) {
  Result<void> added = requests_->add(Requests::Load{std::move(pictures)});
  if (added) glfwPostEmptyEvent();
  return added;
}

Result<void> GlfwProjector::show(const ShowRequest& request) {
  Result<void> added = requests_->add(request);
  if (added) glfwPostEmptyEvent();
  return added;
}

Result<void> GlfwProjector::check() const { return requests_->check(); }

Result<void> GlfwProjector::run(const std::stop_token& stop) {
  const std::stop_callback wake(stop, [] { glfwPostEmptyEvent(); });
  HostTime next_watch = HostClock::now() + kWatchPeriod;
  while (!stop.stop_requested() && !window_->is_server_gone()) {
    serve_requests(stop);
    const HostTime now = HostClock::now();
    if (now >= next_watch || !window_->covers_monitor()) {
      watch_display();
      next_watch = now + kWatchPeriod;
    }
    glfwWaitEventsTimeout(kEventWait_s);
  }
  requests_->enter(Requests::State::kClosed,
                   window_->is_server_gone() ? kServerGone : "the projector's window is closed");
  if (window_->is_server_gone()) {
    const Error lost{Fault::kDeviceLost, kServerGone};
    sink_.post(DeviceFault{Device::kProjector, lost});
    return tl::unexpected(lost);
  }
  window_->show_black();
  window_->restore_gamma();
  return {};
}

void GlfwProjector::serve_requests(const std::stop_token& stop) {
  while (!stop.stop_requested() && window_->covers_monitor() && !window_->is_server_gone()) {
    const Requests::Request request = requests_->take();
    if (std::holds_alternative<std::monostate>(request)) return;
    if (const auto* show = std::get_if<ShowRequest>(&request)) {
      watch_display();  // the frames of the picture before hang on it
      if (requests_->state() == Requests::State::kChanged) return;
      const HostTime swapped = window_->show(*show);
      if (!window_->is_server_gone()) sink_.post(PictureShown{show->show_id, swapped});
    } else {
      const Result<void> loaded = window_->upload(std::get<Requests::Load>(request).pictures);
      if (!loaded) sink_.post(DeviceFault{Device::kProjector, loaded.error()});
      window_->show_black();
    }
    glfwPollEvents();
  }
}

void GlfwProjector::watch_display() {
  if (requests_->state() == Requests::State::kChanged) {
    if (window_->recover()) requests_->enter(Requests::State::kReady, "");
    return;
  }
  const std::optional<std::string> change = window_->find_change();
  if (!change || window_->is_server_gone()) return;
  requests_->enter(Requests::State::kChanged, *change);
  if (window_->covers_monitor())
    window_->show_black();
  else
    window_->hide();  // GLFW left it somewhere on the desktop
  sink_.post(DeviceFault{Device::kProjector, Error{Fault::kDisplayChanged, *change}});
}

}  // namespace rig
