#include "hw_sim/gige/camera_model.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <iterator>

#include "hw_sim/gige/big_endian.h"

namespace hw_sim {
namespace {

constexpr std::uint32_t value_of(auto enumerator) { return static_cast<std::uint32_t>(enumerator); }
constexpr std::size_t kChunkTrailerBytes = 8;  // id and length behind each chunk
// More than there can be while an exposure is read out.
constexpr std::size_t kLineChangeLimit = 256;

std::chrono::microseconds to_microseconds(float exposure_us) {
  return std::chrono::microseconds(std::llround(exposure_us));
}

// Rows of the region of interest, samples little-endian; 8 bit formats saturate at 255.
void pack_region(estimation::ImageView<const std::uint16_t> region, const PixelFormat& format,
                 std::uint8_t* out) {
  for (int row = 0; row < region.height_px; ++row) {
    for (const std::uint16_t sample : region.row(row)) {
      if (format.bytes_per_sample() == 1) {
        *out++ = static_cast<std::uint8_t>(std::min<std::uint16_t>(sample, 255));
      } else {
        *out++ = static_cast<std::uint8_t>(sample);
        *out++ = static_cast<std::uint8_t>(sample >> 8);
      }
    }
  }
}

std::uint64_t next_block_id(std::uint64_t last, bool has_64_bit_id) {
  // 16 bit ids skip 0 when they wrap.
  return !has_64_bit_id && last == 0xFFFF ? 1 : last + 1;
}

}  // namespace

rig::CameraClock::time_point CameraOscillator::at(rig::HostTime time) const {
  const auto elapsed = std::chrono::duration_cast<std::chrono::nanoseconds>(time - power_up);
  const auto drift = std::chrono::nanoseconds(
      std::llround(static_cast<double>(elapsed.count()) * drift_ppm * 1e-6));
  return rig::CameraClock::time_point(offset + elapsed + drift);
}

CameraModel::CameraModel(const DeviceDescription& description, std::chrono::microseconds readout,
                         CameraOscillator oscillator)
    : registers_(description),
      oscillator_(oscillator),
      balance_ratios_(description.variant.balance_ratios),
      gain_step_db_(description.variant.gain_step_db) {
  engine_.readout = readout;
}

GvcpStatus CameraModel::read(std::uint32_t address, std::span<std::uint8_t> bytes) {
  refresh();
  return registers_.read(address, bytes);
}

GvcpStatus CameraModel::write(std::uint32_t address, std::uint32_t value, rig::HostTime now) {
  GvcpStatus status = registers_.check_write(address, value);
  if (status == GvcpStatus::kSuccess) status = check_state(address, value);
  if (status != GvcpStatus::kSuccess) return status;
  const int depth_before = pixel_format().bit_depth;
  registers_.set(address, value);
  if (const int depth = pixel_format().bit_depth; depth != depth_before)
    registers_.set_float(kBlackLevel,
                         std::ldexp(registers_.get_float(kBlackLevel), depth - depth_before));
  apply(address, now);
  return status;
}

std::optional<Shot> CameraModel::pulse(rig::HostTime start, std::chrono::microseconds width) {
  if (registers_.get(kTriggerSource) != value_of(TriggerSource::kLine1)) return std::nullopt;
  return shoot(is_inverted() ? start + width : start, width);
}

void CameraModel::set_line(rig::HostTime time, bool is_high) {
  line_changes_.insert_or_assign(time, is_high);
  if (line_changes_.size() > kLineChangeLimit) line_changes_.erase(line_changes_.begin());
}

// LineStatusAll, as it was at `time`.
std::uint64_t CameraModel::line_status(rig::HostTime time) const {
  const auto later = line_changes_.upper_bound(time);
  const bool is_high = later != line_changes_.begin() && std::prev(later)->second;
  return is_high != is_inverted() ? std::uint64_t{1} << value_of(Line::kLine1) : 0;
}

bool CameraModel::is_trigger(bool is_rise) const {
  return is_acquiring_ && registers_.get(kTriggerSource) == value_of(TriggerSource::kLine1) &&
         (is_rise != is_inverted() ||
          registers_.get(kTriggerActivation) == value_of(TriggerActivation::kAnyEdge));
}

bool CameraModel::is_inverted() const { return registers_.get(kLineInverter) != 0; }

std::optional<Shot> CameraModel::take_software_shot() {
  return std::exchange(software_shot_, std::nullopt);
}

void CameraModel::stop_acquisition() {
  is_acquiring_ = false;
  registers_.set(kParamsLocked, 0);
}

void CameraModel::fill_block(const Shot& shot, estimation::ImageView<const std::uint16_t> sensor_dn,
                             bool has_64_bit_id, GvspBlock& block) {
  const PixelFormat format = pixel_format();
  last_block_id_ = next_block_id(last_block_id_, has_64_bit_id);
  block.id = last_block_id_;
  block.has_64_bit_id = has_64_bit_id;
  block.has_chunks = registers_.get(kChunkModeActive) != 0;
  block.timestamp_ns =
      static_cast<std::uint64_t>(oscillator_.at(shot.job.start).time_since_epoch().count());
  block.pixel_format = format.code;
  block.width_px = registers_.get(kWidth);
  block.height_px = registers_.get(kHeight);
  block.offset_x_px = registers_.get(kOffsetX);
  block.offset_y_px = registers_.get(kOffsetY);
  block.packet_size_bytes = registers_.get(kStreamPacketSize) & 0xFFFF;
  block.payload.resize(image_bytes() + chunk_bytes());
  const estimation::ImageView<const std::uint16_t> region{
      &sensor_dn.at(static_cast<int>(block.offset_y_px), static_cast<int>(block.offset_x_px)),
      static_cast<int>(block.height_px), static_cast<int>(block.width_px), format.channel_count,
      sensor_dn.stride};
  pack_region(region, format, block.payload.data());
  if (block.has_chunks) append_chunks(shot.job, block);
}

void CameraModel::refresh() {
  const std::uint32_t chunk = registers_.get(kChunkSelector);
  const std::uint32_t counter_number = registers_.get(kCounterSelector);
  const auto low_word = [](std::uint64_t value) { return static_cast<std::uint32_t>(value); };
  registers_.set(kChunkEnable, is_chunk_enabled_[chunk] ? 1 : 0);
  registers_.set_float(kBalanceRatio, balance_ratios_[registers_.get(kBalanceRatioSelector)]);
  registers_.set(kCounterEventSource, counter_number);
  registers_.set(kCounterValue, low_word(counter(static_cast<Counter>(counter_number))));
  registers_.set(kTriggerMissedCount, low_word(counter(Counter::kMissedTriggers)));
  registers_.set(kSequencerSetActive, static_cast<std::uint32_t>(engine_.active_set()));
  registers_.set(kPayloadSize, low_word(image_bytes() + chunk_bytes()));
}

GvcpStatus CameraModel::check_state(std::uint32_t address, std::uint32_t value) const {
  const auto allow = [](bool is_allowed, GvcpStatus status) {
    return is_allowed ? GvcpStatus::kSuccess : status;
  };
  switch (address) {
    case kWidth:
      return allow(registers_.get(kOffsetX) + value <= registers_.get(kSensorWidth),
                   GvcpStatus::kInvalidParameter);
    case kHeight:
      return allow(registers_.get(kOffsetY) + value <= registers_.get(kSensorHeight),
                   GvcpStatus::kInvalidParameter);
    case kOffsetX:
      return allow(registers_.get(kWidth) + value <= registers_.get(kSensorWidth),
                   GvcpStatus::kInvalidParameter);
    case kOffsetY:
      return allow(registers_.get(kHeight) + value <= registers_.get(kSensorHeight),
                   GvcpStatus::kInvalidParameter);
    case kChunkEnable:
      return allow(value != 0 || registers_.get(kChunkSelector) != value_of(Chunk::kImage),
                   GvcpStatus::kInvalidParameter);
    case kSequencerMode:  // SFNC: the sequencer runs only once it is configured
      return allow(!is_acquiring_ && registers_.get(kSequencerConfigurationMode) == 0,
                   GvcpStatus::kAccessDenied);
    case kSequencerConfigurationMode:
      return allow(!is_acquiring_ && registers_.get(kSequencerMode) == 0,
                   GvcpStatus::kAccessDenied);
    case kSequencerSetSave:
    case kSequencerSetLoad:
      return allow(registers_.get(kSequencerConfigurationMode) != 0, GvcpStatus::kAccessDenied);
    case kExposureMode:
    case kTriggerMode:
    case kTriggerSource:
    case kSequencerSetStart:
      return allow(!is_acquiring_, GvcpStatus::kAccessDenied);
    default:
      return GvcpStatus::kSuccess;
  }
}

void CameraModel::apply(std::uint32_t address, rig::HostTime now) {
  switch (address) {
    case kAcquisitionStart:
      return start_acquisition();
    case kAcquisitionStop:
      return stop_acquisition();
    case kTriggerSoftware:
      if (registers_.get(kTriggerSource) == value_of(TriggerSource::kSoftware))
        software_shot_ = shoot(now, to_microseconds(registers_.get_float(kExposureTime)));
      return;
    case kExposureTime:
      engine_.fixed_exposure = to_microseconds(registers_.get_float(kExposureTime));
      return;
    case kChunkEnable:
      is_chunk_enabled_[registers_.get(kChunkSelector)] = registers_.get(kChunkEnable) != 0;
      return;
    case kGain:
      return step_gain();
    case kBalanceRatio:
      balance_ratios_[registers_.get(kBalanceRatioSelector)] = registers_.get_float(kBalanceRatio);
      return;
    case kSequencerSetSave:
      return save_set();
    case kSequencerSetLoad:
      return load_set();
    case kCounterReset: {
      const auto which = static_cast<Counter>(registers_.get(kCounterSelector));
      counter_base_[value_of(which)] += counter(which);
      return;
    }
    case kTimestampControl:
      registers_.set64(kTimestampLatched,
                       static_cast<std::uint64_t>(oscillator_.at(now).time_since_epoch().count()));
      return;
    default:
      return;
  }
}

void CameraModel::step_gain() {
  if (gain_step_db_ <= 0) return;
  const double wanted_db{registers_.get_float(kGain)};
  registers_.set_float(kGain,
                       static_cast<float>(std::floor(wanted_db / gain_step_db_) * gain_step_db_));
}

void CameraModel::start_acquisition() {
  engine_.is_sequencer_on = registers_.get(kSequencerMode) != 0;
  engine_.start_set = static_cast<int>(registers_.get(kSequencerSetStart));
  engine_.bracketing = registers_.get(kExposureMode) == value_of(ExposureMode::kTriggerWidth)
                           ? rig::Bracketing::kTriggerWidth
                           : rig::Bracketing::kSequencer;
  engine_.fixed_exposure = to_microseconds(registers_.get_float(kExposureTime));
  engine_.start();
  counter_base_ = {};
  last_block_id_ = 0;
  ++acquisition_number_;
  is_acquiring_ = true;
  registers_.set(kParamsLocked, 1);
}

int CameraModel::bracket_count() const {
  if (!engine_.is_sequencer_on) return 1;
  int count = 1;
  const auto next = [this](int set) {
    return engine_.sets[static_cast<std::size_t>(set)].next_set;
  };
  for (int set = next(engine_.start_set); set != engine_.start_set && count < engine_.kSetCount;
       set = next(set))
    ++count;
  return count;
}

void CameraModel::save_set() {
  const std::uint32_t number = registers_.get(kSequencerSetSelector);
  SavedSet& set = saved_sets_[number];
  set = {.exposure_us = registers_.get_float(kExposureTime),
         .next_set = registers_.get(kSequencerSetNext),
         .trigger = registers_.get(kSequencerTriggerSource)};
  // Without a trigger the sequencer stays in its set.
  const bool moves = set.trigger == value_of(SequencerTrigger::kFrameStart);
  engine_.sets[number] = {.exposure = to_microseconds(set.exposure_us),
                          .next_set = static_cast<int>(moves ? set.next_set : number)};
}

void CameraModel::load_set() {
  const SavedSet& set = saved_sets_[registers_.get(kSequencerSetSelector)];
  registers_.set_float(kExposureTime, set.exposure_us);
  registers_.set(kSequencerSetNext, set.next_set);
  registers_.set(kSequencerTriggerSource, set.trigger);
}

std::optional<Shot> CameraModel::shoot(rig::HostTime start, std::chrono::microseconds width) {
  if (!is_acquiring_ || registers_.get(kTriggerMode) == 0) return std::nullopt;
  const std::optional<ExposureJob> job =
      engine_.trigger(start + to_microseconds(registers_.get_time_us(kTriggerDelay)), width);
  if (!job) return std::nullopt;
  return Shot{*job, acquisition_number_};
}

PixelFormat CameraModel::pixel_format() const {
  return find_pixel_format(registers_.get(kPixelFormat)).value_or(PixelFormat{});
}

std::size_t CameraModel::image_bytes() const {
  return std::size_t{registers_.get(kWidth)} * registers_.get(kHeight) *
         static_cast<std::size_t>(pixel_format().bytes_per_pixel());
}

std::size_t CameraModel::chunk_bytes() const {
  if (registers_.get(kChunkModeActive) == 0) return 0;
  const auto enabled_count = static_cast<std::size_t>(
      std::count(is_chunk_enabled_.begin(), is_chunk_enabled_.end(), true));
  return enabled_count * kChunkTrailerBytes + (enabled_count - 1) * kChunkBytes;
}

std::uint64_t CameraModel::counter(Counter which) const {
  const std::uint64_t value =
      which == Counter::kTriggers ? engine_.trigger_count() : engine_.missed_count();
  return value - counter_base_[value_of(which)];
}

// Each chunk is its content followed by its id and length, the image first.
void CameraModel::append_chunks(const ExposureJob& job, GvspBlock& block) const {
  const std::size_t image = image_bytes();
  WordWriter out(block.payload.data() + image);
  out.u32(kImageChunkId);
  out.u32(static_cast<std::uint32_t>(image));
  block.chunk_layout_id = 1;
  for (std::uint32_t number = 1; number < kChunkCount; ++number) {
    if (!is_chunk_enabled_[number]) continue;
    out.u64(chunk_content(static_cast<Chunk>(number), job, block));
    out.u32(kFirstChunkId + number);
    out.u32(kChunkBytes);
    block.chunk_layout_id |= 1U << number;
  }
}

std::uint64_t CameraModel::chunk_content(Chunk chunk, const ExposureJob& job,
                                         const GvspBlock& block) const {
  switch (chunk) {
    case Chunk::kExposureTime:
      return std::bit_cast<std::uint64_t>(static_cast<double>(job.duration.count()));
    case Chunk::kFrameId:
      return block.id;
    case Chunk::kCounterValue:
      return job.trigger_number - counter_base_[value_of(Counter::kTriggers)];
    case Chunk::kSequencerSetActive:
      return static_cast<std::uint64_t>(std::max(job.sequencer_set, 0));
    case Chunk::kTimestamp:
      return block.timestamp_ns;
    case Chunk::kLineStatusAll:
      return line_status(job.start);
    case Chunk::kImage:
      break;
  }
  return 0;
}

}  // namespace hw_sim
