// The projector's fullscreen window and the monitor below it.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "rig/clock.h"
#include "rig/devices/picture_book.h"
#include "rig/devices/projector_monitor.h"
#include "rig/devices/server_watch.h"
#include "rig/fault.h"
#include "rig/projector.h"

struct GLFWwindow;
struct _XDisplay;

namespace rig {

// Main thread. One at a time in a process: GLFW and Xlib have handlers of the process.
class ProjectorWindow {
 public:
  // As GlfwProjector::open(), which is this and its errors.
  static Result<std::unique_ptr<ProjectorWindow>> open(const ProjectorSettings& settings,
                                                       const std::stop_token& stop);
  ~ProjectorWindow();
  ProjectorWindow(const ProjectorWindow&) = delete;
  ProjectorWindow& operator=(const ProjectorWindow&) = delete;

  const ProjectorSettings& settings() const { return settings_; }
  const DisplayReport& report() const { return report_; }
  int picture_limit() const { return book_->limit(); }
  bool is_server_gone() const { return is_server_gone_; }
  // What became of it, for the operator.
  std::string server_loss() const;
  // Around whatever is done with the window for long: a server that stands still is then gone after
  // a while, of which answered() is the time since.
  ServerWatch::Talk talk() { return ServerWatch::Talk(*watch_); }
  void answered() { watch_->answered(); }

  Result<void> upload(const std::vector<estimation::Image<unsigned char>>& pictures);
  // When the picture began to be scanned out, by the driver or as the swap returned.
  HostTime show(const ShowRequest& request);
  HostTime show_black();
  void restore_gamma();

  // Whether the window still covers its monitor: no round trip to the server.
  bool covers_monitor() const;
  // What differs from how the display was opened; nullopt: nothing.
  std::optional<std::string> find_change() const;
  void hide();
  // Covers the monitor again, black, identity gamma. False while the display is not as it was.
  bool recover();

 private:
  explicit ProjectorWindow(const ProjectorSettings& settings) : settings_(settings) {}
  Result<void> create();
  Result<void> prepare_drawing();
  bool is_in_our_mode(const std::optional<MonitorMode>& mode) const;
  bool make_gamma_identity(GLFWmonitor* monitor);
  void measure_swaps(const std::stop_token& stop);
  HostTime swap();
  HostTime scan_out_time(HostTime before, HostTime after) const;

  // GLX_OML_sync_control's, whose types only the .cpp knows.
  using WaitForSbc = int (*)(_XDisplay*, unsigned long, std::int64_t, std::int64_t*, std::int64_t*,
                             std::int64_t*);

  ProjectorSettings settings_;
  DisplayReport report_;  // constant from open() on: other threads read it
  GLFWwindow* window_ = nullptr;
  MonitorMode mode_;  // of the monitor when it was opened
  std::optional<GammaRamp> original_gamma_;
  std::optional<PictureBook> book_;
  WaitForSbc wait_for_sbc_ = nullptr;         // where the driver has GLX_OML_sync_control
  std::atomic<bool> is_server_gone_ = false;  // set by Xlib, from whichever thread was talking
  std::optional<ServerWatch> watch_;          // from the window's creation on
};

}  // namespace rig
