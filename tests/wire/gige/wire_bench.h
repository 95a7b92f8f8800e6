// A GigE Vision device on an address of this process's own, with a small world in front of it.
#pragma once

#include <unistd.h>

#include <atomic>
#include <memory>
#include <string>

#include "hw_sim/gige/gige_device.h"
#include "hw_sim/light.h"
#include "hw_sim/world.h"
#include "rig/camera.h"
#include "rig/devices/aravis_camera.h"
#include "tests/contract/camera_bench.h"

// Pixel (row, col) tells what it is: the trigger number in column 0, the exposure in column 1, else
// its own place.
class IdentityWorld final : public hw_sim::World {
 public:
  explicit IdentityWorld(int width_px = 64, int height_px = 48)
      : width_px_(width_px), height_px_(height_px) {}
  int width_px() const override { return width_px_; }
  int height_px() const override { return height_px_; }
  int channel_count() const override { return 1; }
  static std::uint16_t place(int row, int col) {
    return static_cast<std::uint16_t>((row * 64 + col) % 4096);
  }
  void expose(const hw_sim::Exposure& exposure,
              estimation::ImageView<std::uint16_t> frame_dn) const override {
    for (int row = 0; row < height_px_; ++row) {
      for (int col = 0; col < width_px_; ++col) frame_dn.at(row, col) = place(row, col);
      frame_dn.at(row, 0) = static_cast<std::uint16_t>(exposure.trigger_number);
      frame_dn.at(row, 1) = static_cast<std::uint16_t>(exposure.duration.count());
    }
  }

 private:
  int width_px_;
  int height_px_;
};

// 127.a.b.c of this process and no other, a new one each time.
inline std::string own_address() {
  static std::atomic<int> used{0};
  const int process = getpid();
  return "127." + std::to_string(16 + process / 250 % 200) + "." +
         std::to_string(1 + process % 250) + "." + std::to_string(1 + ++used % 250);
}

inline std::uint16_t sample(const rig::Frame& frame, int row, int col) {
  const auto index = static_cast<std::size_t>(row * frame.width_px + col) * 2;
  return static_cast<std::uint16_t>(std::to_integer<unsigned>(frame.pixels[index]) |
                                    std::to_integer<unsigned>(frame.pixels[index + 1]) << 8);
}

class WireBench final : public CameraBench {
 public:
  explicit WireBench(rig::Bracketing bracketing = rig::Bracketing::kSequencer,
                     bool has_64_bit_block_ids = false, int width_px = 64, int height_px = 48)
      : world_(width_px, height_px) {
    options.address = own_address();
    options.has_64_bit_block_ids = has_64_bit_block_ids;
    options.clock_drift_ppm = 20;
    settings.address = options.address;
    settings.width_px = width_px;
    settings.height_px = height_px;
    settings.packet_size_bytes = 1500;  // several packets a frame, as on a real wire
    settings.bracketing = bracketing;
  }

  // Starts the device when it is not running yet.
  rig::Result<std::unique_ptr<rig::Camera>> open() override {
    if (auto started = start(); !started) return tl::unexpected(started.error());
    auto camera = rig::AravisCamera::open(settings, queue_);
    if (!camera) return tl::unexpected(camera.error());
    return std::unique_ptr<rig::Camera>(std::move(*camera));
  }
  rig::Result<void> start() {
    if (device_) return {};
    auto device = hw_sim::GigeDevice::start(options, world_, light_);
    if (!device) return tl::unexpected(device.error());
    device_ = std::move(*device);
    return {};
  }
  void power_off() { device_.reset(); }
  void pulse(std::chrono::microseconds width) override {
    device_->pulse(rig::HostClock::now(), width);
  }
  rig::EventQueue& source() override { return queue_; }
  std::chrono::microseconds readout() const override { return options.readout; }
  hw_sim::GigeDevice& device() { return *device_; }

  hw_sim::GigeDeviceOptions options;
  rig::CameraSettings settings;

 private:
  IdentityWorld world_;
  hw_sim::LightTimeline light_;
  rig::EventQueue queue_;
  std::unique_ptr<hw_sim::GigeDevice> device_;
};
