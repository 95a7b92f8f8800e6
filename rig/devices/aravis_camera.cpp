#include "rig/devices/aravis_camera.h"

#include <arv.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <future>
#include <thread>
#include <utility>

#include "rig/devices/aravis_exposures.h"
#include "rig/devices/aravis_features.h"
#include "rig/devices/aravis_setup.h"
#include "rig/devices/aravis_stream.h"
#include "rig/devices/camera_answers.h"
#include "rig/devices/camera_loss.h"

namespace rig {
namespace {

// Frames the session thread may hold beside those a capture asks for.
constexpr int kSpareBuffers = 8;
// For the last holder of a dead camera to let go of it.
constexpr std::chrono::milliseconds kReleasePatience{1000}, kReleasePeriod{1};
// For the answer to AcquisitionStop, which comes in a millisecond from a camera that lives.
constexpr std::chrono::milliseconds kStopPatience{1000};

// How the clock is read: SFNC's names, and those of GigE Vision 1 (SFNC before 2.0).
struct ClockNames {
  const char* latch;
  const char* value;
  bool is_in_ns;
};
constexpr std::array<ClockNames, 2> kClockNames{
    {{"TimestampLatch", "TimestampLatchValue", true},
     {"GevTimestampControlLatch", "GevTimestampValue", false}}};

}  // namespace

class AravisCamera::Impl {
 public:
  Impl(CameraSettings settings, EventSink& sink, GObjectPtr<ArvCamera> camera);
  ~Impl();

  Result<void> configure(const std::optional<CameraPast>& past);
  Result<void> arm(const std::vector<std::chrono::microseconds>& exposures, int frame_count);
  void disarm() noexcept;
  Result<CameraCounters> counters();
  Result<CameraClockSample> read_clock();
  Result<void> trigger_software();

  const CameraIdentity& identity() const { return setup_.identity; }
  CameraPast past() const { return {setup_.identity, setup_.look}; }
  int packet_size_bytes() const { return setup_.packet_size_bytes; }

 private:
  Result<std::shared_ptr<FrameMemory>> take_memory(int frame_count, std::size_t payload_bytes);
  Result<void> start_acquisition(int frame_count);
  void stop_acquisition();
  Result<std::int64_t> trigger_count();
  Result<double> tick_ns();

  // kDeviceLost also latches: nothing is asked of a dead camera twice.
  template <typename T>
  Result<T> noting_loss(Result<T> result) {
    if (!result && result.error().fault == Fault::kDeviceLost)
      loss_->report(name_of(settings_) + " no longer answers");
    return result;
  }
  // The same, and: the camera was ours when it was opened, and nothing that is asked of it in this
  // way is ever locked, so that who is denied it has lost the control.
  Result<void> noting_theft(Result<void> result) {
    if (result || result.error().fault != Fault::kAccessDenied) return noting_loss(result);
    loss_->report("another program took the control of " + name_of(settings_));
    return tl::unexpected(lost_error());
  }
  Error lost_error() const {
    return {Fault::kDeviceLost, name_of(settings_) + " is lost; open it anew"};
  }

  const CameraSettings settings_;
  EventSink& sink_;
  GObjectPtr<ArvCamera> camera_;
  AravisFeatures features_;
  std::shared_ptr<LossLatch>
      loss_;  // shared with Aravis' heartbeat thread, which may still be in it
  gulong loss_handler_ = 0;
  AravisSetup setup_;
  std::int64_t trigger_base_ = 0;
  std::int64_t missed_base_ = 0;
  std::shared_ptr<FrameMemory> memory_;       // shared with leases
  std::unique_ptr<Acquisition> acquisition_;  // while armed
  std::jthread teardown_;  // stops a camera and takes its stream apart: seconds, if it is dead
};

AravisCamera::Impl::Impl(CameraSettings settings, EventSink& sink, GObjectPtr<ArvCamera> camera)
    : settings_(std::move(settings)),
      sink_(sink),
      camera_(std::move(camera)),
      features_(camera_.get()),
      loss_(std::make_shared<LossLatch>(sink)) {
  auto* shared_latch = new std::shared_ptr<LossLatch>(loss_);  // deleted with the closure
  const auto on_lost = +[](ArvDevice*, gpointer latch) {
    (*static_cast<std::shared_ptr<LossLatch>*>(latch))
        ->report("the camera stopped answering or gave its control to somebody else");
  };
  const auto release =
      +[](gpointer latch, GClosure*) { delete static_cast<std::shared_ptr<LossLatch>*>(latch); };
  loss_handler_ = g_signal_connect_data(arv_camera_get_device(camera_.get()), "control-lost",
                                        G_CALLBACK(on_lost), shared_latch, release,
                                        static_cast<GConnectFlags>(0));
}

AravisCamera::Impl::~Impl() {
  disarm();
  teardown_ = {};
  loss_->close();
  g_signal_handler_disconnect(arv_camera_get_device(camera_.get()), loss_handler_);
  // The heartbeat thread may still be telling of the loss, and holds the device while it does. Who
  // lets go last joins that thread: were it the thread itself, GLib would abort the program. There
  // is nothing to wait on but the count; a device that is held for ever is better leaked.
  auto* const device = G_OBJECT(g_object_ref(arv_camera_get_device(camera_.get())));
  camera_.reset();
  const HostTime patience = HostClock::now() + kReleasePatience;
  while (g_atomic_int_get(&device->ref_count) > 1 && HostClock::now() < patience)
    std::this_thread::sleep_for(kReleasePeriod);
  if (g_atomic_int_get(&device->ref_count) == 1) g_object_unref(device);
}

Result<void> AravisCamera::Impl::configure(const std::optional<CameraPast>& past) {
  Result<AravisSetup> setup = noting_loss(set_up(camera_.get(), settings_, past));
  if (!setup) return tl::unexpected(setup.error());
  setup_ = std::move(*setup);
  return {};
}

Result<void> AravisCamera::Impl::arm(const std::vector<std::chrono::microseconds>& exposures,
                                     int frame_count) {
  if (loss_->is_lost()) return tl::unexpected(lost_error());
  if (acquisition_) return failure(Fault::kBusy, "the camera is armed already; disarm it first");
  if (exposures.empty() || frame_count < 1)
    return failure(Fault::kOutOfRange, "arming needs at least one exposure and one frame");
  teardown_ = {};  // of a camera that lives: no more than its stream is under way
  const bool has_exposure_chunk = !setup_.chunks.exposure.empty();
  return noting_theft(in_order(
      [&] { return set_exposures(features_, settings_, has_exposure_chunk, exposures); },
      [&] { return features_.answered(); }, [&] { return start_acquisition(frame_count); }));
}

Result<std::shared_ptr<FrameMemory>> AravisCamera::Impl::take_memory(int frame_count,
                                                                     std::size_t payload_bytes) {
  const auto block_count = static_cast<std::size_t>(frame_count) + kSpareBuffers;
  // Leases of an earlier acquisition may still read theirs.
  const bool is_usable = memory_ && memory_.use_count() == 1 &&
                         memory_->block_bytes() == payload_bytes &&
                         memory_->block_count() == block_count;
  if (is_usable) return memory_;
  memory_.reset();
  return FrameMemory::allocate(block_count, payload_bytes);
}

Result<void> AravisCamera::Impl::start_acquisition(int frame_count) {
  GError* error = nullptr;
  setup_.format.payload_bytes = arv_camera_get_payload(camera_.get(), &error);
  if (auto read = take_error(&error, "reading PayloadSize"); !read) return read;
  if (auto fits = check_payload(setup_.format.payload_bytes, setup_.format.image_bytes()); !fits)
    return fits;
  Result<std::shared_ptr<FrameMemory>> memory =
      take_memory(frame_count, setup_.format.payload_bytes);
  if (!memory) return tl::unexpected(memory.error());
  memory_ = *memory;
  Result<GObjectPtr<ArvStream>> stream = open_stream(camera_.get());
  if (!stream) return tl::unexpected(stream.error());
  auto acquisition = std::make_unique<Acquisition>(
      Acquisition::Parts{.stream = std::move(*stream),
                         .chunks = ChunkReader(GObjectPtr<ArvChunkParser>(
                                                   arv_camera_create_chunk_parser(camera_.get())),
                                               setup_.chunks),
                         .memory = memory_,
                         .format = setup_.format,
                         .frame_count = frame_count},
      sink_);
  if (features_.has("CounterReset") && setup_.has_trigger_counter)
    if (auto reset = features_.execute("CounterReset"); !reset) return reset;
  arv_camera_start_acquisition(camera_.get(), &error);
  if (auto started = take_error(&error, "starting the acquisition"); !started) return started;
  // No pulse comes before arm() returns, so this is where both counters stand at zero pulses.
  const Result<std::int64_t> base = trigger_count();
  if (!base) {  // else it would run on, and be locked at the next arming
    arv_camera_stop_acquisition(camera_.get(), &error);
    g_clear_error(&error);
    return tl::unexpected(base.error());
  }
  trigger_base_ = *base;
  missed_base_ = features_.integer("TriggerMissedCount").value_or(0);
  acquisition_ = std::move(acquisition);
  acquisition_->start(trigger_base_);
  return {};
}

// 0 where the camera has no such counter.
Result<std::int64_t> AravisCamera::Impl::trigger_count() {
  return setup_.has_trigger_counter ? features_.integer("CounterValue") : 0;
}

void AravisCamera::Impl::disarm() noexcept {
  if (!acquisition_) return;
  acquisition_->stop();
  if (!loss_->is_lost()) return stop_acquisition();
  teardown_ = std::jthread([doomed = std::move(acquisition_)]() mutable { doomed.reset(); });
}

// A dead camera is not waited for as long as Aravis does: 2.5 s. It is told as lost instead.
void AravisCamera::Impl::stop_acquisition() {
  std::promise<Result<void>> answer;
  std::future<Result<void>> answered = answer.get_future();
  teardown_ = std::jthread([camera = camera_.get(), doomed = std::move(acquisition_),
                            answer = std::move(answer)]() mutable {
    GError* error = nullptr;
    arv_camera_stop_acquisition(camera, &error);
    Result<void> stopped = take_error(&error, "stopping the acquisition");
    const bool is_stopped = stopped.has_value();
    if (is_stopped) doomed.reset();
    answer.set_value(std::move(stopped));
    doomed.reset();
  });
  if (answered.wait_for(kStopPatience) == std::future_status::ready)
    static_cast<void>(noting_loss(answered.get()));
  else
    loss_->report(name_of(settings_) + " does not answer");
}

Result<CameraCounters> AravisCamera::Impl::counters() {
  if (loss_->is_lost()) return tl::unexpected(lost_error());
  CameraCounters counters;
  if (acquisition_) {
    counters.delivered_frame_count = acquisition_->delivered_count();
    counters.damaged_frame_count = acquisition_->damaged_count();
    counters.resent_packet_count = acquisition_->resent_packet_count();
  }
  if (setup_.has_trigger_counter) {
    const Result<std::int64_t> count = noting_loss(trigger_count());
    if (!count) return tl::unexpected(count.error());
    counters.trigger_count = counted_since(trigger_base_, *count);
  }
  if (features_.has("TriggerMissedCount")) {
    const Result<std::int64_t> count = noting_loss(features_.integer("TriggerMissedCount"));
    if (!count) return tl::unexpected(count.error());
    counters.missed_trigger_count = counted_since(missed_base_, *count);
  }
  return counters;
}

// Of the clock as GigE Vision 1 counts it; Aravis divides frames' timestamps by the same.
Result<double> AravisCamera::Impl::tick_ns() {
  GError* error = nullptr;
  const guint64 ticks_per_s = arv_gv_device_get_timestamp_tick_frequency(
      ARV_GV_DEVICE(arv_camera_get_device(camera_.get())), &error);
  if (auto read = take_error(&error, "reading the clock's tick frequency"); !read)
    return tl::unexpected(read.error());
  return 1e9 / static_cast<double>(std::max<guint64>(ticks_per_s, 1));
}

// The clock is latched somewhere between asking and being answered.
Result<CameraClockSample> AravisCamera::Impl::read_clock() {
  if (loss_->is_lost()) return tl::unexpected(lost_error());
  for (const ClockNames& names : kClockNames) {
    if (!features_.has(names.latch)) continue;
    const HostTime asked = HostClock::now();
    if (auto latched = noting_theft(features_.execute(names.latch)); !latched)
      return tl::unexpected(latched.error());
    const HostTime answered = HostClock::now();
    const Result<std::int64_t> ticks = noting_loss(features_.integer(names.value));
    if (!ticks) return tl::unexpected(ticks.error());
    const Result<double> ns_per_tick = names.is_in_ns ? 1.0 : noting_loss(tick_ns());
    if (!ns_per_tick) return tl::unexpected(ns_per_tick.error());
    const std::chrono::nanoseconds since_zero(
        std::llround(static_cast<double>(*ticks) * *ns_per_tick));
    return CameraClockSample{CameraClock::time_point(since_zero), asked + (answered - asked) / 2,
                             (answered - asked) / 2};
  }
  return failure(Fault::kUnsupported,
                 "the clock of " + name_of(settings_) +
                     " cannot be read; set sequence.sync to \"trigger_box\" in the rig file");
}

Result<void> AravisCamera::Impl::trigger_software() {
  if (loss_->is_lost()) return tl::unexpected(lost_error());
  if (!acquisition_) return failure(Fault::kBusy, "the camera is not armed");
  if (settings_.trigger_line != kSoftwareTrigger)
    return failure(Fault::kUnsupported,
                   "the trigger line is " + settings_.trigger_line + ", not Software");
  return noting_theft(features_.execute("TriggerSoftware"));
}

AravisCamera::AravisCamera(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
AravisCamera::~AravisCamera() = default;

Result<std::unique_ptr<AravisCamera>> AravisCamera::open(const CameraSettings& settings,
                                                         EventSink& sink,
                                                         const std::optional<CameraPast>& past) {
  GError* error = nullptr;
  GObjectPtr<ArvCamera> camera(arv_camera_new(settings.address.c_str(), &error));
  if (auto opened = take_error(&error, "opening"); !opened || !camera)
    return failure(Fault::kNotFound,
                   "no camera answers at " + settings.address +
                       "; check its cable and power, and camera.address in the rig file" +
                       (opened ? "" : " (" + opened.error().detail + ")"));
  auto impl = std::make_unique<Impl>(settings, sink, std::move(camera));
  if (auto configured = impl->configure(past); !configured)
    return tl::unexpected(configured.error());
  return std::unique_ptr<AravisCamera>(new AravisCamera(std::move(impl)));
}

const CameraIdentity& AravisCamera::identity() const { return impl_->identity(); }

Result<void> AravisCamera::arm(const std::vector<std::chrono::microseconds>& bracket_exposures,
                               int frame_count) {
  return impl_->arm(bracket_exposures, frame_count);
}

void AravisCamera::disarm() noexcept { impl_->disarm(); }

Result<CameraCounters> AravisCamera::counters() { return impl_->counters(); }

Result<CameraClockSample> AravisCamera::read_clock() { return impl_->read_clock(); }

Result<void> AravisCamera::trigger_software() { return impl_->trigger_software(); }

CameraPast AravisCamera::past() const { return impl_->past(); }

int AravisCamera::packet_size_bytes() const { return impl_->packet_size_bytes(); }

}  // namespace rig
