#include "hw_sim/devices/sim_projector.h"

#include <algorithm>
#include <utility>

namespace hw_sim {
namespace {

using estimation::Image;

constexpr unsigned char kLight = 255;

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

rig::Error lost() {
  return {rig::Fault::kDisplayChanged, "the monitor is gone; plug it in and start again"};
}

}  // namespace

ShownPicture shown_picture(std::uint64_t picture_id) {
  return {static_cast<int>(picture_id >> 1 & 0x7fffffff) - 1, (picture_id & 1) != 0};
}

SimProjector::SimProjector(rig::ProjectorSettings settings, DisplayTiming timing,
                           const SimFaults& faults, Timeline& timeline, OnLight on_light)
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
  report.is_vsynced = true;
  report.text = "simulated projector, every interval exact";
  return report;
}

rig::Result<void> SimProjector::load(std::vector<Image<unsigned char>> pictures) {
  if (is_lost_) return tl::unexpected(lost());
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
  on_light_(compose({}), false);
  return {};
}

rig::Result<void> SimProjector::show(const rig::ShowRequest& request) {
  if (is_lost_) return tl::unexpected(lost());
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
  if (requests_.empty() || is_lost_) return;
  const rig::ShowRequest request = requests_.front();
  requests_.pop_front();
  ++swap_count_;
  if (faults_.projector_lost_at_show == swap_count_) return lose();
  timeline_.post(rig::PictureShown{request.show_id, timeline_.now()});
  rig::HostTime light = timeline_.now() + timing_.input_lag_refreshes * timing_.refresh_interval;
  if (faults_.late_flips.contains(swap_count_)) light += faults_.flip_delay;
  latest_light_ = std::max(latest_light_, light);
  timeline_.schedule(latest_light_, [this, picture = compose(request), request] {
    on_light_(picture, request.is_square_light);
  });
  if (!requests_.empty()) schedule_swap();
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

void SimProjector::lose() {
  is_lost_ = true;
  timeline_.post(rig::DeviceFault{rig::Device::kProjector, lost()});
}

}  // namespace hw_sim
