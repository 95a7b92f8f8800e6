// A head for tests of captures: a flat face with blurred stripes on it that can be made to move and
// its light to change, at no cost. The rig around it is small, so that a whole take is a second.
#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <mutex>
#include <optional>
#include <random>
#include <utility>

#include "hw_sim/devices/in_process_rig.h"
#include "hw_sim/world.h"
#include "rig/rig_file.h"

namespace capture {

// How the head is at a moment.
struct Pose {
  double stripes_px = 0;  // projector px that the light has moved over it: it came nearer
  double row_px = 0;      // frame px that it has moved down
  double light = 1;       // of the projector
  double ambient_frac = 0;
  double eye_light = 1;  // of the eye's: other than 1 while it is open
  double eye_row = 28, eye_col = 40;
};
// By seconds since the first exposure.
using PoseAt = std::function<Pose(double)>;

// A flat phantom fills the frame, so that the sync square is seen on it.
enum class Subject { kHead, kFlatPhantom };

class StripedWorld final : public hw_sim::World {
 public:
  static constexpr int kWidthPx = 96, kHeightPx = 72;
  static constexpr int kProjectorWidthPx = 256, kProjectorHeightPx = 192;
  static constexpr double kEyeRow = Pose{}.eye_row, kEyeCol = Pose{}.eye_col;

  explicit StripedWorld(
      PoseAt pose_at = [](double) { return Pose{}; }, Subject subject = Subject::kHead)
      : pose_at_(std::move(pose_at)), subject_(subject) {}

  int width_px() const override { return kWidthPx; }
  int height_px() const override { return kHeightPx; }
  int channel_count() const override { return 1; }

  void expose(const hw_sim::Exposure& exposure,
              estimation::ImageView<std::uint16_t> frame_dn) const override {
    const Pose pose =
        pose_at_(std::chrono::duration<double>(exposure.start - first(exposure)).count());
    std::mt19937_64 random(exposure.trigger_number);
    for (int row = 0; row < kHeightPx; ++row) {
      for (int col = 0; col < kWidthPx; ++col) {
        double dn = 0;
        for (const auto& segment : exposure.light) {
          const double ms = std::chrono::duration<double, std::milli>(segment.duration).count();
          dn += ms * light_at(*segment.picture, pose, row, col);
        }
        dn += kDnPerMs * pose.ambient_frac * skin(pose, row, col) *
              static_cast<double>(exposure.duration.count()) / 1000;
        double sum = -6;  // of twelve uniform numbers: nearly normal
        for (int i = 0; i < 12; ++i) sum += static_cast<double>(random() >> 11U) * 0x1.0p-53;
        const double noisy = 64 + dn + sum * std::sqrt(dn / 5 + 4);
        frame_dn.at(row, col) = static_cast<std::uint16_t>(std::clamp(noisy, 0.0, 4095.0));
      }
    }
  }

 private:
  static constexpr double kDnPerMs = 40;  // of white light on the brightest skin

  std::chrono::nanoseconds first(const hw_sim::Exposure& exposure) const {
    const std::lock_guard lock(mutex_);
    if (!first_) first_ = exposure.start;
    return *first_;
  }

  double skin(const Pose& pose, int row, int col) const {
    const double y = row - pose.row_px, x = col;
    const double radius =
        std::hypot((y - kHeightPx / 2.0) / (0.45 * kHeightPx), (x - kWidthPx / 2.0) / 40.0);
    const double texture = 1 + 0.1 * std::sin(0.4 * x + 0.3 * y) * std::cos(0.5 * y - 0.1 * x);
    const double eye =
        std::exp(-std::pow((y - pose.eye_row) / 3, 2) - std::pow((x - pose.eye_col) / 5, 2));
    const double inside =
        subject_ == Subject::kFlatPhantom ? 1 : 1 / (1 + std::exp(20 * (radius - 1)));
    return texture * inside * (1 + (pose.eye_light - 1) * eye);
  }

  double light_at(const hw_sim::Picture& picture, const Pose& pose, int row, int col) const {
    constexpr int kReach = 8;
    constexpr double kBlurPx = 3;
    const double u = (col + 0.5) * kProjectorWidthPx / kWidthPx - 0.5 - pose.stripes_px;
    const int v =
        std::min((2 * row + 1) * kProjectorHeightPx / (2 * kHeightPx), kProjectorHeightPx - 1);
    double sum = 0, weights = 0;
    for (int k = -kReach; k <= kReach; ++k) {
      const int at = static_cast<int>(std::lround(u)) + k;
      const double distance = (at - u) / kBlurPx;
      const double weight = std::exp(-0.5 * distance * distance);
      weights += weight;
      if (at >= 0 && at < kProjectorWidthPx) sum += weight * picture.brightness.at(v, at) / 255.0;
    }
    return kDnPerMs * pose.light * skin(pose, row, col) * (0.02 + sum / weights);
  }

  PoseAt pose_at_;
  Subject subject_;
  mutable std::mutex mutex_;
  mutable std::optional<std::chrono::nanoseconds> first_;  // guarded by mutex_
};

// Its rig in `folder`, with a calibration: the projector a quarter of a metre beside the camera.
inline rig::RigFile striped_rig_file(const std::filesystem::path& folder) {
  rig::RigFile rig_file;
  rig_file.path = folder / "rig.toml";
  rig_file.calibration_file = folder / "calibration.json";
  rig_file.storage.directory = folder / "sessions";
  rig_file.projector.monitor = "SIM-1";
  rig_file.projector.width_px = StripedWorld::kProjectorWidthPx;
  rig_file.projector.height_px = StripedWorld::kProjectorHeightPx;
  rig_file.projector.sync_square.size_px = 8;
  rig_file.camera.pixel_format = "Mono12";
  rig_file.camera.width_px = StripedWorld::kWidthPx;
  rig_file.camera.height_px = StripedWorld::kHeightPx;
  rig_file.sensor = {
      .black_level_dn = 64, .saturation_level_dn = 4000, .gain_e_per_dn = 5, .read_noise_e = 10};
  rig_file.sequence.exposures = {std::chrono::microseconds(10'000),
                                 std::chrono::microseconds(40'000)};
  std::filesystem::create_directories(rig_file.storage.directory);
  std::ofstream(rig_file.calibration_file) << R"({
    "camera": {"K": [[300, 0, 47.5], [0, 300, 35.5], [0, 0, 1]]},
    "projector": {"K": [[800, 0, 327.5], [0, 800, 95.5], [0, 0, 1]],
                  "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [-250, 0, 0]},
    "irradiance": {"signal_per_us": [0.04], "reference_distance_mm": 1030}
  })";
  return rig_file;
}

inline hw_sim::InProcessOptions in_process(const rig::RigFile& rig_file) {
  hw_sim::InProcessOptions options;
  options.projector = rig_file.projector;
  options.trigger = rig_file.trigger;
  options.camera = rig_file.camera;
  options.sync = rig_file.sequence.sync;
  return options;
}

}  // namespace capture
