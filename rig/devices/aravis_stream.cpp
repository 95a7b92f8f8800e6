#include "rig/devices/aravis_stream.h"

#include <arv.h>
#include <pthread.h>

#include <chrono>
#include <mutex>
#include <span>
#include <utility>

namespace rig {

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

namespace {

constexpr std::chrono::milliseconds kPopTimeout{20};  // how soon the reader notices a stop
// How long Aravis waits for resent packets before it gives a block up; it delivers in order, so
// later blocks wait as long.
constexpr guint kFrameRetentionUs = 300'000;
constexpr gint kSocketBufferBytes = 16 << 20;  // the kernel grants net.core.rmem_max at most
constexpr int kReceiverPriority = 10;          // SCHED_RR, above every ordinary thread

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

std::string size_text(int width_px, int height_px) {
  return std::to_string(width_px).append(" x ").append(std::to_string(height_px)).append(" px");
}

// The receiver: sees that packets are fetched in time. Permission is missing for ordinary users
// without CAP_SYS_NICE; it then runs as any thread.
void raise_receiver_priority(void*, ArvStreamCallbackType type, ArvBuffer*) {
  if (type != ARV_STREAM_CALLBACK_TYPE_INIT) return;
  const sched_param parameters{.sched_priority = kReceiverPriority};
  pthread_setschedparam(pthread_self(), SCHED_RR, &parameters);
}

}  // namespace

std::uint32_t FrameFormat::bits_per_pixel() const {
  return ARV_PIXEL_FORMAT_BIT_PER_PIXEL(pixel_format_code);
}

std::size_t FrameFormat::image_bytes() const {
  return static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px) *
         (bits_per_pixel() / 8);
}

Result<GObjectPtr<ArvStream>> open_stream(ArvCamera* camera) {
  // The UDP socket is bound before the camera learns its port. Aravis' packet socket (root only) is
  // opened later by the receiver's thread, and a first frame that came sooner was lost for good.
  arv_camera_gv_set_stream_options(camera, ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);
  GError* error = nullptr;
  GObjectPtr<ArvStream> stream(
      arv_camera_create_stream(camera, raise_receiver_priority, nullptr, &error));
  if (auto made = take_error(&error, "opening the stream"); !made)
    return tl::unexpected(made.error());
  g_object_set(stream.get(), "frame-retention", kFrameRetentionUs, "packet-resend",
               ARV_GV_STREAM_PACKET_RESEND_ALWAYS, "socket-buffer",
               ARV_GV_STREAM_SOCKET_BUFFER_FIXED, "socket-buffer-size", kSocketBufferBytes,
               nullptr);
  return stream;
}

Acquisition::Acquisition(Parts parts, EventSink& sink)
    : parts_(std::move(parts)),
      sink_(sink),
      home_(std::make_shared<BufferReturn>(parts_.stream.get())),
      block_ids_(static_cast<std::uint64_t>(parts_.frame_count)) {
  for (std::size_t i = 0; i < parts_.memory->block_count(); ++i)
    arv_stream_push_buffer(parts_.stream.get(),
                           arv_buffer_new_full(parts_.format.payload_bytes, parts_.memory->block(i),
                                               nullptr, nullptr));
}

Acquisition::~Acquisition() { stop(); }

void Acquisition::start(std::int64_t trigger_base) {
  trigger_base_ = trigger_base;
  reader_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

void Acquisition::stop() {
  reader_ = std::jthread();
  home_->close();
}

std::int64_t Acquisition::resent_packet_count() const {
  return static_cast<std::int64_t>(
      arv_stream_get_info_uint64_by_name(parts_.stream.get(), "n_resent_packets"));
}

void Acquisition::run(const std::stop_token& stop) {
  const auto timeout_us = static_cast<guint64>(std::chrono::microseconds(kPopTimeout).count());
  while (!stop.stop_requested())
    if (ArvBuffer* buffer = arv_stream_timeout_pop_buffer(parts_.stream.get(), timeout_us))
      handle(buffer);
}

// Posts what became of the buffer; its ownership goes on to the lease or back to the stream.
void Acquisition::handle(ArvBuffer* buffer) {
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
std::optional<std::uint64_t> Acquisition::identify(ArvBuffer* buffer, bool is_whole) {
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

std::optional<Error> Acquisition::find_defect(ArvBuffer* buffer,
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
    return malformed(std::string("(")
                         .append(std::to_string(arv_buffer_get_frame_id(buffer)))
                         .append(") came out of sequence"));
  const bool has_chunks = arv_buffer_has_chunks(buffer) != FALSE;
  if (has_chunks != parts_.chunks.is_active())
    return malformed(has_chunks ? "has chunks that were not asked for" : "lacks its chunks");
  if (!has_chunks && arv_buffer_get_payload_type(buffer) != ARV_BUFFER_PAYLOAD_TYPE_IMAGE)
    return malformed("is no image");
  if (const auto defect = find_image_defect(buffer)) return malformed(*defect);
  return std::nullopt;
}

std::optional<std::string> Acquisition::find_image_defect(ArvBuffer* buffer) const {
  const FrameFormat& format = parts_.format;
  const int width_px = arv_buffer_get_image_width(buffer);
  const int height_px = arv_buffer_get_image_height(buffer);
  if (width_px != format.width_px || height_px != format.height_px)
    return std::string("is ")
        .append(size_text(width_px, height_px))
        .append(" instead of ")
        .append(size_text(format.width_px, format.height_px));
  int row_padding_bytes = 0;
  int end_padding_bytes = 0;
  arv_buffer_get_image_padding(buffer, &row_padding_bytes, &end_padding_bytes);
  if (row_padding_bytes != 0)
    return std::string("has ")
        .append(std::to_string(row_padding_bytes))
        .append(" bytes behind each row; choose another width");
  if (arv_buffer_get_image_pixel_format(buffer) != format.pixel_format_code)
    return std::string("is not in ").append(format.pixel_format);
  std::size_t byte_count = 0;
  arv_buffer_get_data(buffer, &byte_count);
  if (byte_count != format.payload_bytes)
    return std::string("has ")
        .append(std::to_string(byte_count))
        .append(" bytes instead of ")
        .append(std::to_string(format.payload_bytes));
  return std::nullopt;
}

Result<Frame> Acquisition::make_frame(ArvBuffer* buffer, std::uint64_t block_id) const {
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
  if (auto read = parts_.chunks.read(buffer, trigger_base_, frame); !read)
    return tl::unexpected(read.error());
  return frame;
}

}  // namespace rig
