#include "hw_sim/gige/gige_device.h"

#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <stop_token>
#include <thread>
#include <utility>

#include "hw_sim/gige/big_endian.h"
#include "hw_sim/gige/camera_model.h"
#include "hw_sim/gige/gvcp.h"
#include "hw_sim/gige/pixel_format.h"
#include "hw_sim/gige/socket.h"
#include "hw_sim/gige/stream_sender.h"

namespace hw_sim {
namespace {

constexpr std::size_t kDatagramBytes = 2048;
constexpr std::size_t kDiscoveryBytes = 0xF8;  // the first bootstrap registers, as they stand
constexpr std::size_t kMemoryReadMax = 536;    // GigE Vision 2.0: largest READMEM and WRITEMEM
constexpr std::chrono::milliseconds kControlTick{
    20};  // how soon a kick or a dead client is noticed
constexpr std::uint32_t kFireTestPacket = 0x80000000;
constexpr std::uint32_t kExclusiveAccess = 1;
// A line that bounces or picks up a neighbour's pulse.
constexpr std::chrono::microseconds kBounceDelay{100};
constexpr std::chrono::microseconds kStrayPulse{1000};

bool is_same_peer(const sockaddr_in& a, const sockaddr_in& b) {
  return a.sin_addr.s_addr == b.sin_addr.s_addr && a.sin_port == b.sin_port;
}

rig::Result<void> check_formats(const GigeDeviceOptions& options, const World& world) {
  if (options.pixel_formats.empty())
    return rig::failure(rig::Fault::kConfiguration, "the camera needs at least one pixel format");
  for (const std::string& name : options.pixel_formats) {
    const auto format = find_pixel_format(std::string_view(name));
    if (!format)
      return rig::failure(rig::Fault::kConfiguration,
                          "'" + name +
                              "' is no pixel format that the simulated camera has; it has " +
                              pixel_format_names());
    if (format->channel_count != world.channel_count())
      return rig::failure(
          rig::Fault::kConfiguration,
          name + " does not fit a world of " + std::to_string(world.channel_count()) + " channels");
  }
  return {};
}

}  // namespace

class GigeDevice::Impl {
 public:
  Impl(const GigeDeviceOptions& options, const World& world, const LightTimeline& light,
       Socket control, Socket broadcast, Socket stream);

  void pulse(rig::HostTime start, std::chrono::microseconds width);
  bool line(rig::HostTime time, bool is_high);
  GigeDeviceCounters counters() const;
  float line_debounce_us() const;
  float gain_db() const;
  float black_level_dn() const;
  float balance_ratio(std::size_t colour) const;

  GigeFaults faults;

 private:
  struct LastAnswer {  // a repeated request gets the first answer again and is not done twice
    sockaddr_in peer{};
    std::uint16_t id = 0;
    std::vector<std::uint8_t> bytes;
  };

  void run_control(const std::stop_token& stop);
  void check_control_alive();
  void release_control();
  void receive(const Socket& socket);
  std::vector<std::uint8_t> answer(const GvcpRequest& request, const sockaddr_in& peer);
  std::vector<std::uint8_t> answer_discovery(const GvcpRequest& request);
  std::vector<std::uint8_t> answer_read_registers(const GvcpRequest& request);
  std::vector<std::uint8_t> answer_read_memory(const GvcpRequest& request);
  std::vector<std::uint8_t> answer_write_registers(const GvcpRequest& request,
                                                   const sockaddr_in& peer);
  std::vector<std::uint8_t> answer_write_memory(const GvcpRequest& request,
                                                const sockaddr_in& peer);
  GvcpStatus write(std::uint32_t address, std::uint32_t value, const sockaddr_in& peer);
  GvcpStatus write_control_privilege(std::uint32_t value, const sockaddr_in& peer);
  GvcpStatus write_stream_register(std::uint32_t address, std::uint32_t value);
  bool is_controller(const sockaddr_in& peer) const;
  // With mutex_ held, as the following.
  GvcpStatus trigger_software(std::uint32_t value);
  bool tell_of_trigger(rig::HostTime time);
  void tell_of_arming(bool is_armed);
  void shoot(const ShotFaults& planned, rig::HostTime start, std::chrono::microseconds width,
             const std::function<std::optional<Shot>()>& trigger);
  void queue(const Shot& shot);

  void run_exposures(const std::stop_token& stop);
  std::optional<Shot> next_ended_shot(const std::stop_token& stop);
  void expose(const Shot& shot);

  const GigeDeviceOptions options_;
  const World& world_;
  const LightTimeline& light_;
  const Socket control_;
  const Socket broadcast_;
  StreamSender sender_;

  mutable std::mutex mutex_;
  std::condition_variable_any shots_changed_;
  CameraModel model_;                           // guarded by mutex_
  std::deque<Shot> shots_;                      // guarded by mutex_
  std::optional<ExposureJob> last_job_;         // guarded by mutex_
  std::optional<sockaddr_in> controller_;       // guarded by mutex_
  rig::HostTime last_heard_;                    // guarded by mutex_; from the controller
  LastAnswer last_answer_;                      // used by the control thread only
  estimation::Image<std::uint16_t> sensor_dn_;  // used by the exposure thread only
  std::jthread exposure_thread_;
  std::jthread control_thread_;
};

GigeDevice::Impl::Impl(const GigeDeviceOptions& options, const World& world,
                       const LightTimeline& light, Socket control, Socket broadcast, Socket stream)
    : options_(options),
      world_(world),
      light_(light),
      control_(std::move(control)),
      broadcast_(std::move(broadcast)),
      sender_(std::move(stream), options.link_rate_bit_per_s, faults),
      model_({.serial = options.serial,
              .address = options.address,
              .width_px = world.width_px(),
              .height_px = world.height_px(),
              .pixel_formats = options.pixel_formats,
              .has_any_edge = options.has_any_edge,
              .has_debouncer = options.has_debouncer,
              .has_line_status = options.has_line_status,
              .variant = options.variant},
             options.readout,
             {.power_up = rig::HostClock::now(),
              .offset = options.clock_offset,
              .drift_ppm = options.clock_drift_ppm}),
      sensor_dn_(world.height_px(), world.width_px(), world.channel_count()),
      exposure_thread_([this](const std::stop_token& stop) { run_exposures(stop); }),
      control_thread_([this](const std::stop_token& stop) { run_control(stop); }) {}

void GigeDevice::Impl::pulse(rig::HostTime start, std::chrono::microseconds width) {
  const ShotFaults planned =
      options_.faults != nullptr ? options_.faults->take_shot() : ShotFaults{};
  if (take_one(faults.unseen_pulses) || planned.is_trigger_missed) return;
  const std::lock_guard lock(mutex_);
  if (width.count() > 0) {
    model_.set_line(start, true);
    model_.set_line(start + width, false);
  }
  shoot(planned, start, width, [&] { return model_.pulse(start, width); });
}

bool GigeDevice::Impl::line(rig::HostTime time, bool is_high) {
  bool is_beginning = false;
  {
    const std::lock_guard lock(mutex_);
    model_.set_line(time, is_high);
    if (!model_.is_trigger(is_high)) return false;
    is_beginning = tell_of_trigger(time);
  }
  pulse(time, {});
  return is_beginning;
}

GvcpStatus GigeDevice::Impl::trigger_software(std::uint32_t value) {
  const rig::HostTime now = rig::HostClock::now();
  tell_of_trigger(now);
  const bool has_plan = options_.is_the_trigger && options_.faults != nullptr;
  const ShotFaults planned = has_plan ? options_.faults->take_shot() : ShotFaults{};
  if (planned.is_trigger_missed) return GvcpStatus::kSuccess;
  GvcpStatus status = GvcpStatus::kSuccess;
  shoot(planned, now, {}, [&] {
    status = model_.write(kTriggerSoftware, value, now);
    return model_.take_software_shot();
  });
  return status;
}

// How far the capture is: the sequencer knows. True at the first exposure of its round.
bool GigeDevice::Impl::tell_of_trigger(rig::HostTime time) {
  const bool is_one_too_many = model_.engine().is_busy(time) || !model_.is_acquiring();
  if (!options_.is_the_trigger || options_.faults == nullptr || is_one_too_many) return false;
  const int bracket = model_.engine().is_sequencer_on ? model_.engine().active_set() : 0;
  if (bracket == 0) options_.faults->train_started();
  options_.faults->pulse_started(bracket);
  return bracket == 0;
}

void GigeDevice::Impl::tell_of_arming(bool is_armed) {
  if (!options_.is_the_trigger || options_.faults == nullptr) return;
  if (!is_armed) return options_.faults->disarmed();
  options_.faults->set_flips_per_showing(model_.bracket_count());
  options_.faults->armed();
}

// An exposure, and what is to go wrong with it.
void GigeDevice::Impl::shoot(const ShotFaults& planned, rig::HostTime start,
                             std::chrono::microseconds width,
                             const std::function<std::optional<Shot>()>& trigger) {
  if (take_one(faults.sequencer_slips) || planned.is_sequencer_slipping) model_.slip_sequencer();
  std::optional<Shot> shot = trigger();
  if (shot) {
    shot->faults = planned;
    queue(*shot);
  }
  if (planned.is_trigger_bounced) model_.pulse(start + kBounceDelay, width);
  if (!planned.is_trigger_doubled || !shot) return;
  if (const auto stray =
          model_.pulse(shot->job.end() + options_.readout + kBounceDelay, kStrayPulse))
    queue(*stray);
}

void GigeDevice::Impl::queue(const Shot& shot) {
  Shot queued = shot;
  const bool is_stuck =
      faults.is_exposure_stuck || (shot.faults.is_exposure_stuck && shot.job.sequencer_set >= 0);
  if (is_stuck && last_job_) queued.job.duration = last_job_->duration;
  last_job_ = queued.job;
  shots_.push_back(queued);
  shots_changed_.notify_one();
}

GigeDeviceCounters GigeDevice::Impl::counters() const {
  const StreamCounters stream = sender_.counters();
  const std::lock_guard lock(mutex_);
  return {.trigger_count = model_.engine().trigger_count(),
          .missed_trigger_count = model_.engine().missed_count(),
          .sent_frame_count = stream.sent_frame_count,
          .sent_packet_count = stream.sent_packet_count,
          .resent_packet_count = stream.resent_packet_count,
          .lost_packet_count = stream.lost_packet_count};
}

float GigeDevice::Impl::gain_db() const {
  const std::lock_guard lock(mutex_);
  return model_.registers().get_float(kGain);
}

float GigeDevice::Impl::black_level_dn() const {
  const std::lock_guard lock(mutex_);
  return model_.registers().get_float(kBlackLevel);
}

float GigeDevice::Impl::balance_ratio(std::size_t colour) const {
  const std::lock_guard lock(mutex_);
  return model_.balance_ratio(colour);
}

float GigeDevice::Impl::line_debounce_us() const {
  const std::lock_guard lock(mutex_);
  return model_.registers().get_time_us(kLineDebouncerTime);
}

void GigeDevice::Impl::run_control(const std::stop_token& stop) {
  run_like_hardware();
  {
    const std::lock_guard lock(mutex_);
    model_.registers().set(kStreamSourcePort, sender_.source_port());
  }
  std::array<pollfd, 2> waited{{{control_.fd(), POLLIN, 0}, {broadcast_.fd(), POLLIN, 0}}};
  while (!stop.stop_requested()) {
    poll(waited.data(), waited.size(), static_cast<int>(kControlTick.count()));
    check_control_alive();
    if ((waited[0].revents & POLLIN) != 0) receive(control_);
    if ((waited[1].revents & POLLIN) != 0) receive(broadcast_);
  }
}

void GigeDevice::Impl::check_control_alive() {
  const std::lock_guard lock(mutex_);
  const std::chrono::milliseconds timeout(model_.registers().get(kHeartbeatTimeout));
  const bool is_silent = controller_ && rig::HostClock::now() - last_heard_ > timeout;
  if (faults.is_control_kicked.exchange(false) || is_silent) release_control();
}

void GigeDevice::Impl::release_control() {
  controller_.reset();
  model_.stop_acquisition();
  tell_of_arming(false);
  model_.registers().set(kControlPrivilege, 0);
  model_.registers().set(kPrimaryPort, 0);
  model_.registers().set(kPrimaryAddress, 0);
  model_.registers().set(kStreamPort, 0);
  sender_.set_destination(0, 0);
}

void GigeDevice::Impl::receive(const Socket& socket) {
  std::array<std::uint8_t, kDatagramBytes> datagram;
  sockaddr_in peer{};
  socklen_t peer_length = sizeof peer;
  const ssize_t bytes = recvfrom(socket.fd(), datagram.data(), datagram.size(), MSG_DONTWAIT,
                                 reinterpret_cast<sockaddr*>(&peer), &peer_length);
  if (bytes <= 0 || faults.is_mute) return;
  const auto request = parse_gvcp(std::span(datagram).first(static_cast<std::size_t>(bytes)));
  if (!request) return;
  if (request->command == static_cast<std::uint16_t>(GvcpCommand::kPacketResend)) {
    if (const auto resend = parse_resend(*request))
      sender_.resend(*resend, request->has_64_bit_block_id);
    return;
  }
  const bool is_repeated = request->id == last_answer_.id && is_same_peer(peer, last_answer_.peer);
  if (!is_repeated)
    last_answer_ = {.peer = peer, .id = request->id, .bytes = answer(*request, peer)};
  if (!request->is_acknowledge_wanted || last_answer_.bytes.empty()) return;
  sendto(control_.fd(), last_answer_.bytes.data(), last_answer_.bytes.size(), 0,
         reinterpret_cast<sockaddr*>(&peer), peer_length);
}

std::vector<std::uint8_t> GigeDevice::Impl::answer(const GvcpRequest& request,
                                                   const sockaddr_in& peer) {
  const std::lock_guard lock(mutex_);
  if (is_controller(peer)) last_heard_ = rig::HostClock::now();
  const bool is_locked_out = controller_ && !is_controller(peer) &&
                             model_.registers().get(kControlPrivilege) == kExclusiveAccess;
  switch (static_cast<GvcpCommand>(request.command)) {
    case GvcpCommand::kDiscovery:
      return answer_discovery(request);
    case GvcpCommand::kReadRegister:
      if (is_locked_out) return make_acknowledge(request, GvcpStatus::kAccessDenied, {});
      return answer_read_registers(request);
    case GvcpCommand::kReadMemory:
      if (is_locked_out) return make_acknowledge(request, GvcpStatus::kAccessDenied, {});
      return answer_read_memory(request);
    case GvcpCommand::kWriteRegister:
      return answer_write_registers(request, peer);
    case GvcpCommand::kWriteMemory:
      return answer_write_memory(request, peer);
    default:
      return make_acknowledge(request, GvcpStatus::kNotImplemented, {});
  }
}

std::vector<std::uint8_t> GigeDevice::Impl::answer_discovery(const GvcpRequest& request) {
  std::array<std::uint8_t, kDiscoveryBytes> content;
  const GvcpStatus status = model_.read(0, content);
  return make_acknowledge(request, status, content);
}

std::vector<std::uint8_t> GigeDevice::Impl::answer_read_registers(const GvcpRequest& request) {
  std::vector<std::uint8_t> content;
  for (std::size_t i = 0; i + 4 <= request.payload.size(); i += 4) {
    std::array<std::uint8_t, 4> word;
    const GvcpStatus status = model_.read(get32(&request.payload[i]), word);
    if (status != GvcpStatus::kSuccess) return make_acknowledge(request, status, content);
    content.insert(content.end(), word.begin(), word.end());
  }
  return make_acknowledge(request, GvcpStatus::kSuccess, content);
}

std::vector<std::uint8_t> GigeDevice::Impl::answer_read_memory(const GvcpRequest& request) {
  if (request.payload.size() < 8)
    return make_acknowledge(request, GvcpStatus::kInvalidParameter, {});
  const std::size_t byte_count = get16(&request.payload[6]);
  if (byte_count > kMemoryReadMax)
    return make_acknowledge(request, GvcpStatus::kInvalidParameter, {});
  std::vector<std::uint8_t> content(4 + byte_count);
  const std::uint32_t address = get32(&request.payload[0]);
  put32(content.data(), address);
  const GvcpStatus status = model_.read(address, std::span(content).subspan(4));
  if (status != GvcpStatus::kSuccess) content.clear();
  return make_acknowledge(request, status, content);
}

std::vector<std::uint8_t> GigeDevice::Impl::answer_write_registers(const GvcpRequest& request,
                                                                   const sockaddr_in& peer) {
  std::array<std::uint8_t, 4> done_count{};
  GvcpStatus status = GvcpStatus::kSuccess;
  std::uint32_t done = 0;
  for (std::size_t i = 0; i + 8 <= request.payload.size() && status == GvcpStatus::kSuccess;
       i += 8) {
    status = write(get32(&request.payload[i]), get32(&request.payload[i + 4]), peer);
    if (status == GvcpStatus::kSuccess) ++done;
  }
  put32(done_count.data(), done);
  return make_acknowledge(request, status, done_count);
}

std::vector<std::uint8_t> GigeDevice::Impl::answer_write_memory(const GvcpRequest& request,
                                                                const sockaddr_in& peer) {
  std::array<std::uint8_t, 4> done_count{};
  if (request.payload.size() < 8)
    return make_acknowledge(request, GvcpStatus::kInvalidParameter, done_count);
  const std::uint32_t address = get32(&request.payload[0]);
  GvcpStatus status = GvcpStatus::kSuccess;
  std::uint32_t done = 0;
  for (std::size_t i = 4; i + 4 <= request.payload.size() && status == GvcpStatus::kSuccess;
       i += 4) {
    status = write(address + done, get32(&request.payload[i]), peer);
    if (status == GvcpStatus::kSuccess) done += 4;
  }
  put32(done_count.data(), done);
  return make_acknowledge(request, status, done_count);
}

GvcpStatus GigeDevice::Impl::write(std::uint32_t address, std::uint32_t value,
                                   const sockaddr_in& peer) {
  if (address == kControlPrivilege) return write_control_privilege(value, peer);
  if (!is_controller(peer)) return GvcpStatus::kAccessDenied;
  if (address >= kStreamPort && address <= kStreamSourcePort)
    return write_stream_register(address, value);
  if (address == kAcquisitionStart || address == kAcquisitionStop) {
    sender_.end_acquisition();
    shots_.clear();
    shots_changed_.notify_one();
  }
  if (address == kTriggerSoftware) return trigger_software(value);
  const GvcpStatus status = model_.write(address, value, rig::HostClock::now());
  if (address == kAcquisitionStart || address == kAcquisitionStop)
    tell_of_arming(model_.is_acquiring());
  return status;
}

GvcpStatus GigeDevice::Impl::write_control_privilege(std::uint32_t value, const sockaddr_in& peer) {
  if ((controller_ && !is_controller(peer)) || faults.is_control_taken)
    return GvcpStatus::kAccessDenied;
  const GvcpStatus status = model_.registers().check_write(kControlPrivilege, value);
  if (status != GvcpStatus::kSuccess) return status;
  if (value == 0) {
    release_control();
    return status;
  }
  controller_ = peer;
  last_heard_ = rig::HostClock::now();
  if (options_.faults != nullptr) options_.faults->opened();
  model_.registers().set(kControlPrivilege, value);
  model_.registers().set(kPrimaryPort, ntohs(peer.sin_port));
  model_.registers().set(kPrimaryAddress, ntohl(peer.sin_addr.s_addr));
  return status;
}

GvcpStatus GigeDevice::Impl::write_stream_register(std::uint32_t address, std::uint32_t value) {
  RegisterMap& registers = model_.registers();
  const GvcpStatus status = registers.check_write(address, value);
  if (status != GvcpStatus::kSuccess) return status;
  if (address != kStreamPacketSize) {
    registers.set(address, value);
    sender_.set_destination(registers.get(kStreamAddress),
                            static_cast<std::uint16_t>(registers.get(kStreamPort)));
    return status;
  }
  const std::uint32_t packet_size_bytes = value & 0xFFFF;
  if (packet_size_bytes < kPacketSizeMin || packet_size_bytes > kPacketSizeMax)
    return GvcpStatus::kInvalidParameter;
  registers.set(address, value & ~kFireTestPacket);
  if ((value & kFireTestPacket) != 0) sender_.fire_test_packet(packet_size_bytes);
  return status;
}

bool GigeDevice::Impl::is_controller(const sockaddr_in& peer) const {
  return controller_ && is_same_peer(*controller_, peer);
}

void GigeDevice::Impl::run_exposures(const std::stop_token& stop) {
  while (const std::optional<Shot> shot = next_ended_shot(stop)) expose(*shot);
}

// The next shot once its exposure and readout are over; nullopt on stop.
std::optional<Shot> GigeDevice::Impl::next_ended_shot(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (shots_changed_.wait(lock, stop, [this] { return !shots_.empty(); })) {
    const Shot shot = shots_.front();
    const rig::HostTime due = shot.job.end() + std::max(options_.readout, options_.light_latency);
    // Woken early when an AcquisitionStop took the shot away.
    const auto is_withdrawn = [&] {
      return shots_.empty() || shots_.front().job.trigger_number != shot.job.trigger_number ||
             shots_.front().acquisition_number != shot.acquisition_number;
    };
    if (shots_changed_.wait_until(lock, stop, due, is_withdrawn)) continue;
    if (stop.stop_requested()) return std::nullopt;
    shots_.pop_front();
    return shot;
  }
  return std::nullopt;
}

void GigeDevice::Impl::expose(const Shot& shot) {
  const Exposure exposure{
      .light = light_.between(shot.job.start - world_.lamp_timing().scanout, shot.job.end()),
      .duration = shot.job.duration,
      .start = shot.job.start.time_since_epoch(),
      .trigger_number = shot.job.trigger_number};
  world_.expose(exposure, sensor_dn_.view());
  std::shared_ptr<GvspBlock> block = sender_.take_block();
  // Locked to the end: a frame of one acquisition must not enter the next.
  const std::lock_guard lock(mutex_);
  if (!model_.is_acquiring() || model_.acquisition_number() != shot.acquisition_number) return;
  if (take_one(faults.timestamp_jumps)) model_.jump_clock(std::chrono::seconds(1));
  model_.jump_clock(shot.faults.clock_step);
  model_.fill_block(shot, sensor_dn_.view(), options_.has_64_bit_block_ids, *block);
  if (take_one(faults.wrong_size_frames)) block->height_px /= 2;
  if (take_one(faults.padded_frames)) block->line_padding_bytes = 4;
  if (take_one(faults.wrong_format_frames)) block->pixel_format = find_pixel_format("Mono8")->code;
  const bool is_late = take_one(faults.late_frames);
  const std::chrono::milliseconds delay =
      is_late ? std::chrono::milliseconds(faults.late_frame_ms) : shot.faults.delay;
  block->faults = shot.faults;
  sender_.send(std::move(block), rig::HostClock::now() + delay);
}

GigeDevice::GigeDevice(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
GigeDevice::~GigeDevice() = default;

rig::Result<std::unique_ptr<GigeDevice>> GigeDevice::start(const GigeDeviceOptions& options,
                                                           const World& world,
                                                           const LightTimeline& light) {
  if (auto checked = check_formats(options, world); !checked)
    return tl::unexpected(checked.error());
  auto control = Socket::bind_udp(options.address, kGvcpPort, false);
  if (!control) return tl::unexpected(control.error());
  auto stream = Socket::bind_udp(options.address, 0, false);
  if (!stream) return tl::unexpected(stream.error());
  stream->forbid_fragments();
  // Discovery by broadcast; several devices share it, and a camera opened by address needs none.
  auto broadcast = Socket::bind_udp("255.255.255.255", kGvcpPort, true);
  auto impl =
      std::make_unique<Impl>(options, world, light, std::move(*control),
                             broadcast ? std::move(*broadcast) : Socket(), std::move(*stream));
  return std::unique_ptr<GigeDevice>(new GigeDevice(std::move(impl)));
}

void GigeDevice::pulse(rig::HostTime start, std::chrono::microseconds width) {
  impl_->pulse(start, width);
}

bool GigeDevice::line(rig::HostTime time, bool is_high) { return impl_->line(time, is_high); }

GigeFaults& GigeDevice::faults() { return impl_->faults; }

GigeDeviceCounters GigeDevice::counters() const { return impl_->counters(); }

float GigeDevice::line_debounce_us() const { return impl_->line_debounce_us(); }

float GigeDevice::gain_db() const { return impl_->gain_db(); }
float GigeDevice::black_level_dn() const { return impl_->black_level_dn(); }
float GigeDevice::balance_ratio(std::size_t colour) const { return impl_->balance_ratio(colour); }

}  // namespace hw_sim
