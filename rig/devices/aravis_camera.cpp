#include "rig/devices/aravis_camera.h"

#include <arpa/inet.h>
#include <arv.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <pthread.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstring>
#include <mutex>
#include <optional>
#include <span>
#include <thread>
#include <utility>

#include "rig/devices/aravis_features.h"
#include "rig/devices/block_id.h"
#include "rig/devices/camera_answers.h"
#include "rig/devices/frame_memory.h"

namespace rig {
namespace {

// Frames the session thread may hold beside those a capture asks for.
constexpr int kSpareBuffers = 8;
constexpr std::chrono::milliseconds kPopTimeout{20};  // how soon the reader notices a stop
// How long Aravis waits for resent packets before it gives a block up; it delivers in order, so
// later blocks wait as long.
constexpr guint kFrameRetentionUs = 300'000;
constexpr gint kSocketBufferBytes = 16 << 20;   // the kernel grants net.core.rmem_max at most
constexpr int kReceiverPriority = 10;           // SCHED_RR, above every ordinary thread
constexpr double kExposureRoundingFrac = 0.01;  // cameras round to their line time
constexpr double kExposureRoundingMinUs = 5;
constexpr double kDebounceRoundingFrac = 0.1;  // to the ticks of some clock of the camera's
constexpr std::uint32_t kPrimaryApplicationAddress = 0x0A14;  // GigE Vision bootstrap register

template <typename T>
struct GObjectUnref {
  void operator()(T* object) const { g_object_unref(object); }
};
template <typename T>
using GObjectPtr = std::unique_ptr<T, GObjectUnref<T>>;

// A chunk under the names that cameras give it: what ChunkSelector calls it and the feature that
// reads it.
struct ChunkName {
  const char* selector;
  const char* feature;
};
constexpr std::chrono::milliseconds kReleasePatience{1000}, kReleasePeriod{1};
constexpr std::array<ChunkName, 1> kExposureChunks{{{"ExposureTime", "ChunkExposureTime"}}};
constexpr std::array<ChunkName, 2> kTriggerChunks{
    {{"CounterValue", "ChunkCounterValue"},
     {"Triggerinputcounter", "ChunkTriggerinputcounter"}}};  // Basler ace, GigE
constexpr std::array<ChunkName, 2> kSetChunks{
    {{"SequencerSetActive", "ChunkSequencerSetActive"},
     {"SequenceSetIndex", "ChunkSequenceSetIndex"}}};  // Basler ace, GigE
// The level at the exposure's end (FLIR) is that at its begin, too: a change in between would be
// one more trigger in the camera's count.
constexpr std::array<ChunkName, 2> kLineChunks{
    {{"LineStatusAll", "ChunkLineStatusAll"},
     {"ExposureEndLineStatusAll", "ChunkExposureEndLineStatusAll"}}};
constexpr int kLineBitLimit = 63;
// SFNC, and the name of before SFNC 1.5 (Aravis' fake camera).
constexpr std::array<const char*, 2> kExposureNames{"ExposureTime", "ExposureTimeAbs"};
constexpr std::array<const char*, 2> kDebouncerNames{"LineDebouncerTime", "LineDebouncerTimeAbs"};
constexpr std::array<const char*, 2> kFirmwareNames{"DeviceFirmwareVersion", "DeviceVersion"};

// How the clock is read: SFNC's names, and those of GigE Vision 1 (SFNC before 2.0).
struct ClockNames {
  const char* latch;
  const char* value;
  bool is_in_ns;
};
constexpr std::array<ClockNames, 2> kClockNames{
    {{"TimestampLatch", "TimestampLatchValue", true},
     {"GevTimestampControlLatch", "GevTimestampValue", false}}};

// Which chunks this camera sends; empty where it has none.
struct ChunkFeatures {
  std::string exposure, trigger_count, sequencer_set, line_status;
  int line_bit = 0;  // the trigger line's, in line_status
  bool is_active() const {
    return !exposure.empty() || !trigger_count.empty() || !sequencer_set.empty() ||
           !line_status.empty();
  }
};

// Loss is told once, and never to a sink whose camera is gone. Thread-safe: Aravis' heartbeat
// thread reports here.
class LossLatch {
 public:
  explicit LossLatch(EventSink& sink) : sink_(&sink) {}
  void report(const std::string& cause) {
    const std::lock_guard lock(mutex_);
    if (is_lost_.exchange(true) || sink_ == nullptr) return;
    sink_->post(DeviceFault{
        Device::kCamera,
        {Fault::kDeviceLost, cause + "; check the camera's cable and power and open it anew"}});
  }
  void close() {
    const std::lock_guard lock(mutex_);
    sink_ = nullptr;
  }
  bool is_lost() const { return is_lost_; }

 private:
  std::mutex mutex_;
  EventSink* sink_;  // guarded by mutex_
  std::atomic<bool> is_lost_{false};
};

// Where leases hand their buffers back: to the stream while there is one. Thread-safe.
class BufferReturn {
 public:
  explicit BufferReturn(ArvStream* stream) : stream_(stream) {}
  void give_back(ArvBuffer* buffer) {
    const std::lock_guard lock(mutex_);
    if (stream_ == nullptr)
      g_object_unref(buffer);
    else
      arv_stream_push_buffer(stream_, buffer);
  }
  void close() {
    const std::lock_guard lock(mutex_);
    stream_ = nullptr;
  }

 private:
  std::mutex mutex_;
  ArvStream* stream_;  // guarded by mutex_; borrowed
};

class BufferLease final : public FrameLease {
 public:
  BufferLease(std::shared_ptr<BufferReturn> home, std::shared_ptr<FrameMemory> memory,
              ArvBuffer* buffer)
      : home_(std::move(home)), memory_(std::move(memory)), buffer_(buffer) {}
  ~BufferLease() override { home_->give_back(buffer_); }
  BufferLease(const BufferLease&) = delete;
  BufferLease& operator=(const BufferLease&) = delete;

 private:
  std::shared_ptr<BufferReturn> home_;
  std::shared_ptr<FrameMemory> memory_;
  ArvBuffer* buffer_;  // owned
};

// What a sound buffer looks like.
struct FrameFormat {
  int width_px = 0;
  int height_px = 0;
  std::uint32_t pixel_format_code = 0;
  std::string pixel_format;
  std::size_t payload_bytes = 0;

  std::size_t image_bytes() const {
    return static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px) *
           (ARV_PIXEL_FORMAT_BIT_PER_PIXEL(pixel_format_code) / 8);
  }
};

std::string_view to_string(ArvBufferStatus status) {
  switch (status) {
    case ARV_BUFFER_STATUS_TIMEOUT:
      return "packets were still missing when their time was up";
    case ARV_BUFFER_STATUS_MISSING_PACKETS:
      return "packets are missing";
    case ARV_BUFFER_STATUS_WRONG_PACKET_ID:
      return "a packet has a wrong id";
    case ARV_BUFFER_STATUS_SIZE_MISMATCH:
      return "it does not fit its buffer";
    case ARV_BUFFER_STATUS_ABORTED:
      return "the stream ended within it";
    default:
      return "it was not received whole";
  }
}

// The receiver: sees that packets are fetched in time. Permission is missing for ordinary users
// without CAP_SYS_NICE; it then runs as any thread.
void raise_receiver_priority(void*, ArvStreamCallbackType type, ArvBuffer*) {
  if (type != ARV_STREAM_CALLBACK_TYPE_INIT) return;
  const sched_param parameters{.sched_priority = kReceiverPriority};
  pthread_setschedparam(pthread_self(), SCHED_RR, &parameters);
}

// One acquisition's stream, its buffers, and the thread that checks them.
class Acquisition {
 public:
  struct Parts {
    GObjectPtr<ArvStream> stream;
    GObjectPtr<ArvChunkParser> parser;
    std::shared_ptr<FrameMemory> memory;
    FrameFormat format;
    ChunkFeatures chunks;
    int frame_count = 0;
  };

  Acquisition(Parts parts, EventSink& sink)
      : parts_(std::move(parts)),
        sink_(sink),
        home_(std::make_shared<BufferReturn>(parts_.stream.get())),
        block_ids_(static_cast<std::uint64_t>(parts_.frame_count)) {
    for (std::size_t i = 0; i < parts_.memory->block_count(); ++i)
      arv_stream_push_buffer(parts_.stream.get(),
                             arv_buffer_new_full(parts_.format.payload_bytes,
                                                 parts_.memory->block(i), nullptr, nullptr));
  }
  ~Acquisition() { stop(); }
  Acquisition(const Acquisition&) = delete;
  Acquisition& operator=(const Acquisition&) = delete;

  // `trigger_base`: the camera's trigger counter now; it counts from there.
  void start(std::int64_t trigger_base) {
    trigger_base_ = trigger_base;
    reader_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
  }

  // Nothing is posted afterwards.
  void stop() {
    reader_ = std::jthread();
    home_->close();
  }

  std::int64_t delivered_count() const { return delivered_count_; }
  std::int64_t damaged_count() const { return damaged_count_; }
  std::int64_t resent_packet_count() const {
    return static_cast<std::int64_t>(
        arv_stream_get_info_uint64_by_name(parts_.stream.get(), "n_resent_packets"));
  }

 private:
  void run(const std::stop_token& stop) {
    const auto timeout_us = static_cast<guint64>(std::chrono::microseconds(kPopTimeout).count());
    while (!stop.stop_requested())
      if (ArvBuffer* buffer = arv_stream_timeout_pop_buffer(parts_.stream.get(), timeout_us))
        handle(buffer);
  }

  // Posts what became of the buffer; its ownership goes on to the lease or back to the stream.
  void handle(ArvBuffer* buffer) {
    auto lease = std::make_unique<BufferLease>(home_, parts_.memory, buffer);
    const bool is_whole = arv_buffer_get_status(buffer) == ARV_BUFFER_STATUS_SUCCESS;
    const std::optional<std::uint64_t> block_id = identify(buffer, is_whole);
    if (std::optional<Error> defect = find_defect(buffer, block_id)) {
      ++damaged_count_;
      sink_.post(FrameDamaged{block_id.value_or(0), std::move(*defect)});
      return;
    }
    Result<Frame> frame = make_frame(buffer, *block_id);
    if (!frame) {
      ++damaged_count_;
      sink_.post(FrameDamaged{*block_id, frame.error()});
      return;
    }
    frame->lease = std::move(lease);
    ++delivered_count_;
    sink_.post(FrameArrived{std::move(*frame)});
  }

  // The block's number; posts the blocks skipped before it. A buffer whose leader is missing still
  // carries the id of its last use, which is none: older than the latest.
  std::optional<std::uint64_t> identify(ArvBuffer* buffer, bool is_whole) {
    const std::uint64_t latest = block_ids_.latest();
    const std::uint64_t wire_id = arv_buffer_get_frame_id(buffer);
    if (!is_whole && wire_id == 0) return std::nullopt;
    const std::optional<std::uint64_t> block_id = block_ids_.advance(wire_id);
    for (std::uint64_t lost = latest + 1; block_id && lost < *block_id; ++lost) {
      ++damaged_count_;
      sink_.post(FrameDamaged{
          lost,
          {Fault::kSequenceGap,
           "block " + std::to_string(lost) + " never arrived; project its pattern again"}});
    }
    return block_id;
  }

  std::optional<Error> find_defect(ArvBuffer* buffer,
                                   const std::optional<std::uint64_t>& block_id) const {
    const std::string name =
        block_id ? "block " + std::to_string(*block_id) : "a block without a valid id";
    const auto malformed = [&](const std::string& what) {
      return Error{Fault::kFrameMalformed, name + " " + what};
    };
    const ArvBufferStatus status = arv_buffer_get_status(buffer);
    if (status != ARV_BUFFER_STATUS_SUCCESS)
      return Error{Fault::kFrameIncomplete, name + ": " + std::string(to_string(status))};
    if (!block_id)
      return malformed("(" + std::to_string(arv_buffer_get_frame_id(buffer)) +
                       ") came out of sequence");
    const bool has_chunks = arv_buffer_has_chunks(buffer) != FALSE;
    if (has_chunks != parts_.chunks.is_active())
      return malformed(has_chunks ? "has chunks that were not asked for" : "lacks its chunks");
    if (!has_chunks && arv_buffer_get_payload_type(buffer) != ARV_BUFFER_PAYLOAD_TYPE_IMAGE)
      return malformed("is no image");
    return find_image_defect(buffer, malformed);
  }

  template <typename Malformed>
  std::optional<Error> find_image_defect(ArvBuffer* buffer, const Malformed& malformed) const {
    const FrameFormat& format = parts_.format;
    const int width_px = arv_buffer_get_image_width(buffer);
    const int height_px = arv_buffer_get_image_height(buffer);
    if (width_px != format.width_px || height_px != format.height_px)
      return malformed("is " + std::to_string(width_px) + " x " + std::to_string(height_px) +
                       " px instead of " + std::to_string(format.width_px) + " x " +
                       std::to_string(format.height_px) + " px");
    if (arv_buffer_get_image_pixel_format(buffer) != format.pixel_format_code)
      return malformed("is not in " + format.pixel_format);
    std::size_t byte_count = 0;
    arv_buffer_get_data(buffer, &byte_count);
    if (byte_count != format.payload_bytes)
      return malformed("has " + std::to_string(byte_count) + " bytes instead of " +
                       std::to_string(format.payload_bytes));
    return std::nullopt;
  }

  Result<Frame> make_frame(ArvBuffer* buffer, std::uint64_t block_id) const {
    const auto* pixels = static_cast<const std::byte*>(arv_buffer_get_data(buffer, nullptr));
    Frame frame;
    frame.pixels = std::span(pixels, parts_.format.image_bytes());
    frame.width_px = parts_.format.width_px;
    frame.height_px = parts_.format.height_px;
    frame.pixel_format = parts_.format.pixel_format;
    frame.block_id = block_id;
    frame.timestamp = CameraClock::time_point(
        std::chrono::nanoseconds(static_cast<std::int64_t>(arv_buffer_get_timestamp(buffer))));
    frame.received = HostClock::now();
    if (auto read = read_chunks(buffer, frame); !read) return tl::unexpected(read.error());
    return frame;
  }

  Result<void> read_chunks(ArvBuffer* buffer, Frame& frame) const {
    ArvChunkParser* parser = parts_.parser.get();
    GError* error = nullptr;
    ChunkAnswers answers;
    const auto integer = [&](const std::string& name) -> std::optional<std::int64_t> {
      if (name.empty() || error != nullptr) return std::nullopt;
      return arv_chunk_parser_get_integer_value(parser, buffer, name.c_str(), &error);
    };
    if (const std::string& name = parts_.chunks.exposure; !name.empty())
      answers.exposure_us = arv_chunk_parser_get_float_value(parser, buffer, name.c_str(), &error);
    answers.trigger_count = integer(parts_.chunks.trigger_count);
    answers.sequencer_set = integer(parts_.chunks.sequencer_set);
    answers.line_status = integer(parts_.chunks.line_status);
    if (error == nullptr)
      return take_chunks(answers, {trigger_base_, parts_.chunks.line_bit}, frame);
    const std::string cause = error->message;
    g_clear_error(&error);
    return failure(Fault::kFrameMalformed,
                   "block " + std::to_string(frame.block_id) + " lacks a chunk: " + cause);
  }

  Parts parts_;
  EventSink& sink_;
  std::shared_ptr<BufferReturn> home_;  // shared: leases outlive the acquisition
  BlockIdCounter block_ids_;            // used by the reader only
  std::int64_t trigger_base_ = 0;
  std::atomic<std::int64_t> delivered_count_{0};
  std::atomic<std::int64_t> damaged_count_{0};
  std::jthread reader_;
};

// The MTU of the interface that has this IPv4 address; nullopt where none has.
std::optional<int> interface_mtu(const std::string& address) {
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) != 0) return std::nullopt;
  const std::unique_ptr<ifaddrs, void (*)(ifaddrs*)> owner(list, freeifaddrs);
  for (const ifaddrs* at = list; at != nullptr; at = at->ifa_next) {
    if (at->ifa_addr == nullptr || at->ifa_addr->sa_family != AF_INET) continue;
    std::array<char, INET_ADDRSTRLEN> text{};
    sockaddr_in name;
    std::memcpy(&name, at->ifa_addr, sizeof name);
    inet_ntop(AF_INET, &name.sin_addr, text.data(), text.size());
    if (address != text.data()) continue;
    ifreq request{};
    std::strncpy(request.ifr_name, at->ifa_name, IFNAMSIZ - 1);
    const int probe = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    const bool is_known = ioctl(probe, SIOCGIFMTU, &request) == 0;
    close(probe);
    if (is_known) return request.ifr_mtu;
  }
  return std::nullopt;
}

std::string inet_text(GSocketAddress* address) {
  GInetAddress* inet = g_inet_socket_address_get_address(G_INET_SOCKET_ADDRESS(address));
  gchar* text = g_inet_address_to_string(inet);
  std::string copy(text);
  g_free(text);
  return copy;
}

double exposure_us(std::chrono::microseconds exposure) {
  return static_cast<double>(exposure.count());
}

double exposure_tolerance_us(std::chrono::microseconds exposure) {
  return std::max(kExposureRoundingMinUs, exposure_us(exposure) * kExposureRoundingFrac);
}

// What to do about an error, unless the device is gone: that says so itself.
Result<void> advising(Result<void> result, const std::string& remedy) {
  if (!result && result.error().fault != Fault::kDeviceLost) result.error().detail += "; " + remedy;
  return result;
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text.empty() ? "none" : text;
}

// Runs steps until one fails.
template <typename... Steps>
Result<void> in_order(Steps&&... steps) {
  Result<void> result;
  static_cast<void>(((result = steps(), result.has_value()) && ...));
  return result;
}

}  // namespace

class AravisCamera::Impl {
 public:
  Impl(CameraSettings settings, EventSink& sink, GObjectPtr<ArvCamera> camera);
  ~Impl();

  Result<void> configure();
  Result<void> arm(const std::vector<std::chrono::microseconds>& exposures, int frame_count);
  void disarm() noexcept;
  Result<CameraCounters> counters();
  Result<CameraClockSample> read_clock();
  Result<void> trigger_software();

  const CameraIdentity& identity() const { return identity_; }
  int packet_size_bytes() const { return packet_size_bytes_; }

 private:
  Result<void> check_controller();
  Result<void> read_identity();
  Result<void> stop_whatever_runs();
  Result<void> set_region();
  Result<void> set_extent(const char* name, int value_px, const char* key);
  Result<void> set_pixel_format();
  Result<void> set_packet_size();
  Result<void> set_chunks();
  Result<void> set_counters();
  Result<void> set_trigger();
  Result<void> set_trigger_edge();
  Result<void> set_line_level();
  Result<void> set_line_debounce();
  void note(const std::string& text);

  Result<void> check_exposures(const std::vector<std::chrono::microseconds>& exposures) const;
  Result<void> set_exposures(const std::vector<std::chrono::microseconds>& exposures);
  Result<void> set_single_exposure(std::chrono::microseconds exposure);
  Result<void> program_sequencer(const std::vector<std::chrono::microseconds>& exposures);
  Result<void> program_set(int set, int next_set, std::chrono::microseconds exposure);
  Result<void> verify_set(int set, int next_set, std::chrono::microseconds exposure);
  Result<std::shared_ptr<FrameMemory>> take_memory(int frame_count, std::size_t payload_bytes);
  Result<GObjectPtr<ArvStream>> open_stream();
  Result<void> start_acquisition(int frame_count);
  Result<std::int64_t> trigger_count();
  Result<double> tick_ns();

  // kDeviceLost also latches: nothing is asked of a dead camera twice.
  template <typename T>
  Result<T> noting_loss(Result<T> result) {
    if (!result && result.error().fault == Fault::kDeviceLost)
      loss_->report("the camera at " + settings_.address + " no longer answers");
    return result;
  }
  // The same, and: the camera was ours when it was opened, and nothing that is asked of it in this
  // way is ever locked, so that who is denied it has lost the control.
  Result<void> noting_theft(Result<void> result) {
    if (result || result.error().fault != Fault::kAccessDenied) return noting_loss(result);
    loss_->report("another program took the control of the camera at " + settings_.address);
    return tl::unexpected(lost_error());
  }
  Error lost_error() const {
    return {Fault::kDeviceLost, "the camera at " + settings_.address + " is lost; open it anew"};
  }
  std::string at(const char* what) const { return std::string(what) + settings_.address; }
  bool set_enumeration_if_present(const std::string& name, const std::string& value) const {
    return features_.has_entry(name, value) && features_.set_text(name, value).has_value();
  }
  Result<void> set_text_where_present(const std::string& name, const std::string& value) const {
    return features_.has(name) ? features_.set_text(name, value) : Result<void>{};
  }

  const CameraSettings settings_;
  EventSink& sink_;
  GObjectPtr<ArvCamera> camera_;
  AravisFeatures features_;
  std::shared_ptr<LossLatch>
      loss_;  // shared with Aravis' heartbeat thread, which may still be in it
  gulong loss_handler_ = 0;
  CameraIdentity identity_;
  std::string exposure_name_;
  FrameFormat format_;
  ChunkFeatures chunks_;
  int packet_size_bytes_ = 0;
  bool has_trigger_counter_ = false;
  std::int64_t trigger_base_ = 0;
  std::int64_t missed_base_ = 0;
  std::shared_ptr<FrameMemory> memory_;       // shared with leases
  std::unique_ptr<Acquisition> acquisition_;  // while armed
  std::jthread teardown_;  // takes a lost camera's stream apart, which can take seconds
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

Result<void> AravisCamera::Impl::configure() {
  return noting_loss(in_order([&] { return check_controller(); }, [&] { return read_identity(); },
                              [&] { return stop_whatever_runs(); },
                              [&] { return set_pixel_format(); }, [&] { return set_region(); },
                              [&] { return set_packet_size(); }, [&] { return set_chunks(); },
                              [&] { return set_counters(); }, [&] { return set_trigger(); }));
}

Result<void> AravisCamera::Impl::check_controller() {
  ArvDevice* device = arv_camera_get_device(camera_.get());
  if (!arv_camera_is_gv_device(camera_.get()))
    return failure(Fault::kUnsupported, settings_.address + " is no GigE Vision camera");
  if (arv_gv_device_is_controller(ARV_GV_DEVICE(device))) return {};
  guint32 address = 0;
  GError* error = nullptr;
  arv_device_read_register(device, kPrimaryApplicationAddress, &address, &error);
  g_clear_error(&error);
  const in_addr owner{htonl(address)};
  std::array<char, INET_ADDRSTRLEN> text{};
  inet_ntop(AF_INET, &owner, text.data(), text.size());
  const std::string who =
      address == 0 ? "another program" : "a program at " + std::string(text.data());
  return failure(Fault::kAccessDenied, who + at(" controls the camera at ") +
                                           "; close it, or wait 3 s if it has just crashed");
}

Result<void> AravisCamera::Impl::read_identity() {
  const auto text = [&](const char* name) { return features_.text(name).value_or(""); };
  const Result<std::string> vendor = features_.text("DeviceVendorName");
  if (!vendor) return tl::unexpected(vendor.error());
  identity_.vendor = *vendor;
  identity_.model = text("DeviceModelName");
  GError* error = nullptr;
  const char* serial = arv_camera_get_device_serial_number(camera_.get(), &error);
  if (auto read = take_error(&error, "reading the serial number"); !read) return read;
  identity_.serial = serial == nullptr ? "" : serial;
  for (const char* name : kFirmwareNames)
    if (identity_.firmware.empty()) identity_.firmware = text(name);
  if (settings_.serial.empty() || settings_.serial == identity_.serial) return {};
  return failure(Fault::kNotFound, at("the camera at ") + " has serial number " + identity_.serial +
                                       ", the rig file asks for " + settings_.serial +
                                       "; correct camera.serial or camera.address");
}

// A program that ended badly may have left the camera running.
Result<void> AravisCamera::Impl::stop_whatever_runs() {
  return in_order([&] { return features_.execute("AcquisitionStop"); },
                  [&] { return set_text_where_present("SequencerMode", "Off"); },
                  [&] { return set_text_where_present("SequencerConfigurationMode", "Off"); },
                  [&] { return set_text_where_present("AcquisitionMode", "Continuous"); },
                  [&] { return set_text_where_present("ExposureAuto", "Off"); },
                  [&] { return set_text_where_present("GainAuto", "Off"); });
}

Result<void> AravisCamera::Impl::set_region() {
  const auto set_offset = [&](const char* name, int offset_px, const char* key) {
    return offset_px == 0 && !features_.has(name) ? Result<void>{}
                                                  : set_extent(name, offset_px, key);
  };
  // Offsets first go to zero, so that any width fits.
  const Result<void> result =
      in_order([&] { return set_offset("OffsetX", 0, "offset_x_px"); },
               [&] { return set_offset("OffsetY", 0, "offset_y_px"); },
               [&] { return set_extent("Width", settings_.width_px, "width_px"); },
               [&] { return set_extent("Height", settings_.height_px, "height_px"); },
               [&] { return set_offset("OffsetX", settings_.offset_x_px, "offset_x_px"); },
               [&] { return set_offset("OffsetY", settings_.offset_y_px, "offset_y_px"); });
  format_.width_px = settings_.width_px;
  format_.height_px = settings_.height_px;
  return result;
}

// A number of pixels; `key` is the rig file's.
Result<void> AravisCamera::Impl::set_extent(const char* name, int value_px, const char* key) {
  const std::string remedy = std::string("correct camera.") + key + " in the rig file";
  const auto bounds = features_.integer_bounds(name);
  if (bounds && (value_px < bounds->first || value_px > bounds->second))
    return failure(Fault::kOutOfRange, at("the camera at ") + " takes " + name + " from " +
                                           std::to_string(bounds->first) + " to " +
                                           std::to_string(bounds->second) + " px here, not " +
                                           std::to_string(value_px) + "; " + remedy);
  return advising(features_.set_integer(name, value_px), remedy);
}

Result<void> AravisCamera::Impl::set_pixel_format() {
  if (!features_.has_entry("PixelFormat", settings_.pixel_format))
    return failure(Fault::kUnsupported, at("the camera at ") + " has no pixel format " +
                                            settings_.pixel_format + " but " +
                                            joined(features_.entries("PixelFormat")) +
                                            "; correct camera.pixel_format in the rig file");
  if (auto set = features_.set_text("PixelFormat", settings_.pixel_format); !set) return set;
  GError* error = nullptr;
  format_.pixel_format_code = arv_camera_get_pixel_format(camera_.get(), &error);
  if (auto read = take_error(&error, "reading PixelFormat"); !read) return read;
  format_.pixel_format = settings_.pixel_format;
  const std::uint32_t bits = ARV_PIXEL_FORMAT_BIT_PER_PIXEL(format_.pixel_format_code);
  if (bits % 8 == 0) return {};
  return failure(Fault::kUnsupported, "pixel format " + settings_.pixel_format +
                                          " is packed; choose one of 8 or 16 bits a sample");
}

Result<void> AravisCamera::Impl::set_packet_size() {
  ArvCamera* camera = camera_.get();
  GError* error = nullptr;
  int wanted_bytes = settings_.packet_size_bytes;
  if (wanted_bytes == 0) {
    wanted_bytes = static_cast<int>(arv_camera_gv_auto_packet_size(camera, &error));
    if (auto done = take_error(&error, "negotiating the packet size"); !done) return done;
    // Above the MTU packets are fragmented, which the packet socket cannot put together.
    GSocketAddress* interface =
        arv_gv_device_get_interface_address(ARV_GV_DEVICE(arv_camera_get_device(camera)));
    if (const auto mtu = interface_mtu(inet_text(interface)))
      wanted_bytes = std::min(wanted_bytes, *mtu);
  }
  constexpr const char* kRemedy =
      "correct camera.packet_size_bytes in the rig file, or leave it out to have it negotiated";
  arv_camera_gv_set_packet_size(camera, wanted_bytes, &error);
  const std::string what = "setting the packet size to " + std::to_string(wanted_bytes) + " bytes";
  if (auto written = advising(take_error(&error, what), kRemedy); !written) return written;
  packet_size_bytes_ = static_cast<int>(arv_camera_gv_get_packet_size(camera, &error));
  if (auto read = take_error(&error, "reading the packet size"); !read) return read;
  if (settings_.packet_size_bytes == 0 || packet_size_bytes_ == wanted_bytes) return {};
  return failure(Fault::kReadBackMismatch, "packet size was set to " +
                                               std::to_string(wanted_bytes) + " but reads " +
                                               std::to_string(packet_size_bytes_) + "; " + kRemedy);
}

// Chunks are welcome but optional: a camera without them gives frames without those values.
Result<void> AravisCamera::Impl::set_chunks() {
  if (!features_.has("ChunkModeActive") || !features_.has("ChunkSelector")) return {};
  if (auto set = features_.set_flag("ChunkModeActive", true); !set) return set;
  const auto enable = [&](std::span<const ChunkName> names) -> std::string {
    for (const ChunkName& name : names)
      if (features_.has(name.feature) &&
          set_enumeration_if_present("ChunkSelector", name.selector) &&
          features_.set_flag("ChunkEnable", true))
        return name.feature;
    return "";
  };
  chunks_.exposure = enable(kExposureChunks);
  chunks_.trigger_count = enable(kTriggerChunks);
  chunks_.sequencer_set = enable(kSetChunks);
  // Which bit is whose differs between cameras; they begin with the first line that there is.
  const std::vector<std::string> lines = features_.entries("LineSelector");
  const auto line = std::find(lines.begin(), lines.end(), settings_.trigger_line);
  chunks_.line_bit = static_cast<int>(line - lines.begin());
  if (settings_.trigger_edge == TriggerEdge::kAny && line != lines.end() &&
      chunks_.line_bit <= kLineBitLimit)
    chunks_.line_status = enable(kLineChunks);
  identity_.tells_line_level = !chunks_.line_status.empty();
  return chunks_.is_active() ? Result<void>{} : features_.set_flag("ChunkModeActive", false);
}

// Counter0 counts pulses on the trigger line, where the camera has counters.
Result<void> AravisCamera::Impl::set_counters() {
  if (!features_.has("CounterValue") || !features_.has("CounterSelector")) return {};
  if (auto set = features_.set_text("CounterSelector", "Counter0"); !set) return set;
  const std::string source = features_.text("CounterEventSource").value_or("");
  has_trigger_counter_ = source == "FrameTrigger" ||
                         set_enumeration_if_present("CounterEventSource", settings_.trigger_line);
  if (settings_.trigger_edge == TriggerEdge::kAny && source != "FrameTrigger")
    has_trigger_counter_ =
        has_trigger_counter_ && set_enumeration_if_present("CounterEventActivation", "AnyEdge");
  if (!has_trigger_counter_ && chunks_.trigger_count == "ChunkCounterValue")
    chunks_.trigger_count.clear();  // it counts something else
  return {};
}

Result<void> AravisCamera::Impl::set_trigger() {
  if (features_.has("TriggerSource") &&
      !features_.has_entry("TriggerSource", settings_.trigger_line))
    return failure(Fault::kUnsupported, at("the camera at ") + " has no TriggerSource " +
                                            settings_.trigger_line +
                                            "; correct camera.trigger_line");
  return in_order([&] { return set_text_where_present("TriggerSelector", "FrameStart"); },
                  [&] { return features_.set_text("TriggerMode", "On"); },
                  [&] { return features_.set_text("TriggerSource", settings_.trigger_line); },
                  [&] { return set_trigger_edge(); });
}

// A photodiode on the line makes an edge of either kind in turn, so the camera must take both; and
// only its own count of them proves that none was missed.
Result<void> AravisCamera::Impl::set_trigger_edge() {
  if (settings_.trigger_edge == TriggerEdge::kRising)
    return set_text_where_present("TriggerActivation", "RisingEdge");
  constexpr const char* kRemedy =
      "; put a trigger box between, and set sequence.sync to \"trigger_box\" in the rig file";
  if (!features_.has_entry("TriggerActivation", "AnyEdge"))
    return failure(Fault::kUnsupported,
                   at("the camera at ") + " has no TriggerActivation AnyEdge but " +
                       joined(features_.entries("TriggerActivation")) + kRemedy);
  if (chunks_.trigger_count.empty())
    return failure(Fault::kUnsupported,
                   at("the camera at ") +
                       " does not say with its frames how many triggers it has seen" + kRemedy);
  return in_order([&] { return features_.set_text("TriggerActivation", "AnyEdge"); },
                  [&] { return set_line_level(); }, [&] { return set_line_debounce(); });
}

// The frames are to tell the level as it is at the plug.
Result<void> AravisCamera::Impl::set_line_level() {
  if (!identity_.tells_line_level) {
    note(at("the camera at ") + " does not say with its frames which level " +
         settings_.trigger_line +
         " had (chunk LineStatusAll): the display must keep time for a capture to be complete");
    return {};
  }
  if (auto set = features_.set_text("LineSelector", settings_.trigger_line); !set) return set;
  return features_.has("LineInverter") ? features_.set_flag("LineInverter", false) : Result<void>{};
}

void AravisCamera::Impl::note(const std::string& text) {
  identity_.note.append(identity_.note.empty() ? "" : "; ").append(text);
}

// Each bounce of the photodiode would be a trigger.
Result<void> AravisCamera::Impl::set_line_debounce() {
  const std::string remedy = "correct camera.line_debounce_us in the rig file";
  const auto wanted_us = static_cast<double>(settings_.line_debounce.count());
  if (features_.has("LineSelector"))
    if (auto set = features_.set_text("LineSelector", settings_.trigger_line); !set) return set;
  for (const char* name : kDebouncerNames) {
    if (!features_.has(name)) continue;
    const auto bounds = features_.number_bounds(name);
    if (!bounds) return tl::unexpected(bounds.error());
    if (wanted_us < bounds->first || wanted_us > bounds->second)
      return failure(Fault::kOutOfRange,
                     at("the camera at ") + " takes " + name + " from " +
                         std::to_string(std::llround(bounds->first)) + " to " +
                         std::to_string(std::llround(bounds->second)) + " us, not " +
                         std::to_string(settings_.line_debounce.count()) + " us; " + remedy);
    return advising(
        features_.set_number(name, wanted_us, std::max(1.0, kDebounceRoundingFrac * wanted_us)),
        remedy);
  }
  if (settings_.line_debounce.count() > 0)
    note(at("the camera at ") + " has no LineDebouncerTime: an edge of " + settings_.trigger_line +
         " that bounces is several triggers; see that the photodiode's level is clean");
  return {};
}

Result<void> AravisCamera::Impl::arm(const std::vector<std::chrono::microseconds>& exposures,
                                     int frame_count) {
  if (loss_->is_lost()) return tl::unexpected(lost_error());
  if (acquisition_) return failure(Fault::kBusy, "the camera is armed already; disarm it first");
  if (exposures.empty() || frame_count < 1)
    return failure(Fault::kOutOfRange, "arming needs at least one exposure and one frame");
  return noting_theft(in_order([&] { return check_exposures(exposures); },
                               [&] { return set_exposures(exposures); },
                               [&] { return start_acquisition(frame_count); }));
}

Result<void> AravisCamera::Impl::check_exposures(
    const std::vector<std::chrono::microseconds>& exposures) const {
  for (const char* name : kExposureNames) {
    if (!features_.has(name)) continue;
    const auto bounds = features_.number_bounds(name);
    if (!bounds) return tl::unexpected(bounds.error());
    for (const std::chrono::microseconds exposure : exposures)
      if (exposure_us(exposure) < bounds->first || exposure_us(exposure) > bounds->second)
        return failure(Fault::kOutOfRange,
                       at("the camera at ") + " exposes for " +
                           std::to_string(std::llround(bounds->first)) + " to " +
                           std::to_string(std::llround(bounds->second)) + " us, not for " +
                           std::to_string(exposure.count()) +
                           " us; correct sequence.exposures_us in the rig file");
    return {};
  }
  return failure(Fault::kUnsupported, "the camera has no feature ExposureTime");
}

Result<void> AravisCamera::Impl::set_exposures(
    const std::vector<std::chrono::microseconds>& exposures) {
  exposure_name_ = features_.has(kExposureNames[0]) ? kExposureNames[0] : kExposureNames[1];
  if (auto off = set_text_where_present("SequencerMode", "Off"); !off) return off;
  if (settings_.bracketing == Bracketing::kTriggerWidth)
    return features_.set_text("ExposureMode", "TriggerWidth");
  if (auto timed = set_text_where_present("ExposureMode", "Timed"); !timed) return timed;
  if (exposures.size() == 1) return set_single_exposure(exposures.front());
  if (auto programmed = program_sequencer(exposures); !programmed) return programmed;
  if (!chunks_.exposure.empty()) return {};
  return failure(
      Fault::kUnsupported,
      at("the camera at ") +
          " does not say with its frames how long it exposed, so a sequencer out of "
          "step would go unseen; set camera.bracketing to trigger_width in the rig file");
}

Result<void> AravisCamera::Impl::set_single_exposure(std::chrono::microseconds exposure) {
  return features_.set_number(exposure_name_, exposure_us(exposure),
                              exposure_tolerance_us(exposure));
}

Result<void> AravisCamera::Impl::program_sequencer(
    const std::vector<std::chrono::microseconds>& exposures) {
  const auto sets = features_.integer_bounds("SequencerSetSelector");
  if (!sets) return tl::unexpected(sets.error());
  const auto set_count = static_cast<int>(exposures.size());
  if (set_count - 1 > sets->second)
    return failure(Fault::kOutOfRange, "the camera's sequencer has " +
                                           std::to_string(sets->second + 1) + " sets, " +
                                           std::to_string(set_count) +
                                           " exposures were asked for; shorten "
                                           "sequence.exposures_us, or use trigger_width");
  const auto next = [&](int set) { return (set + 1) % set_count; };
  const auto exposure_of = [&](int set) { return exposures[static_cast<std::size_t>(set)]; };
  if (auto on = features_.set_text("SequencerConfigurationMode", "On"); !on) return on;
  for (int set = 0; set < set_count; ++set)
    if (auto done = program_set(set, next(set), exposure_of(set)); !done) return done;
  for (int set = 0; set < set_count; ++set)
    if (auto same = verify_set(set, next(set), exposure_of(set)); !same) return same;
  return in_order([&] { return features_.set_integer("SequencerSetStart", 0); },
                  [&] { return features_.set_text("SequencerConfigurationMode", "Off"); },
                  [&] { return features_.set_text("SequencerMode", "On"); });
}

Result<void> AravisCamera::Impl::program_set(int set, int next_set,
                                             std::chrono::microseconds exposure) {
  return in_order([&] { return features_.set_integer("SequencerSetSelector", set); },
                  [&] { return set_single_exposure(exposure); },
                  [&] {
                    return features_.has("SequencerPathSelector")
                               ? features_.set_integer("SequencerPathSelector", 0)
                               : Result<void>{};
                  },
                  [&] { return features_.set_integer("SequencerSetNext", next_set); },
                  [&] { return set_text_where_present("SequencerTriggerSource", "FrameStart"); },
                  [&] { return features_.execute("SequencerSetSave"); });
}

// A set is what it loads, not what was saved.
Result<void> AravisCamera::Impl::verify_set(int set, int next_set,
                                            std::chrono::microseconds exposure) {
  if (auto loaded = in_order([&] { return features_.set_integer("SequencerSetSelector", set); },
                             [&] { return features_.execute("SequencerSetLoad"); });
      !loaded)
    return loaded;
  const Result<double> got_us = features_.number(exposure_name_);
  if (!got_us) return tl::unexpected(got_us.error());
  const Result<std::int64_t> got_next = features_.integer("SequencerSetNext");
  if (!got_next) return tl::unexpected(got_next.error());
  if (std::abs(*got_us - exposure_us(exposure)) <= exposure_tolerance_us(exposure) &&
      *got_next == next_set)
    return {};
  return failure(Fault::kReadBackMismatch,
                 "sequencer set " + std::to_string(set) + " was saved with ExposureTime " +
                     std::to_string(exposure.count()) + " us and SequencerSetNext " +
                     std::to_string(next_set) + " but holds " + std::to_string(*got_us) +
                     " us and " + std::to_string(*got_next));
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

Result<GObjectPtr<ArvStream>> AravisCamera::Impl::open_stream() {
  // The UDP socket is bound before the camera learns its port. Aravis' packet socket (root only) is
  // opened later by the receiver's thread, and a first frame that came sooner was lost for good.
  arv_camera_gv_set_stream_options(camera_.get(), ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);
  GError* error = nullptr;
  GObjectPtr<ArvStream> stream(
      arv_camera_create_stream(camera_.get(), raise_receiver_priority, nullptr, &error));
  if (auto made = take_error(&error, "opening the stream"); !made)
    return tl::unexpected(made.error());
  g_object_set(stream.get(), "frame-retention", kFrameRetentionUs, "packet-resend",
               ARV_GV_STREAM_PACKET_RESEND_ALWAYS, "socket-buffer",
               ARV_GV_STREAM_SOCKET_BUFFER_FIXED, "socket-buffer-size", kSocketBufferBytes,
               nullptr);
  return stream;
}

Result<void> AravisCamera::Impl::start_acquisition(int frame_count) {
  GError* error = nullptr;
  format_.payload_bytes = arv_camera_get_payload(camera_.get(), &error);
  if (auto read = take_error(&error, "reading PayloadSize"); !read) return read;
  if (auto fits = check_payload(format_.payload_bytes, format_.image_bytes()); !fits) return fits;
  Result<std::shared_ptr<FrameMemory>> memory = take_memory(frame_count, format_.payload_bytes);
  if (!memory) return tl::unexpected(memory.error());
  memory_ = *memory;
  Result<GObjectPtr<ArvStream>> stream = open_stream();
  if (!stream) return tl::unexpected(stream.error());
  auto acquisition = std::make_unique<Acquisition>(
      Acquisition::Parts{
          .stream = std::move(*stream),
          .parser = GObjectPtr<ArvChunkParser>(arv_camera_create_chunk_parser(camera_.get())),
          .memory = memory_,
          .format = format_,
          .chunks = chunks_,
          .frame_count = frame_count},
      sink_);
  if (features_.has("CounterReset") && has_trigger_counter_)
    if (auto reset = features_.execute("CounterReset"); !reset) return reset;
  arv_camera_start_acquisition(camera_.get(), &error);
  if (auto started = take_error(&error, "starting the acquisition"); !started) return started;
  // No pulse comes before arm() returns, so this is where both counters stand at zero pulses.
  const Result<std::int64_t> base = trigger_count();
  if (!base) return tl::unexpected(base.error());
  trigger_base_ = *base;
  missed_base_ = features_.integer("TriggerMissedCount").value_or(0);
  acquisition_ = std::move(acquisition);
  acquisition_->start(trigger_base_);
  return {};
}

// 0 where the camera has no such counter.
Result<std::int64_t> AravisCamera::Impl::trigger_count() {
  return has_trigger_counter_ ? features_.integer("CounterValue") : 0;
}

void AravisCamera::Impl::disarm() noexcept {
  if (!acquisition_) return;
  acquisition_->stop();
  if (!loss_->is_lost()) {
    GError* error = nullptr;
    arv_camera_stop_acquisition(camera_.get(), &error);
    static_cast<void>(noting_loss(take_error(&error, "stopping the acquisition")));
  }
  if (loss_->is_lost())
    teardown_ = std::jthread([doomed = std::move(acquisition_)]() mutable { doomed.reset(); });
  acquisition_.reset();
}

Result<CameraCounters> AravisCamera::Impl::counters() {
  if (loss_->is_lost()) return tl::unexpected(lost_error());
  CameraCounters counters;
  if (acquisition_) {
    counters.delivered_frame_count = acquisition_->delivered_count();
    counters.damaged_frame_count = acquisition_->damaged_count();
    counters.resent_packet_count = acquisition_->resent_packet_count();
  }
  if (has_trigger_counter_) {
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
                 at("the clock of the camera at ") +
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
                                                         EventSink& sink) {
  GError* error = nullptr;
  GObjectPtr<ArvCamera> camera(arv_camera_new(settings.address.c_str(), &error));
  if (auto opened = take_error(&error, "opening"); !opened || !camera)
    return failure(Fault::kNotFound,
                   "no camera answers at " + settings.address +
                       "; check its cable and power, and camera.address in the rig file" +
                       (opened ? "" : " (" + opened.error().detail + ")"));
  auto impl = std::make_unique<Impl>(settings, sink, std::move(camera));
  if (auto configured = impl->configure(); !configured) return tl::unexpected(configured.error());
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

int AravisCamera::packet_size_bytes() const { return impl_->packet_size_bytes(); }

}  // namespace rig
