#include "rig/devices/glfw_projector.h"

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <chrono>
#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "rig/devices/projector_requests.h"
#include "rig/devices/projector_window.h"

namespace rig {
namespace {

constexpr auto kWatchPeriod = std::chrono::milliseconds(250);  // gamma changes send no X event
constexpr double kEventWait_s = 0.1;  // bounds what a lost wake-up can cost

}  // namespace

Result<std::unique_ptr<GlfwProjector>> GlfwProjector::open(const ProjectorSettings& settings,
                                                           EventSink& sink,
                                                           const std::stop_token& stop) {
  Result<std::unique_ptr<ProjectorWindow>> window = ProjectorWindow::open(settings, stop);
  if (!window) return tl::unexpected(window.error());
  return std::unique_ptr<GlfwProjector>(new GlfwProjector(std::move(*window), sink));
}

GlfwProjector::GlfwProjector(std::unique_ptr<ProjectorWindow> window, EventSink& sink)
    : sink_(sink),
      requests_(std::make_unique<ProjectorRequests>(window->settings(), window->picture_limit())),
      window_(std::move(window)) {}

GlfwProjector::~GlfwProjector() = default;

DisplayReport GlfwProjector::report() const { return window_->report(); }

Result<void> GlfwProjector::load(std::vector<estimation::Image<unsigned char>> pictures) {
  Result<void> added = requests_->add(ProjectorRequests::Load{std::move(pictures)});
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
  const ServerWatch::Talk talk = window_->talk();
  while (!stop.stop_requested() && !window_->is_server_gone()) {
    serve_requests(stop);
    const HostTime now = HostClock::now();
    if (now >= next_watch || !window_->covers_monitor()) {
      watch_display();
      next_watch = now + kWatchPeriod;
    }
    glfwWaitEventsTimeout(kEventWait_s);
    window_->answered();
  }
  requests_->enter(ProjectorRequests::State::kClosed, window_->is_server_gone()
                                                          ? window_->server_loss()
                                                          : "the projector's window is closed");
  if (window_->is_server_gone()) {
    const Error lost{Fault::kDeviceLost, window_->server_loss()};
    sink_.post(DeviceFault{Device::kProjector, lost});
    return tl::unexpected(lost);
  }
  window_->show_black();
  window_->restore_gamma();
  return {};
}

void GlfwProjector::serve_requests(const std::stop_token& stop) {
  while (!stop.stop_requested() && window_->covers_monitor() && !window_->is_server_gone()) {
    const ProjectorRequests::Request request = requests_->take();
    if (std::holds_alternative<std::monostate>(request)) return;
    if (const auto* show = std::get_if<ShowRequest>(&request)) {
      watch_display();  // the frames of the picture before hang on it
      if (requests_->state() == ProjectorRequests::State::kChanged) return;
      const HostTime swapped = window_->show(*show);
      if (!window_->is_server_gone()) sink_.post(PictureShown{show->show_id, swapped});
    } else {
      const Result<void> loaded =
          window_->upload(std::get<ProjectorRequests::Load>(request).pictures);
      if (!loaded) sink_.post(DeviceFault{Device::kProjector, loaded.error()});
      window_->show_black();
    }
    glfwPollEvents();
  }
}

void GlfwProjector::watch_display() {
  if (requests_->state() == ProjectorRequests::State::kChanged) {
    if (window_->recover()) requests_->enter(ProjectorRequests::State::kReady, "");
    return;
  }
  const std::optional<std::string> change = window_->find_change();
  if (!change || window_->is_server_gone()) return;
  requests_->enter(ProjectorRequests::State::kChanged, *change);
  if (window_->covers_monitor())
    window_->show_black();
  else
    window_->hide();  // GLFW left it somewhere on the desktop
  sink_.post(DeviceFault{Device::kProjector, Error{Fault::kDisplayChanged, *change}});
}

}  // namespace rig
