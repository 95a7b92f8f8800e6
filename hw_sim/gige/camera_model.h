// The simulated camera without sockets: what its registers mean for acquisition, trigger, sequencer
// and chunks.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <span>

#include "estimation/base/image.h"
#include "hw_sim/exposure_engine.h"
#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/gige/gvsp.h"
#include "hw_sim/gige/pixel_format.h"
#include "hw_sim/gige/register_map.h"

namespace hw_sim {

// The camera's own clock: another epoch and another crystal than the host's.
struct CameraOscillator {
  rig::HostTime power_up;
  std::chrono::nanoseconds offset{0};  // reading at power_up
  double drift_ppm = 0;                // fast when positive

  rig::CameraClock::time_point at(rig::HostTime time) const;
};

// An exposure under way, with the settings it was started under.
struct Shot {
  ExposureJob job;
  std::uint64_t acquisition_number = 0;
  ShotFaults faults{};
};

// Not thread-safe: its owner locks.
class CameraModel {
 public:
  CameraModel(const DeviceDescription& description, std::chrono::microseconds readout,
              CameraOscillator oscillator);

  GvcpStatus read(std::uint32_t address, std::span<std::uint8_t> bytes);
  // Everything but the control and stream channels, which are the device's.
  GvcpStatus write(std::uint32_t address, std::uint32_t value, rig::HostTime now);

  // A pulse on Line1. nullopt where it starts no exposure.
  std::optional<Shot> pulse(rig::HostTime start, std::chrono::microseconds width);
  // Line1 has that level from `time` on; what it triggers is pulse()'s.
  void set_line(rig::HostTime time, bool is_high);
  // Is Line1's going up, or down, a trigger? Where it is inverted, pulse() begins at its end.
  bool is_trigger(bool is_rise) const;
  // A shot by TriggerSoftware since the last call.
  std::optional<Shot> take_software_shot();

  void stop_acquisition();
  bool is_acquiring() const { return is_acquiring_; }
  std::uint64_t acquisition_number() const { return acquisition_number_; }

  // The shot's frame: the region of interest of `sensor_dn` in the pixel format, and the chunks
  // behind it. Uses up a block id.
  void fill_block(const Shot& shot, estimation::ImageView<const std::uint16_t> sensor_dn,
                  bool has_64_bit_id, GvspBlock& block);

  RegisterMap& registers() { return registers_; }
  const RegisterMap& registers() const { return registers_; }
  const ExposureEngine& engine() const { return engine_; }
  // Exposures of one round of the sequencer; 1 without.
  int bracket_count() const;
  float balance_ratio(std::size_t colour) const { return balance_ratios_[colour]; }
  void slip_sequencer() { engine_.slip(); }
  void jump_clock(std::chrono::nanoseconds step) { oscillator_.offset += step; }

 private:
  struct SavedSet {
    float exposure_us = 10'000;
    std::uint32_t next_set = 0;
    std::uint32_t trigger = 0;
  };

  bool is_inverted() const;
  void refresh();  // registers that show state
  GvcpStatus check_state(std::uint32_t address, std::uint32_t value) const;
  void apply(std::uint32_t address, rig::HostTime now);
  void step_gain();
  void start_acquisition();
  void save_set();
  void load_set();
  std::optional<Shot> shoot(rig::HostTime start, std::chrono::microseconds width);
  PixelFormat pixel_format() const;
  std::size_t image_bytes() const;
  std::size_t chunk_bytes() const;
  std::uint64_t counter(Counter which) const;
  std::uint64_t line_status(rig::HostTime time) const;
  void append_chunks(const ExposureJob& job, GvspBlock& block) const;
  std::uint64_t chunk_content(Chunk chunk, const ExposureJob& job, const GvspBlock& block) const;

  RegisterMap registers_;
  ExposureEngine engine_;
  CameraOscillator oscillator_;
  std::array<SavedSet, ExposureEngine::kSetCount> saved_sets_;
  std::array<bool, kChunkCount> is_chunk_enabled_{true};  // the image always is
  std::array<std::uint64_t, kCounterCount> counter_base_{};
  std::array<float, kColourCount> balance_ratios_;
  double gain_step_db_;
  bool is_acquiring_ = false;
  std::uint64_t acquisition_number_ = 0;
  std::uint64_t last_block_id_ = 0;
  std::optional<Shot> software_shot_;
  std::map<rig::HostTime, bool> line_changes_;  // Line1's latest, and its level from then on
};

}  // namespace hw_sim
