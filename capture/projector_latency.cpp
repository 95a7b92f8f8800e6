#include "capture/projector_latency.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "capture/captured_frame.h"

namespace capture {
namespace {

using rig::Fault;
using std::chrono::nanoseconds;

constexpr int kWhitePicture = 0;
constexpr int kLimit_refreshes = 12;  // the longest lag that any projector is known for, twice
constexpr int kFlipCount = 6;         // at the delay that is chosen, half of them to black
constexpr int kReferenceCount = 3;
constexpr int kBufferCount = 8;
constexpr int kDamageLimit = 10;  // frames in all
// What a level may lack of the new picture's: projectors flicker, and the reference has its noise.
constexpr double kLackFrac = 0.02;
constexpr double kContrastToSpread = 20;

struct Level {
  double mean_dn = 0;
  double spread_dn = 0;  // of the reference frames
};

double mean_dn(const rig::Frame& frame) {
  const FrameSamples samples(frame);
  const auto view = samples.view();
  double sum = 0;
  std::int64_t count = 0;
  for (int row = 0; row < view.height_px; ++row) {
    for (const std::uint16_t dn : view.row(row)) sum += dn;
    count += static_cast<std::int64_t>(view.row(row).size());
  }
  return sum / static_cast<double>(count);
}

class LatencyProbe {
 public:
  LatencyProbe(Devices devices, const LedgerRules& rules, const std::stop_token& stop)
      : devices_(devices), rules_(rules), stop_(stop) {}

  rig::Result<nanoseconds> search() {
    const auto dark = reference(false);
    if (!dark) return tl::unexpected(dark.error());
    const auto bright = reference(true);
    if (!bright) return tl::unexpected(bright.error());
    dark_dn_ = dark->mean_dn;
    bright_dn_ = bright->mean_dn;
    const double spread_dn = std::max({dark->spread_dn, bright->spread_dn, 0.05});
    if (bright_dn_ - dark_dn_ < kContrastToSpread * spread_dn)
      return rig::failure(Fault::kUnsupported,
                          "the camera sees " + std::to_string(dark_dn_) +
                              " DN under a black picture and " + std::to_string(bright_dn_) +
                              " DN under a white one, too little between them to measure the "
                              "projector's latency; see to lens cap, aperture and room light");
    for (int step = 0; step <= 2 * kLimit_refreshes; ++step) {
      const nanoseconds delay = rules_.refresh_interval * step / 2;
      const auto is_enough = sees_flips_wholly(delay);
      if (!is_enough) return tl::unexpected(is_enough.error());
      if (*is_enough) return delay + rules_.refresh_interval;
    }
    return rig::failure(Fault::kUnsupported,
                        "no frame saw a picture wholly within " + std::to_string(kLimit_refreshes) +
                            " refreshes of its swap; turn off the projector's picture processing");
  }

 private:
  // Long after any flip has gone through.
  nanoseconds settle_time() const { return (kLimit_refreshes + 1) * rules_.refresh_interval; }

  rig::Result<bool> sees_flips_wholly(nanoseconds delay) {
    for (int flip = 0; flip < kFlipCount; ++flip) {
      auto lack_frac = flip_once(delay);
      while (!lack_frac && may_repeat(lack_frac.error())) lack_frac = flip_once(delay);
      if (!lack_frac) return tl::unexpected(lack_frac.error());
      if (*lack_frac > kLackFrac) return false;
    }
    return true;
  }

  // What a frame so long after a flip lacks of the new picture's level.
  rig::Result<double> flip_once(nanoseconds delay) {
    if (auto settled = wait_until(devices_.events.now() + settle_time()); !settled)
      return tl::unexpected(settled.error());
    const bool is_white = !is_white_;
    const auto swapped = show(is_white);
    if (!swapped) return tl::unexpected(swapped.error());
    const auto level_dn = expose(*swapped + delay);
    if (!level_dn) return tl::unexpected(level_dn.error());
    return std::abs(*level_dn - (is_white ? bright_dn_ : dark_dn_)) / (bright_dn_ - dark_dn_);
  }

  // A frame that was lost on its way, now and then.
  bool may_repeat(const rig::Error& error) {
    return incident_of(error.fault) == Incident::kFrameDamaged && ++damage_count_ <= kDamageLimit;
  }

  rig::Result<Level> reference(bool is_white) {
    const auto swapped = show(is_white);
    if (!swapped) return tl::unexpected(swapped.error());
    std::vector<double> levels_dn;
    for (int i = 0; i < kReferenceCount; ++i) {
      auto level_dn = expose(devices_.events.now() + settle_time());
      while (!level_dn && may_repeat(level_dn.error()))
        level_dn = expose(devices_.events.now() + settle_time());
      if (!level_dn) return tl::unexpected(level_dn.error());
      levels_dn.push_back(*level_dn);
    }
    std::sort(levels_dn.begin(), levels_dn.end());
    return Level{levels_dn[kReferenceCount / 2], levels_dn.back() - levels_dn.front()};
  }

  rig::Result<rig::HostTime> show(bool is_white) {
    is_white_ = is_white;
    const std::uint64_t show_id = ++show_id_;
    if (auto asked = devices_.projector.show(
            {show_id, is_white ? kWhitePicture : rig::kBlackPicture, false});
        !asked)
      return tl::unexpected(asked.error());
    const auto shown = wait_for<rig::PictureShown>(
        devices_.events.now() + rules_.edge_deadline,
        [show_id](const rig::PictureShown& event) { return event.show_id == show_id; },
        "the projector did not show a picture in time");
    if (!shown) return tl::unexpected(shown.error());
    return shown->swapped;
  }

  // The mean level of a frame whose exposure is triggered at `when`.
  rig::Result<double> expose(rig::HostTime when) {
    if (auto waited = wait_until(when); !waited) return tl::unexpected(waited.error());
    if (auto fired = devices_.camera.trigger_software(); !fired)
      return tl::unexpected(fired.error());
    const auto arrived = wait_for<rig::FrameArrived>(
        devices_.events.now() + rules_.exposures.front() + rules_.frame_deadline,
        [](const rig::FrameArrived&) { return true; }, "the camera sent no frame in time");
    if (!arrived) return tl::unexpected(arrived.error());
    return mean_dn(arrived->frame);
  }

  rig::Result<void> wait_until(rig::HostTime when) {
    while (devices_.events.now() < when) {
      if (stop_.stop_requested()) return rig::failure(Fault::kTimeout, "stopped");
      auto event = devices_.events.wait(when, stop_);
      if (!event) continue;
      if (const auto* fault = std::get_if<rig::DeviceFault>(&*event))
        return tl::unexpected(fault->error);
    }
    return {};
  }

  template <typename Wanted, typename IsIt>
  rig::Result<Wanted> wait_for(rig::HostTime deadline, const IsIt& is_it, const char* otherwise) {
    while (devices_.events.now() < deadline && !stop_.stop_requested()) {
      auto event = devices_.events.wait(deadline, stop_);
      if (!event) continue;
      if (auto* wanted = std::get_if<Wanted>(&*event); wanted != nullptr && is_it(*wanted))
        return std::move(*wanted);
      if (const auto* fault = std::get_if<rig::DeviceFault>(&*event))
        return tl::unexpected(fault->error);
      if (const auto* damaged = std::get_if<rig::FrameDamaged>(&*event))
        return tl::unexpected(rig::Error{Fault::kFrameIncomplete, damaged->error.detail});
    }
    return rig::failure(Fault::kTimeout, stop_.stop_requested() ? "stopped" : otherwise);
  }

  Devices devices_;
  const LedgerRules& rules_;
  const std::stop_token& stop_;
  std::uint64_t show_id_ = 0;
  bool is_white_ = false;
  int damage_count_ = 0;
  double dark_dn_ = 0;
  double bright_dn_ = 0;
};

}  // namespace

rig::Result<nanoseconds> measure_latency(Devices devices, const rig::ProjectorSettings& projector,
                                         const LedgerRules& rules, const std::stop_token& stop) {
  if (auto kept = check_display(devices, rules); !kept) return tl::unexpected(kept.error());
  estimation::Image<unsigned char> white(projector.height_px, projector.width_px);
  std::fill(white.samples().begin(), white.samples().end(), static_cast<unsigned char>(255));
  std::vector<estimation::Image<unsigned char>> pictures;
  pictures.push_back(std::move(white));
  if (auto loaded = devices.projector.load(std::move(pictures)); !loaded)
    return tl::unexpected(loaded.error());
  if (auto armed = devices.camera.arm({rules.exposures.front()}, kBufferCount); !armed)
    return tl::unexpected(armed.error());
  auto latency = LatencyProbe(devices, rules, stop).search();
  devices.camera.disarm();
  // Of no picture in particular; the take that follows begins with black, and asks for it itself.
  if (auto black = devices.projector.show({}); !black && latency)
    return tl::unexpected(black.error());
  return latency;
}

}  // namespace capture
