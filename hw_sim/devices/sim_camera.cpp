#include "hw_sim/devices/sim_camera.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <mutex>
#include <random>
#include <string>
#include <utility>

namespace hw_sim {

using std::chrono::microseconds;
using std::chrono::nanoseconds;

// Buffers of one arming. Thread-safe.
class FramePool {
 public:
  FramePool(int buffer_count, std::size_t byte_count)
      : free_(static_cast<std::size_t>(buffer_count)) {
    for (auto& buffer : free_) buffer.resize(byte_count);
  }
  std::optional<std::vector<std::byte>> take() {
    const std::lock_guard lock(mutex_);
    if (free_.empty()) return std::nullopt;
    std::vector<std::byte> buffer = std::move(free_.back());
    free_.pop_back();
    return buffer;
  }
  void give_back(std::vector<std::byte> buffer) {
    const std::lock_guard lock(mutex_);
    free_.push_back(std::move(buffer));
  }

 private:
  std::mutex mutex_;
  std::vector<std::vector<std::byte>> free_;  // guarded by mutex_
};

namespace {

constexpr microseconds kLongestExposure{10'000'000};
constexpr microseconds kBounceDelay{100};  // from one rise of a bouncing line to the next
constexpr microseconds kStrayPulse{1000};
// As Aravis does with packets of 1500 bytes: it asks again every 2 ms or so, and gives up in the
// end.
constexpr std::size_t kPacketBytes = 1464;
constexpr std::chrono::milliseconds kResendRound{2};
constexpr int kResendRoundLimit = 25;
// When the driver knows that it has lost the camera: at the next heartbeat, or when nothing has
// answered for long enough (measured: 5.0 to 6.0 s).
constexpr std::chrono::milliseconds kControlCheckPeriod{1000};
constexpr std::chrono::milliseconds kHeartbeatPatience{5500};

class PoolLease final : public rig::FrameLease {
 public:
  PoolLease(std::shared_ptr<FramePool> pool, std::vector<std::byte> buffer)
      : pool_(std::move(pool)), buffer_(std::move(buffer)) {}
  ~PoolLease() override { pool_->give_back(std::move(buffer_)); }
  const std::vector<std::byte>& buffer() const { return buffer_; }

 private:
  std::shared_ptr<FramePool> pool_;  // shared: the last lease keeps it alive
  std::vector<std::byte> buffer_;
};

bool is_8_bit(const std::string& pixel_format) { return pixel_format.ends_with("8"); }

std::size_t sample_count(const World& world) {
  return static_cast<std::size_t>(world.width_px()) * static_cast<std::size_t>(world.height_px()) *
         static_cast<std::size_t>(world.channel_count());
}

rig::Error lost() {
  return {rig::Fault::kDeviceLost,
          "the camera is gone; see its power and its cable and start again"};
}

}  // namespace

SimCamera::SimCamera(rig::CameraSettings settings, CameraTiming timing, FaultSchedule& faults,
                     Timeline& timeline, const World& world, const LightTimeline& light)
    : settings_(std::move(settings)),
      timing_(timing),
      faults_(faults),
      timeline_(timeline),
      sink_(&timeline),
      world_(world),
      light_(light),
      power_up_(timeline.now()) {
  engine_.readout = timing_.readout;
  identity_.tells_line_level = timing_.has_chunks && timing_.has_line_status &&
                               settings_.trigger_edge == rig::TriggerEdge::kAny;
}

SimCamera::~SimCamera() = default;

rig::Result<void> SimCamera::arm(const std::vector<microseconds>& bracket_exposures,
                                 int frame_count) {
  if (is_lost_) return tl::unexpected(lost());
  if (is_armed_) return rig::failure(rig::Fault::kBusy, "the camera is armed; disarm it first");
  const bool is_count_possible = !bracket_exposures.empty() &&
                                 bracket_exposures.size() <= ExposureEngine::kSetCount &&
                                 frame_count > 0;
  const bool can_expose =
      std::all_of(bracket_exposures.begin(), bracket_exposures.end(), [](microseconds exposure) {
        return exposure > microseconds(0) && exposure <= kLongestExposure;
      });
  if (!is_count_possible || !can_expose)
    return rig::failure(rig::Fault::kOutOfRange,
                        "the camera takes 1 to 8 exposures of at most 10 s each");
  if (settings_.bracketing == rig::Bracketing::kSequencer && bracket_exposures.size() > 1 &&
      !timing_.has_chunks)
    return rig::failure(rig::Fault::kUnsupported,
                        "a sequencer without the exposure chunk; set camera.bracketing to "
                        "trigger_width");
  engine_.bracketing = settings_.bracketing;
  engine_.is_sequencer_on = settings_.bracketing == rig::Bracketing::kSequencer;
  for (std::size_t set = 0; set < bracket_exposures.size(); ++set)
    engine_.sets[set] = {bracket_exposures[set],
                         static_cast<int>((set + 1) % bracket_exposures.size())};
  engine_.start_set = 0;
  engine_.start();
  const std::size_t sample_bytes = is_8_bit(settings_.pixel_format) ? 1 : 2;
  pool_ = std::make_shared<FramePool>(frame_count, sample_count(world_) * sample_bytes);
  counters_ = {};
  block_id_ = 0;
  ++arming_number_;
  is_armed_ = true;
  if (is_the_trigger_) {
    faults_.set_flips_per_showing(static_cast<int>(bracket_exposures.size()));
    faults_.armed();
  }
  return {};
}

void SimCamera::disarm() noexcept {
  is_armed_ = false;
  if (is_the_trigger_) faults_.disarmed();
  ++arming_number_;
}

rig::Result<rig::CameraCounters> SimCamera::counters() {
  if (is_lost_) return tl::unexpected(lost());
  counters_.trigger_count = static_cast<std::int64_t>(engine_.trigger_count());
  counters_.missed_trigger_count = static_cast<std::int64_t>(engine_.missed_count());
  return counters_;
}

void SimCamera::be_the_trigger(rig::EventSink& sink, std::function<void()> pulse) {
  sink_ = &sink;
  software_pulse_ = std::move(pulse);
  is_the_trigger_ = true;
}

rig::Result<rig::CameraClockSample> SimCamera::read_clock() {
  if (is_lost_) return tl::unexpected(lost());
  return rig::CameraClockSample{camera_time(timeline_.now()), timeline_.now(), nanoseconds(0)};
}

rig::Result<void> SimCamera::trigger_software() {
  if (is_lost_) return tl::unexpected(lost());
  if (!is_armed_) return rig::failure(rig::Fault::kBusy, "the camera is not armed");
  if (settings_.trigger_line != rig::kSoftwareTrigger)
    return rig::failure(rig::Fault::kUnsupported,
                        "the trigger line is " + settings_.trigger_line + ", not Software");
  software_pulse_();
  return {};
}

void SimCamera::pulse(const LinePulse& pulse) {
  const ShotFaults faults = faults_.take_shot();
  if (faults.is_trigger_missed) return;
  take(pulse, faults);
  if (faults.is_trigger_bounced) engine_.trigger(pulse.start + kBounceDelay, pulse.width);
}

void SimCamera::take(const LinePulse& pulse, const ShotFaults& faults) {
  step_clock(faults.clock_step);
  if (!is_armed_ || is_lost_) return;
  if (faults.is_sequencer_slipping) engine_.slip();
  auto job = engine_.trigger(pulse.start, pulse.width);
  if (!job) return;
  // A pulse's width is its own; what a timer keeps can stick.
  if (faults.is_exposure_stuck && engine_.is_sequencer_on && last_exposure_.count() > 0)
    job->duration = last_exposure_;
  last_exposure_ = job->duration;
  timeline_.schedule(job->end(),
                     [this, shot = Shot{*job, faults, is_line_high_}, arming = arming_number_] {
                       if (arming == arming_number_) finish(shot);
                     });
  if (!faults.is_trigger_doubled) return;
  timeline_.schedule(job->end() + timing_.readout + kBounceDelay, [this] { disturb_line(); });
}

void SimCamera::disturb_line() { take({timeline_.now(), kStrayPulse}, {}); }

// The shutter has closed: the light that fell in is known.
void SimCamera::finish(const Shot& shot) {
  auto buffer = pool_->take();
  ++block_id_;
  if (!buffer || shot.faults.is_lost || is_cable_pulled_) {
    if (buffer) pool_->give_back(std::move(*buffer));
    return;
  }
  expose(shot.job, *buffer);
  send(shot, std::move(*buffer));
}

std::optional<int> SimCamera::resend_rounds(const ShotFaults& faults,
                                            std::size_t byte_count) const {
  const int packet_count = static_cast<int>(byte_count / kPacketBytes) + 3;  // leader, trailer
  std::mt19937_64 random(faults.loss_seed);
  int missing_count = packet_count;
  int round = 0;
  for (; missing_count > 0 && round <= kResendRoundLimit; ++round) {
    int lost_count = 0;
    for (int packet = 0; packet < missing_count; ++packet)
      if (static_cast<double>(random() >> 11) * 0x1p-53 < faults.loss_frac) ++lost_count;
    missing_count = lost_count;
  }
  if (missing_count > 0) return std::nullopt;
  const bool is_end_lost = faults.is_leader_lost || faults.is_trailer_lost;
  return std::max(round - 1, is_end_lost ? 1 : 0);
}

void SimCamera::send(const Shot& shot, std::vector<std::byte> pixels) {
  const auto rounds = resend_rounds(shot.faults, pixels.size());
  // One frame after the other; what is late by a fault does not hold up the next.
  link_free_ = std::max(link_free_, shot.job.end() + timing_.readout) + timing_.transfer;
  const rig::HostTime arrival =
      link_free_ + shot.faults.delay + rounds.value_or(kResendRoundLimit) * kResendRound;
  if (shot.faults.is_duplicated) {
    if (auto copy = pool_->take()) {
      *copy = pixels;
      deliver(arrival, shot, std::move(*copy));
    }
  }
  if (rounds && !shot.faults.is_truncated) return deliver(arrival, shot, std::move(pixels));
  pool_->give_back(std::move(pixels));
  timeline_.schedule(arrival, [this, block_id = block_id_, arming = arming_number_] {
    if (arming != arming_number_) return;
    ++counters_.damaged_frame_count;
    sink_->post(rig::FrameDamaged{block_id, {rig::Fault::kFrameIncomplete, "packets are missing"}});
  });
}

void SimCamera::deliver(rig::HostTime arrival, const Shot& shot, std::vector<std::byte> pixels) {
  // shared: std::function must be copyable, a frame is not
  const auto frame = std::make_shared<rig::Frame>(make_frame(shot, std::move(pixels)));
  timeline_.schedule(arrival, [this, frame, arming = arming_number_] {
    if (arming != arming_number_ || is_cable_pulled_) return;
    frame->received = timeline_.now();
    ++counters_.delivered_frame_count;
    sink_->post(rig::FrameArrived{std::move(*frame)});
  });
}

void SimCamera::lose() {
  if (std::exchange(is_lost_, true)) return;
  disarm();
  sink_->post(rig::DeviceFault{rig::Device::kCamera, lost()});
}

void SimCamera::power_off() {
  is_powered_ = false;
  lose();
}

void SimCamera::power_on() {
  is_powered_ = true;
  power_up_ = timeline_.now();
  clock_step_ = nanoseconds(0);
}

void SimCamera::give_control_back() { is_controlled_by_other_ = false; }

rig::Result<void> SimCamera::open_again() {
  if (!is_powered_ || is_cable_pulled_)
    return rig::failure(rig::Fault::kNotFound, "no camera answers; see its power and its cable");
  if (is_controlled_by_other_)
    return rig::failure(rig::Fault::kAccessDenied, "another program controls the camera; end it");
  disarm();
  is_lost_ = false;
  ++cable_number_;  // the patience of before is void
  return {};
}

void SimCamera::steal_control() {
  is_controlled_by_other_ = true;
  disarm();  // the other program stops the acquisition
  timeline_.schedule(timeline_.now() + kControlCheckPeriod, [this] { lose(); });
}

void SimCamera::pull_cable() {
  is_cable_pulled_ = true;
  timeline_.schedule(timeline_.now() + kHeartbeatPatience, [this, pull = ++cable_number_] {
    if (pull == cable_number_) lose();
  });
}

void SimCamera::plug_cable_in() {
  is_cable_pulled_ = false;
  ++cable_number_;
}

rig::Frame SimCamera::make_frame(const Shot& shot, std::vector<std::byte> pixels) const {
  const ExposureJob& job = shot.job;
  auto lease = std::make_unique<PoolLease>(pool_, std::move(pixels));
  rig::Frame frame;
  frame.pixels = lease->buffer();
  frame.width_px = world_.width_px();
  frame.height_px = world_.height_px();
  frame.pixel_format = settings_.pixel_format;
  frame.block_id = block_id_;
  frame.timestamp = camera_time(job.start);
  if (timing_.has_chunks) {
    frame.exposure = job.duration;
    frame.trigger_count = job.trigger_number;
    if (job.sequencer_set >= 0) frame.sequencer_set = job.sequencer_set;
    if (identity_.tells_line_level) frame.is_line_high = shot.is_line_high;
  }
  frame.lease = std::move(lease);
  return frame;
}

void SimCamera::expose(const ExposureJob& job, std::vector<std::byte>& pixels) const {
  estimation::Image<std::uint16_t> frame_dn(world_.height_px(), world_.width_px(),
                                            world_.channel_count());
  world_.expose({light_.between(job.start - world_.lamp_timing().scanout, job.end()), job.duration,
                 job.start.time_since_epoch(), job.trigger_number},
                frame_dn.view());
  const auto samples = frame_dn.samples();
  if (is_8_bit(settings_.pixel_format))
    std::transform(samples.begin(), samples.end(), pixels.begin(),
                   [](std::uint16_t dn) { return static_cast<std::byte>(dn); });
  else
    std::memcpy(pixels.data(), samples.data(), samples.size_bytes());
}

rig::CameraClock::time_point SimCamera::camera_time(rig::HostTime time) const {
  const auto since_power_up =
      static_cast<double>(std::chrono::duration_cast<nanoseconds>(time - power_up_).count());
  return rig::CameraClock::time_point(
      timing_.clock_start + clock_step_ +
      nanoseconds(std::llround(since_power_up * (1 + timing_.clock_drift_ppm * 1e-6))));
}

}  // namespace hw_sim
