#include "hw_sim/devices/sim_projector.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace hw_sim {
namespace {

using estimation::Image;

constexpr unsigned char kLight = 255;
constexpr std::uint64_t kGammaBit = std::uint64_t{1} << 63;  // of a picture's id
constexpr std::chrono::milliseconds kWatchPeriod{250};       // of the driver

// load number, picture plus one, square: unique per picture object that differs.
std::uint64_t picture_id(std::uint64_t load_number, const rig::ShowRequest& request) {
  return load_number << 32 | static_cast<std::uint64_t>(request.picture + 1) << 1 |
         (request.is_square_light ? 1U : 0U);
}

void paint_square(const rig::SyncSquareSettings& square, bool is_light,
                  Image<unsigned char>& picture) {
  const int size = std::min({square.size_px, picture.height_px(), picture.width_px()});
  const bool is_bottom =
      square.corner == rig::Corner::kBottomLeft || square.corner == rig::Corner::kBottomRight;
  const bool is_right =
      square.corner == rig::Corner::kTopRight || square.corner == rig::Corner::kBottomRight;
  const int top = is_bottom ? picture.height_px() - size : 0;
  const int left = is_right ? picture.width_px() - size : 0;
  for (int row = top; row < top + size; ++row)
    for (int col = left; col < left + size; ++col)
      picture.at(row, col) = is_light ? kLight : static_cast<unsigned char>(0);
}

rig::Error changed(bool is_plugged_in) {
  return {rig::Fault::kDisplayChanged,
          is_plugged_in ? "the gamma ramp was changed by another program; turn off night light"
                        : "the monitor is gone; plug it in again"};
}

}  // namespace

ShownPicture shown_picture(std::uint64_t picture_id) {
  return {static_cast<int>(picture_id >> 1 & 0x7fffffff) - 1, (picture_id & 1) != 0};
}

SimProjector::SimProjector(rig::ProjectorSettings settings, DisplayTiming timing,
                           FaultSchedule& faults, Timeline& timeline, OnLight on_light)
    : settings_(std::move(settings)),
      timing_(timing),
      faults_(faults),
      timeline_(timeline),
      on_light_(std::move(on_light)),
      latest_light_(timeline.now()) {}

rig::DisplayReport SimProjector::report() const {
  const double refresh_hz = 1e9 / static_cast<double>(timing_.refresh_interval.count());
  rig::DisplayReport report;
  report.monitor = settings_.monitor;
  report.renderer = "simulated";
  report.width_px = settings_.width_px;
  report.height_px = settings_.height_px;
  report.nominal_refresh_hz = refresh_hz;
  report.measured_refresh_hz = refresh_hz;
  report.interval_max_ms = 1e3 / refresh_hz;
  report.is_gamma_identity = true;
  report.is_vsynced = timing_.is_synchronised;
  report.text = timing_.is_synchronised ? "simulated projector, every interval exact"
                                        : "simulated projector, not synchronised";
  return report;
}

rig::Result<void> SimProjector::load(std::vector<Image<unsigned char>> pictures) {
  if (is_changed_) return tl::unexpected(changed(is_plugged_in_));
  for (const auto& picture : pictures) {
    if (picture.width_px() == settings_.width_px && picture.height_px() == settings_.height_px &&
        picture.channel_count() == 1)
      continue;
    return rig::failure(rig::Fault::kOutOfRange,
                        "a picture of " + std::to_string(picture.width_px()) + " x " +
                            std::to_string(picture.height_px()) + " px; the monitor has " +
                            std::to_string(settings_.width_px) + " x " +
                            std::to_string(settings_.height_px));
  }
  pictures_ = std::move(pictures);
  ++load_count_;
  requests_.clear();
  shown_ = {};
  light(timeline_.now(), {}, {});
  return {};
}

rig::Result<void> SimProjector::show(const rig::ShowRequest& request) {
  if (is_changed_) return tl::unexpected(changed(is_plugged_in_));
  if (request.picture < rig::kBlackPicture || request.picture >= static_cast<int>(pictures_.size()))
    return rig::failure(rig::Fault::kOutOfRange,
                        "picture " + std::to_string(request.picture) + " is not loaded");
  requests_.push_back(request);
  if (requests_.size() == 1) schedule_swap();
  return {};
}

rig::HostTime SimProjector::next_vertical_blank() const {
  const auto since_epoch = timeline_.now().time_since_epoch();
  return rig::HostTime((since_epoch / timing_.refresh_interval + 1) * timing_.refresh_interval);
}

void SimProjector::schedule_swap() {
  timeline_.schedule(next_vertical_blank(), [this] { swap(); });
}

void SimProjector::swap() {
  if (requests_.empty() || is_changed_) return;
  watch();
  if (is_changed_) return;
  const rig::ShowRequest request = requests_.front();
  const bool is_flip = request.is_square_light != shown_.is_square_light;
  if (!flip_) {
    const bool is_blank_skipped = is_flip && faults_.take_skipped_blank();
    flip_ = is_flip ? faults_.take_flip() : FlipFaults{};
    if (is_blank_skipped) return schedule_swap();
  }
  const FlipFaults flip = *std::exchange(flip_, std::nullopt);
  requests_.pop_front();
  shown_ = request;
  tell_of_swap(request.show_id);
  light(timeline_.now() + timing_.input_lag_refreshes * timing_.refresh_interval +
            timing_.light_delay + flip.delay,
        request, flip);
  if (!requests_.empty()) schedule_swap();
}

void SimProjector::tell_of_swap(std::uint64_t show_id) {
  const rig::HostTime told = timeline_.now() + timing_.report_delay;
  if (timing_.report_delay.count() == 0) return timeline_.post(rig::PictureShown{show_id, told});
  timeline_.schedule(told, [this, show_id, told] {
    timeline_.post(rig::PictureShown{show_id, told});
  });
}

void SimProjector::light(rig::HostTime when, const rig::ShowRequest& request,
                         const FlipFaults& faults) {
  // Behind a late picture the others come as they were scanned out.
  latest_light_ = when >= latest_light_ ? when : latest_light_ + timing_.refresh_interval;
  timeline_.schedule(latest_light_, [this, picture = compose(request), request, faults] {
    lit_ = picture;
    if (is_plugged_in_) on_light_(after_gamma(picture), request.is_square_light, faults);
  });
}

std::shared_ptr<const Picture> SimProjector::after_gamma(
    const std::shared_ptr<const Picture>& picture) const {
  if (gamma_exponent_ == 1) return picture;
  auto bent = std::make_shared<Picture>(*picture);
  bent->id |= kGammaBit;
  for (unsigned char& level : bent->brightness.samples())
    level = static_cast<unsigned char>(std::lround(255 * std::pow(level / 255.0, gamma_exponent_)));
  return bent;
}

std::shared_ptr<const Picture> SimProjector::compose(const rig::ShowRequest& request) const {
  auto picture = std::make_shared<Picture>();
  picture->id = picture_id(load_count_, request);
  picture->brightness = request.picture == rig::kBlackPicture
                            ? Image<unsigned char>(settings_.height_px, settings_.width_px)
                            : pictures_[static_cast<std::size_t>(request.picture)];
  // As the window does: white is what the photodiode reads as light, or as low if inverted.
  paint_square(settings_.sync_square, request.is_square_light != settings_.sync_square.is_inverted,
               picture->brightness);
  return picture;
}

rig::Result<void> SimProjector::check() const {
  if (is_changed_) return tl::unexpected(changed(is_plugged_in_));
  return {};
}

void SimProjector::set_gamma(double exponent) {
  gamma_exponent_ = exponent;
  if (!is_plugged_in_ || !lit_) return;
  on_light_(after_gamma(lit_), shown_picture(lit_->id).is_square_light, {});
  timeline_.schedule(timeline_.now() + kWatchPeriod, [this] { watch(); });
}

void SimProjector::unplug() {
  if (!std::exchange(is_plugged_in_, false)) return;
  auto dark = std::make_shared<Picture>();
  dark->brightness = Image<unsigned char>(settings_.height_px, settings_.width_px);
  on_light_(dark, settings_.sync_square.is_inverted, {});
  watch();
}

void SimProjector::plug_in() {
  is_plugged_in_ = true;
  timeline_.schedule(timeline_.now() + kWatchPeriod, [this] { watch(); });
}

// The driver's look at the display: is it as it was opened?
void SimProjector::watch() {
  const bool is_as_opened = is_plugged_in_ && gamma_exponent_ == 1;
  if (is_as_opened == !is_changed_) return;
  is_changed_ = !is_as_opened;
  requests_.clear();
  flip_.reset();
  if (!is_as_opened)
    timeline_.post(rig::DeviceFault{rig::Device::kProjector, changed(is_plugged_in_)});
  shown_ = {};
  light(timeline_.now(), {}, {});  // black
}

}  // namespace hw_sim
