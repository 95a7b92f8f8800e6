// Frames of a small world, taken by the in-process devices as a session would take them.
#pragma once

#include <optional>
#include <utility>
#include <variant>
#include <vector>

#include "hw_sim/devices/in_process_rig.h"
#include "tests/hw_sim/world/test_rig.h"
#include "tests/temporary_folder.h"

namespace hw_sim {

// Transport that worlds of one test program share.
inline const test_support::TemporaryFolder& shared_cache() {
  static const test_support::TemporaryFolder folder;
  return folder;
}

inline SceneOptions quick_scene(const std::string& name, const Effects& effects = {}) {
  SceneOptions options;
  options.name = name;
  options.has_indirect = false;
  options.effects = effects;
  options.thread_count = 2;
  options.cache_folder = shared_cache().path();
  return options;
}

struct Shot {
  estimation::Image<std::uint16_t> dn;
  std::uint64_t trigger_number = 0;
  std::chrono::nanoseconds edge_after_swap{0};
  double at(int row, int col, int channel = 0) const { return dn.at(row, col, channel); }
};

class RigShots {
 public:
  RigShots(const TestRig& rig, const World& world, rig::Corner square = rig::Corner::kBottomRight)
      : rig_(rig), devices_(world, options(rig, square)) {}

  // Every pattern in every exposure, in this order.
  std::vector<Shot> take(const std::vector<estimation::PatternKind>& patterns,
                         const std::vector<std::chrono::microseconds>& exposures) {
    std::vector<estimation::Image<unsigned char>> pictures;
    for (const auto& kind : patterns) pictures.push_back(make_picture(rig_, kind).brightness);
    EXPECT_TRUE(devices_.projector().load(std::move(pictures)));
    const std::size_t total = patterns.size() * exposures.size();
    EXPECT_TRUE(devices_.camera().arm(exposures, static_cast<int>(total)));
    EXPECT_TRUE(devices_.trigger().arm(exposures, 1));
    std::vector<Shot> shots;
    for (std::size_t pattern = 0; pattern < patterns.size(); ++pattern) {
      show(static_cast<int>(pattern));
      wait_for((pattern + 1) * exposures.size(), shots);
    }
    devices_.trigger().disarm();
    devices_.camera().disarm();
    return shots;
  }

  // The first pattern, and the second as soon as the projector can, in one exposure.
  Shot take_straddling(const estimation::PatternKind& first, const estimation::PatternKind& second,
                       std::chrono::microseconds exposure) {
    std::vector<estimation::Image<unsigned char>> pictures;
    for (const auto& kind : {first, second})
      pictures.push_back(make_picture(rig_, kind).brightness);
    EXPECT_TRUE(devices_.projector().load(std::move(pictures)));
    EXPECT_TRUE(devices_.camera().arm({exposure}, 1));
    EXPECT_TRUE(devices_.trigger().arm({exposure}, 1));
    show(0);
    show(1);
    std::vector<Shot> shots;
    wait_for(1, shots);
    devices_.trigger().disarm();
    devices_.camera().disarm();
    return shots.empty() ? Shot{} : std::move(shots.front());
  }

  InProcessRig& devices() { return devices_; }

 private:
  static InProcessOptions options(const TestRig& rig, rig::Corner square) {
    InProcessOptions options;
    options.projector.monitor = "SIM-1";
    options.projector.width_px = rig.projector.width_px;
    options.projector.height_px = rig.projector.height_px;
    options.projector.sync_square.size_px = 8;
    options.projector.sync_square.corner = square;
    options.camera.pixel_format = estimation::to_string(rig.camera.pixel_format);
    return options;
  }

  void show(int picture) {
    is_light_ = !is_light_;
    EXPECT_TRUE(devices_.projector().show({++show_id_, picture, is_light_}));
  }

  void wait_for(std::size_t count, std::vector<Shot>& shots) {
    const rig::HostTime deadline = devices_.timeline().now() + std::chrono::seconds(20);
    rig::HostTime swapped, edge;
    while (shots.size() < count) {
      std::optional<rig::Event> event = devices_.timeline().wait(deadline, {});
      if (!event) {
        ADD_FAILURE() << "no frame";
        return;
      }
      if (const auto* shown = std::get_if<rig::PictureShown>(&*event)) swapped = shown->swapped;
      if (const auto* seen = std::get_if<rig::EdgeSeen>(&*event)) edge = seen->time;
      if (auto* arrived = std::get_if<rig::FrameArrived>(&*event)) {
        shots.push_back(shot_of(arrived->frame));
        shots.back().edge_after_swap = edge - swapped;
      }
    }
  }

  Shot shot_of(const rig::Frame& frame) const {
    Shot shot;
    const int channels = estimation::sample_channel_count(rig_.camera.pixel_format.filter);
    shot.dn = estimation::Image<std::uint16_t>(frame.height_px, frame.width_px, channels);
    const auto samples = shot.dn.samples();
    const bool is_8_bit = frame.pixels.size() == samples.size();
    for (std::size_t i = 0; i < samples.size(); ++i)
      samples[i] =
          is_8_bit
              ? static_cast<std::uint16_t>(frame.pixels[i])
              : static_cast<std::uint16_t>(static_cast<unsigned>(frame.pixels[2 * i]) |
                                           static_cast<unsigned>(frame.pixels[2 * i + 1]) << 8);
    shot.trigger_number = frame.trigger_count.value_or(0);
    return shot;
  }

  TestRig rig_;
  InProcessRig devices_;
  bool is_light_ = false;
  std::uint64_t show_id_ = 0;
};

// All the world's effects at once, none of them large.
inline Effects every_effect() {
  Effects effects;
  effects.blur_px = 0.5;
  effects.defocus_px_per_mm = 0.005;
  effects.pixel_fill_frac = 0.9;
  effects.gamma = 1.1;
  effects.black_frac = 0.002;
  effects.vignetting_frac = 0.1;
  effects.crosstalk_frac = 0.05;
  effects.input_lag_refreshes = 1;
  effects.scanout_ms = 8;
  effects.ripple_frac = 0.1;
  effects.camera_blur_px = 0.4;
  effects.camera_defocus_px_per_mm = 0.002;
  effects.camera_vignetting_frac = 0.1;
  effects.full_well_e = 15000;
  effects.pixel_gain_sd_frac = 0.01;
  effects.pixel_offset_sd_dn = 1;
  effects.hot_pixel_frac = 0.01;
  effects.hot_pixel_dn_per_s = 1000;
  effects.is_cross_polarised = false;
  effects.ambient_frac = 0.003;
  effects.flicker_frac = 0.5;
  effects.backdrop_reflectance_frac = 0.2;
  effects.drift_mm_per_s = {0.1, 0.1, 0.2};
  effects.breathing_mm = {0, 0.1, 0.3};
  effects.blink_start_s = 0.05;
  effects.blink_s = 0.1;
  return effects;
}

}  // namespace hw_sim
