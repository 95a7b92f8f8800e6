// The camera of the in-process rig: the exposure engine looking at a World, without a network.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "hw_sim/devices/timeline.h"
#include "hw_sim/exposure_engine.h"
#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/light.h"
#include "hw_sim/trigger_box_model.h"
#include "hw_sim/world.h"
#include "rig/camera.h"
#include "rig/frame.h"

namespace hw_sim {

struct CameraTiming {
  std::chrono::microseconds readout{500};
  std::chrono::microseconds transfer{3000};             // from the end of readout to the host
  std::chrono::nanoseconds clock_start{7'000'000'000};  // what its counter read at power-up
  double clock_drift_ppm = 20;
  bool has_chunks = true;
  bool has_line_status = true;  // among the chunks: the line's level when the exposure began
};

class FramePool;

// Not thread-safe: lives on its Timeline's thread; leases may be given back from any.
class SimCamera final : public rig::Camera {
 public:
  // The frames have the world's size; `world` and `light` outlive the camera.
  SimCamera(rig::CameraSettings settings, CameraTiming timing, FaultSchedule& faults,
            Timeline& timeline, const World& world, const LightTimeline& light);
  ~SimCamera() override;

  const rig::CameraIdentity& identity() const override { return identity_; }
  rig::Result<void> arm(const std::vector<std::chrono::microseconds>& bracket_exposures,
                        int frame_count) override;
  void disarm() noexcept override;
  rig::Result<rig::CameraCounters> counters() override;
  rig::Result<rig::CameraClockSample> read_clock() override;
  rig::Result<void> trigger_software() override;

  // In a rig without a trigger box: its events go to `sink`, its arming is the rig's, and
  // trigger_software() calls `pulse`.
  void be_the_trigger(rig::EventSink& sink, std::function<void()> pulse);
  // Would a pulse be an exposure now, and of which bracket?
  bool is_waiting() const { return is_armed_ && !engine_.is_busy(timeline_.now()); }
  int next_bracket() const { return engine_.active_set(); }

  // The trigger line goes up now.
  void pulse(const LinePulse& pulse);
  // The level that a photodiode gives the trigger line, from now on.
  void set_line(bool is_high) { is_line_high_ = is_high; }

  // Faults of the whole device. Rebooted: its settings, counters and clock start anew. Lost is what
  // the driver says at once where the camera itself tells, and after the heartbeat's patience where
  // nothing does.
  void power_off();
  void power_on();
  void steal_control();
  void give_control_back();
  void pull_cable();
  void plug_cable_in();
  void step_clock(std::chrono::nanoseconds step) { clock_step_ += step; }
  // What a driver does to a camera that it lost. Errors: kNotFound, kAccessDenied.
  rig::Result<void> open_again();
  // A pulse on the line that nobody sent.
  void disturb_line();

 private:
  struct Shot {
    ExposureJob job;
    ShotFaults faults;
    bool is_line_high = false;  // when it began
  };

  void take(const LinePulse& pulse, const ShotFaults& faults);
  void lose();
  void finish(const Shot& shot);
  void send(const Shot& shot, std::vector<std::byte> pixels);
  void deliver(rig::HostTime arrival, const Shot& shot, std::vector<std::byte> pixels);
  // Rounds of resend requests until all packets are there; nullopt: too many.
  std::optional<int> resend_rounds(const ShotFaults& faults, std::size_t byte_count) const;
  rig::Frame make_frame(const Shot& shot, std::vector<std::byte> pixels) const;
  void expose(const ExposureJob& job, std::vector<std::byte>& pixels) const;
  rig::CameraClock::time_point camera_time(rig::HostTime time) const;

  const rig::CameraSettings settings_;
  const CameraTiming timing_;
  FaultSchedule& faults_;
  Timeline& timeline_;
  rig::EventSink* sink_;  // borrowed
  std::function<void()> software_pulse_;
  bool is_the_trigger_ = false;
  const World& world_;
  const LightTimeline& light_;
  rig::HostTime power_up_;
  rig::CameraIdentity identity_{"ssrig", "SimCamera", "SIM", "1"};
  ExposureEngine engine_;
  // Shared with every lease: frames may outlive the camera.
  std::shared_ptr<FramePool> pool_;
  bool is_armed_ = false;
  bool is_lost_ = false;
  rig::HostTime link_free_{};        // when the frames sent so far are at the host
  std::uint64_t arming_number_ = 0;  // exposures of earlier armings are discarded
  std::uint64_t block_id_ = 0;       // of this arming
  std::uint64_t cable_number_ = 0;   // how often the cable was pulled or plugged in
  bool is_cable_pulled_ = false;
  bool is_powered_ = true;
  bool is_controlled_by_other_ = false;
  std::chrono::nanoseconds clock_step_{0};
  std::chrono::microseconds last_exposure_{0};
  bool is_line_high_ = false;
  rig::CameraCounters counters_;
};

}  // namespace hw_sim
