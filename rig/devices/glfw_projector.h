// The projector as a second monitor: a fullscreen GLFW window that draws pictures from a texture
// array, with the sync square over them.
#pragma once

#include <memory>
#include <stop_token>
#include <vector>

#include "rig/event.h"
#include "rig/projector.h"

namespace rig {

class ProjectorRequests;
class ProjectorWindow;

// Threads: open(), run() and the destructor on the main thread (GLFW's rule); load(), show() and
// report() on any. One at a time in a process. The sink outlives it.
//
//   open() ─► Ready ──monitor gone, mode or gamma changed: DeviceFault──► Changed
//               ▲                                                            │
//               └───────── monitor as it was, gamma identity again ──────────┘
//   run() ended, or the X server went away ─► Closed
// Changed and Closed are black, and load() and show() are refused with kDisplayChanged. What had
// been asked but not yet shown when the state changed is dropped; the DeviceFault answers for it.
class GlfwProjector final : public Projector {
 public:
  // A black window on the monitor of that name, in the mode it is in; the gamma ramp made identity;
  // the swap intervals measured, which takes about a second. An unsynchronised display is in the
  // report, not an error. `stop` ends the measuring; then the report says nothing of it. Errors:
  // kNotFound (no X server; no such monitor), kConfiguration (other size), kUnsupported (no OpenGL
  // 3.3).
  static Result<std::unique_ptr<GlfwProjector>> open(const ProjectorSettings& settings,
                                                     EventSink& sink,
                                                     const std::stop_token& stop = {});
  ~GlfwProjector() override;

  // Draws what is asked until `stop`; then shows black, restores the gamma ramp and refuses
  // further requests. Once. Errors: kDeviceLost if the X server went away, or did not answer for
  // settings' server_deadline.
  Result<void> run(const std::stop_token& stop);

  // Thread-safe. Is the display as it was opened? Errors: kDisplayChanged, with what to put right.
  Result<void> check() const;

  DisplayReport report() const override;
  Result<void> load(std::vector<estimation::Image<unsigned char>> pictures) override;
  Result<void> show(const ShowRequest& request) override;

 private:
  GlfwProjector(std::unique_ptr<ProjectorWindow> window, EventSink& sink);
  void serve_requests(const std::stop_token& stop);
  void watch_display();

  EventSink& sink_;
  std::unique_ptr<ProjectorRequests> requests_;  // what is asked; thread-safe
  std::unique_ptr<ProjectorWindow> window_;      // what is drawn, where; main thread
};

}  // namespace rig
