#include "hw_sim/display/screen_grabber.h"

#include <X11/Xutil.h>
#include <X11/extensions/XShm.h>
#include <X11/extensions/Xdamage.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/ipc.h>
#include <sys/shm.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <deque>
#include <mutex>
#include <optional>
#include <utility>

#include "hw_sim/display/picture_cache.h"
#include "hw_sim/display/scanout_clock.h"
#include "hw_sim/display/x_connection.h"

namespace hw_sim {
namespace {

using std::chrono::milliseconds;

constexpr auto kGammaPeriod = milliseconds(100);  // a new ramp sends no X event
// Of an X server that stands still; what is known of its light is then all there is.
constexpr auto kServerPatience = std::chrono::seconds(1);
// A plan of 88 patterns and its retakes; beyond that a pattern's light is computed anew.
constexpr std::size_t kPictureLimit = 256;

// A monitor that goes away between a question and its answer is an X error, and Xlib's own handler
// would end the process. The answer's absence is handled where it was asked for.
int ignore_x_error(Display*, XErrorEvent*) { return 0; }

// The same for a server that went away: the display's exit handler is told.
int ignore_lost_server(Display*) { return 0; }

struct Rectangle {
  int x_px = 0, y_px = 0, width_px = 0, height_px = 0;
  bool operator==(const Rectangle&) const = default;
};

// An XImage in memory shared with the X server.
class SharedImage {
 public:
  SharedImage(Display* display, int width_px, int height_px) : display_(display) {
    const int screen = DefaultScreen(display);
    image_ = XShmCreateImage(display, DefaultVisual(display, screen),
                             static_cast<unsigned>(DefaultDepth(display, screen)), ZPixmap, nullptr,
                             &segment_, static_cast<unsigned>(width_px),
                             static_cast<unsigned>(height_px));
    const auto size =
        static_cast<std::size_t>(image_->bytes_per_line) * static_cast<std::size_t>(image_->height);
    segment_.shmid = shmget(IPC_PRIVATE, size, IPC_CREAT | 0600);
    image_->data = segment_.shmaddr = static_cast<char*>(shmat(segment_.shmid, nullptr, 0));
    segment_.readOnly = False;
    XShmAttach(display, &segment_);
    XSync(display, False);
    shmctl(segment_.shmid, IPC_RMID, nullptr);  // goes with its last user, even if we crash
  }
  ~SharedImage() {
    if (display_ != nullptr) XShmDetach(display_, &segment_);
    shmdt(segment_.shmaddr);
    image_->data = nullptr;
    XDestroyImage(image_);
  }
  SharedImage(const SharedImage&) = delete;
  SharedImage& operator=(const SharedImage&) = delete;

  void forget_server() { display_ = nullptr; }  // it is gone: Xlib would wait for it
  int width_px() const { return image_->width; }
  int height_px() const { return image_->height; }
  bool fill(int x_px, int y_px) {
    return XShmGetImage(display_, DefaultRootWindow(display_), image_, x_px, y_px, AllPlanes) != 0;
  }
  const std::uint32_t* row(int row) const {  // 0xRRGGBB
    return reinterpret_cast<const std::uint32_t*>(image_->data +
                                                  std::ptrdiff_t{row} * image_->bytes_per_line);
  }

 private:
  Display* display_;
  XShmSegmentInfo segment_{};
  XImage* image_ = nullptr;
};

// Output level of each of the 256 framebuffer levels, by channel.
struct GammaTable {
  std::array<std::array<unsigned char, 256>, 3> level{};
  bool operator==(const GammaTable&) const = default;
};

GammaTable make_table(const XRRCrtcGamma& ramp) {
  GammaTable table;
  const std::array<const unsigned short*, 3> channels{ramp.red, ramp.green, ramp.blue};
  for (std::size_t channel = 0; channel < 3; ++channel)
    for (std::size_t i = 0; i < 256; ++i)
      table.level[channel][i] = static_cast<unsigned char>(
          channels[channel][i * static_cast<std::size_t>(ramp.size - 1) / 255] >> 8);
  return table;
}

Rectangle place_square(const rig::SyncSquareSettings& square, int width_px, int height_px) {
  const bool is_right =
      square.corner == rig::Corner::kTopRight || square.corner == rig::Corner::kBottomRight;
  const bool is_bottom =
      square.corner == rig::Corner::kBottomLeft || square.corner == rig::Corner::kBottomRight;
  const int size_px = std::min({square.size_px, width_px, height_px});
  return {is_right ? width_px - size_px : 0, is_bottom ? height_px - size_px : 0, size_px, size_px};
}

// 0..1; the square is left black.
double take_square(estimation::Image<unsigned char>& brightness, const Rectangle& square) {
  std::int64_t sum = 0;
  for (int row = square.y_px; row < square.y_px + square.height_px; ++row) {
    unsigned char* const first = &brightness.at(row, square.x_px);
    for (int col = 0; col < square.width_px; ++col) sum += first[col];
    std::fill_n(first, square.width_px, static_cast<unsigned char>(0));
  }
  const std::int64_t count = std::int64_t{square.width_px} * square.height_px;
  return count > 0 ? static_cast<double>(sum) / (255.0 * static_cast<double>(count)) : 0;
}

estimation::Image<unsigned char> apply_gamma(const SharedImage& image, const GammaTable& gamma) {
  estimation::Image<unsigned char> brightness(image.height_px(), image.width_px());
  const auto& [red, green, blue] = gamma.level;
  for (int row = 0; row < image.height_px(); ++row) {
    const std::uint32_t* in = image.row(row);
    unsigned char* out = &brightness.at(row, 0);
    for (int col = 0; col < image.width_px(); ++col) {
      const std::uint32_t pixel = in[col];
      out[col] = static_cast<unsigned char>(
          (red[(pixel >> 16) & 255] + green[(pixel >> 8) & 255] + blue[pixel & 255] + 1) / 3);
    }
  }
  return brightness;
}

}  // namespace

// All of it but the thread. Everything after connect() happens on that thread.
class ScreenGrabber::Eye {
 public:
  Eye(const GrabberSettings& settings, LightTimeline& light, PictureCallback on_picture,
      LevelCallback on_level)
      : settings_(settings),
        light_(light),
        on_picture_(std::move(on_picture)),
        on_level_(std::move(on_level)),
        clock_(settings.refresh_hz),
        photodiode_(settings.photodiode),
        wake_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}
  ~Eye() {
    if (is_server_gone_ && image_) image_->forget_server();
    image_.reset();
    if (is_server_gone_) static_cast<void>(display_.release());  // closing would talk to it
    display_.reset();
    close(wake_);
  }

  rig::Result<void> connect();
  void run(const std::stop_token& stop);
  void wake() { eventfd_write(wake_, 1); }
  void see_until(rig::HostTime until);  // from any thread but ours
  void stick_photodiode(bool is_stuck) {
    is_stuck_ = is_stuck;
    is_photodiode_meddled_with_ = true;
    wake();
  }
  void dim_photodiode(double level_frac) {
    level_frac_ = level_frac;
    is_photodiode_meddled_with_ = true;
    wake();
  }

 private:
  void wait_for_news(const std::stop_token& stop);
  bool has_news() const;
  void look_at_screen();
  void read_events();
  rig::HostTime drawn_at(Time server_time_ms) const;
  bool is_ours(const XRectangle& drawn) const;  // not on another monitor alone
  void change(rig::HostTime when);
  void locate_output();
  bool read_gamma();  // true: it changed
  void grab();
  void light_up(estimation::Image<unsigned char> brightness);
  void look_at_square(rig::HostTime lit_at);
  void report_levels();

  GrabberSettings settings_;
  LightTimeline& light_;
  PictureCallback on_picture_;
  LevelCallback on_level_;
  ScanoutClock clock_;
  Photodiode photodiode_;
  int wake_;

  std::atomic<bool> is_server_gone_ = false;  // set by Xlib, in whichever call notices
  bool is_end_told_ = false;                  // the dark that follows was grabbed
  XConnection display_;
  int damage_event_ = 0, randr_event_ = 0;
  Damage damage_ = None;
  std::optional<SharedImage> image_;
  RRCrtc crtc_ = None;
  Rectangle area_;  // of the projector's monitor on the screen; empty: unplugged
  GammaTable gamma_;
  bool is_damaged_ = true, is_moved_ = true;
  rig::HostTime changed_at_ = rig::HostClock::now();  // the last change of what is on the screen
  rig::HostTime next_gamma_check_{};

  PictureCache pictures_{kPictureLimit};
  std::shared_ptr<const Picture> lit_;
  double square_frac_ = -1;  // brightness of the sync square; -1: none yet
  double seen_frac_ = -1;    // as the photodiode saw it last
  rig::HostTime latest_light_{};
  std::mutex seen_mutex_;
  std::condition_variable seen_changed_;
  rig::HostTime seen_until_, wanted_until_;  // guarded by seen_mutex_; all drawn before is lit
  std::atomic<bool> is_stuck_ = false;
  std::atomic<double> level_frac_ = 1;
  std::atomic<bool> is_photodiode_meddled_with_ = false;
  std::deque<LevelSample> levels_;  // still to be reported
};

rig::Result<void> ScreenGrabber::Eye::connect() {
  XSetErrorHandler(ignore_x_error);
  display_.reset(XOpenDisplay(settings_.display.c_str()));
  if (!display_) return rig::failure(rig::Fault::kNotFound, "no X server at " + settings_.display);
  XSetIOErrorHandler(ignore_lost_server);
  XSetIOErrorExitHandler(
      display_.get(),
      [](Display*, void* is_gone) { static_cast<std::atomic<bool>*>(is_gone)->store(true); },
      &is_server_gone_);
  int error_base = 0;
  if (XDamageQueryExtension(display_.get(), &damage_event_, &error_base) == 0 ||
      XRRQueryExtension(display_.get(), &randr_event_, &error_base) == 0 ||
      XShmQueryExtension(display_.get()) == 0)
    return rig::failure(rig::Fault::kUnsupported,
                        settings_.display + " lacks the DAMAGE, RANDR or MIT-SHM extension");
  const Window root = DefaultRootWindow(display_.get());
  damage_ = XDamageCreate(display_.get(), root, XDamageReportRawRectangles);
  XRRSelectInput(display_.get(), root, RRScreenChangeNotifyMask | RRCrtcChangeNotifyMask);
  locate_output();
  if (area_ == Rectangle{})
    return rig::failure(rig::Fault::kNotFound,
                        settings_.display + " shows nothing on output " + settings_.output);
  return {};
}

void ScreenGrabber::Eye::locate_output() {
  is_moved_ = false;
  const XrrResources resources = screen_resources(display_.get());
  if (!resources) return;
  crtc_ = find_output(display_.get(), resources.get(), settings_.output).crtc;
  const XrrCrtcInfo info(crtc_ == None ? nullptr
                                       : XRRGetCrtcInfo(display_.get(), resources.get(), crtc_));
  area_ = info ? Rectangle{info->x, info->y, static_cast<int>(info->width),
                           static_cast<int>(info->height)}
               : Rectangle{};
  change(rig::HostClock::now());
}

bool ScreenGrabber::Eye::read_gamma() {
  next_gamma_check_ = rig::HostClock::now() + kGammaPeriod;
  const XrrGamma ramp(crtc_ == None ? nullptr : XRRGetCrtcGamma(display_.get(), crtc_));
  if (!ramp || ramp->size < 2) return false;
  const GammaTable table = make_table(*ramp);
  const bool is_changed = table != gamma_;
  gamma_ = table;
  return is_changed;
}

// The latest that it can have been: the X server's clock is ours, CLOCK_MONOTONIC, in ms and 32
// bits.
rig::HostTime ScreenGrabber::Eye::drawn_at(Time server_time_ms) const {
  const rig::HostTime now = rig::HostClock::now();
  const auto now_ms = std::chrono::floor<milliseconds>(now.time_since_epoch());
  const auto age_ms = static_cast<std::int32_t>(static_cast<std::uint32_t>(now_ms.count()) -
                                                static_cast<std::uint32_t>(server_time_ms));
  return std::min(now, rig::HostTime(now_ms - milliseconds(age_ms) + milliseconds(1)));
}

bool ScreenGrabber::Eye::is_ours(const XRectangle& drawn) const {
  return drawn.x < area_.x_px + area_.width_px && drawn.x + drawn.width > area_.x_px &&
         drawn.y < area_.y_px + area_.height_px && drawn.y + drawn.height > area_.y_px;
}

void ScreenGrabber::Eye::change(rig::HostTime when) {
  is_damaged_ = true;
  changed_at_ = std::max(changed_at_, when);
}

void ScreenGrabber::Eye::read_events() {
  while (!is_server_gone_ && XPending(display_.get()) > 0) {
    XEvent event;
    XNextEvent(display_.get(), &event);
    if (event.type == damage_event_ + XDamageNotify) {
      const auto& damage = reinterpret_cast<const XDamageNotifyEvent&>(event);
      if (is_ours(damage.area)) change(drawn_at(damage.timestamp));
    } else if (event.type >= randr_event_) {
      XRRUpdateConfiguration(&event);
      is_moved_ = true;
    }
  }
}

void ScreenGrabber::Eye::grab() {
  is_damaged_ = false;
  if (is_server_gone_ || area_ == Rectangle{}) {
    const int height_px = lit_ ? lit_->brightness.height_px() : 1;
    const int width_px = lit_ ? lit_->brightness.width_px() : 1;
    light_up(estimation::Image<unsigned char>(height_px, width_px));
    return;
  }
  if (!image_ || image_->width_px() != area_.width_px || image_->height_px() != area_.height_px)
    image_.emplace(display_.get(), area_.width_px, area_.height_px);
  if (read_gamma()) change(rig::HostClock::now());
  bool is_filled = false;
  do {  // what was drawn before the answer has been told by then, what after it is for another look
    is_damaged_ = false;
    is_filled = image_->fill(area_.x_px, area_.y_px);
    read_events();
  } while (is_filled && is_damaged_ && !is_moved_ && !is_server_gone_);
  if (is_filled) light_up(apply_gamma(*image_, gamma_));
}

void ScreenGrabber::Eye::light_up(estimation::Image<unsigned char> brightness) {
  const double square_frac = take_square(
      brightness,
      place_square(settings_.sync_square, brightness.width_px(), brightness.height_px()));
  const std::int64_t blank = clock_.blank_at(changed_at_) + 1;
  const bool is_flip = square_frac != square_frac_ && square_frac_ >= 0;
  const FlipFaults planned =
      is_flip && settings_.faults != nullptr ? settings_.faults->take_flip() : FlipFaults{};
  latest_light_ =
      std::max(latest_light_, clock_.time_of(blank + settings_.input_lag_frames) + planned.delay);
  const rig::HostTime lit_at = latest_light_;
  if (std::shared_ptr<const Picture> picture = pictures_.find(std::move(brightness));
      picture != lit_) {
    lit_ = std::move(picture);
    light_.show(lit_at, lit_);  // before the photodiode tells anybody
    on_picture_(lit_);
  }
  if (square_frac == square_frac_) return;
  square_frac_ = square_frac;
  if (planned.is_edge_missed) return;
  photodiode_.set_fall_time(
      std::max<std::chrono::microseconds>(settings_.photodiode.fall_time, planned.fall_time));
  look_at_square(lit_at);
}

void ScreenGrabber::Eye::look_at_square(rig::HostTime lit_at) {
  const double frac = square_frac_ * level_frac_;
  if (is_stuck_ || square_frac_ < 0 || frac == seen_frac_) return;
  seen_frac_ = frac;
  const rig::HostTime seen_at = std::max(lit_at + settings_.square_delay, rig::HostClock::now());
  while (!levels_.empty() && levels_.back().time >= seen_at) levels_.pop_back();
  const std::vector<LevelSample> samples = photodiode_.look(seen_at, frac);
  levels_.insert(levels_.end(), samples.begin(), samples.end());
}

void ScreenGrabber::Eye::report_levels() {
  while (!levels_.empty() && levels_.front().time <= rig::HostClock::now()) {
    on_level_(levels_.front().time, levels_.front().level_adc);
    levels_.pop_front();
  }
}

void ScreenGrabber::Eye::wait_for_news(const std::stop_token& stop) {
  if (stop.stop_requested() || has_news()) return;
  if (!is_server_gone_ && XPending(display_.get()) > 0) return;
  if (is_server_gone_ && !is_end_told_) return;  // noticed since the last look, even just above
  rig::HostTime due = next_gamma_check_;
  if (is_server_gone_) due = rig::HostTime::max();
  if (!levels_.empty()) due = std::min(due, levels_.front().time);
  const auto left = std::max(due - rig::HostClock::now(), rig::HostClock::duration::zero());
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(left);
  const timespec timeout{seconds.count(), (left - seconds).count()};
  std::array<pollfd, 2> sources{
      {{wake_, POLLIN, 0}, {ConnectionNumber(display_.get()), POLLIN, 0}}};
  ppoll(sources.data(), is_server_gone_ ? 1 : 2, &timeout, nullptr);
  eventfd_t told = 0;
  static_cast<void>(eventfd_read(wake_, &told));
  if (is_photodiode_meddled_with_.exchange(false) && !stop.stop_requested())
    look_at_square(std::max(latest_light_, rig::HostClock::now()));
}

// Known of, but not looked at yet.
bool ScreenGrabber::Eye::has_news() const { return !is_server_gone_ && (is_moved_ || is_damaged_); }

void ScreenGrabber::Eye::look_at_screen() {
  const rig::HostTime now = rig::HostClock::now();
  bool is_asked = false;
  {
    const std::lock_guard lock(seen_mutex_);
    is_asked = wanted_until_ > seen_until_;
  }
  if (is_asked && !is_server_gone_) XSync(display_.get(), False);  // all events are with us then
  read_events();
  if (is_moved_ && !is_server_gone_) locate_output();
  if (!is_server_gone_ && rig::HostClock::now() >= next_gamma_check_ && read_gamma())
    change(rig::HostClock::now());
  if (is_server_gone_ && !std::exchange(is_end_told_, true)) change(rig::HostClock::now());
  if (is_damaged_) grab();
  if (!is_asked || has_news()) return;
  {
    const std::lock_guard lock(seen_mutex_);
    seen_until_ = now;
  }
  seen_changed_.notify_all();
}

void ScreenGrabber::Eye::see_until(rig::HostTime until) {
  until = std::min(until, rig::HostClock::now());
  std::unique_lock lock(seen_mutex_);
  if (seen_until_ >= until) return;
  wanted_until_ = std::max(wanted_until_, until);
  wake();
  seen_changed_.wait_for(lock, kServerPatience, [&] { return seen_until_ >= until; });
}

void ScreenGrabber::Eye::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    look_at_screen();
    report_levels();
    wait_for_news(stop);
  }
}

rig::Result<std::unique_ptr<ScreenGrabber>> ScreenGrabber::start(const GrabberSettings& settings,
                                                                 LightTimeline& light,
                                                                 PictureCallback on_picture,
                                                                 LevelCallback on_level) {
  auto eye = std::make_unique<Eye>(settings, light, std::move(on_picture), std::move(on_level));
  if (const rig::Result<void> connected = eye->connect(); !connected)
    return tl::unexpected(connected.error());
  return std::unique_ptr<ScreenGrabber>(new ScreenGrabber(std::move(eye), light));
}

ScreenGrabber::ScreenGrabber(std::unique_ptr<Eye> eye, LightTimeline& light)
    : light_(light), eye_(std::move(eye)) {
  thread_ = std::jthread([this](const std::stop_token& stop) {
    const std::stop_callback wake(stop, [this] { eye_->wake(); });
    eye_->run(stop);
  });
  light_.set_source([this](rig::HostTime until) { eye_->see_until(until); });
}

ScreenGrabber::~ScreenGrabber() { light_.set_source({}); }

void ScreenGrabber::stick_photodiode(bool is_stuck) { eye_->stick_photodiode(is_stuck); }

void ScreenGrabber::dim_photodiode(double level_frac) { eye_->dim_photodiode(level_frac); }

}  // namespace hw_sim
