// The in-process rig around the ledger world, as capture's tests use it: the paper's 88 patterns in
// two exposures on a projector of 64 x 48 px, so that a capture takes milliseconds.
#pragma once

#include <algorithm>
#include <map>
#include <numeric>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "capture/runner.h"
#include "hw_sim/devices/in_process_rig.h"
#include "hw_sim/devices/ledger_world.h"
#include "rig/rig_file.h"

namespace capture {

inline rig::RigFile ledger_rig_file() {
  rig::RigFile rig_file;
  rig_file.name = "ledger";
  rig_file.projector.monitor = "SIM-1";
  rig_file.projector.width_px = 64;
  rig_file.projector.height_px = 48;
  rig_file.projector.sync_square.size_px = 8;
  rig_file.camera.pixel_format = "Mono16";
  rig_file.camera.width_px = hw_sim::LedgerWorld::kWidthPx;
  rig_file.camera.height_px = hw_sim::LedgerWorld::kHeightPx;
  rig_file.sensor.saturation_level_dn = 65535;
  rig_file.sequence.exposures = {std::chrono::microseconds(10'000),
                                 std::chrono::microseconds(40'000)};
  return rig_file;
}

// The same without a trigger box.
inline rig::RigFile boxless_rig_file(rig::SyncMode sync) {
  rig::RigFile rig_file = ledger_rig_file();
  rig_file.sequence.sync = sync;
  if (sync == rig::SyncMode::kSoftware)
    rig_file.camera.trigger_line = rig::kSoftwareTrigger;
  else
    rig_file.camera.trigger_edge = rig::TriggerEdge::kAny;
  return rig_file;
}

// 88 patterns although the projector is small: 176 slots, as the real thing has.
inline Plan ledger_plan(const rig::RigFile& rig_file) {
  Plan plan{"paper", estimation::paper_patterns(), {}, rig_file.sequence.exposures};
  plan.order.resize(plan.patterns.size());
  std::iota(plan.order.begin(), plan.order.end(), 0);
  return plan;
}

// Keeps what the frames say of themselves.
class IdentityKeeper final : public FrameConsumer {
 public:
  void consume(const CapturedFrame& captured) override {
    const FrameSamples samples(*captured.frame);
    const auto identity = hw_sim::decode_identity(samples.view());
    ++frame_count;
    if (!identity) return;
    frames.push_back({captured, *identity});
  }
  std::optional<std::string> failure() const override { return injected_failure; }

  struct Kept {
    CapturedFrame captured;
    hw_sim::FrameIdentity identity;
  };
  int frame_count = 0;
  std::vector<Kept> frames;  // of those whose identity could be read
  std::optional<std::string> injected_failure;
};

// A fault at the showing of a slot, as long as nothing before it is retaken.
inline hw_sim::PlannedFault fault_at(hw_sim::FaultKind kind, int showing, int bracket = 0,
                                     int count = 1) {
  hw_sim::PlannedFault fault = hw_sim::default_fault(kind);
  fault.place = hw_sim::FaultPlace{showing, bracket};
  fault.count = count;
  return fault;
}

struct LedgerCapture {
  explicit LedgerCapture(const hw_sim::FaultPlan& faults = {},
                         const rig::RigFile& rig_file_in = ledger_rig_file(),
                         const hw_sim::CameraTiming& camera_timing = {},
                         const hw_sim::DisplayTiming& display_timing = {},
                         std::chrono::milliseconds opening_time = {})
      : rig_file(rig_file_in),
        plan(ledger_plan(rig_file)),
        display(display_timing),
        rig(world, {rig_file.projector, rig_file.trigger, rig_file.camera, display_timing,
                    camera_timing, faults, rig_file.sequence.sync, opening_time}) {
    const int left_px = rig_file.projector.width_px - rig_file.projector.sync_square.size_px;
    const int top_px = rig_file.projector.height_px - rig_file.projector.sync_square.size_px;
    for (auto& picture : render_pictures(plan, rig_file.projector)) {
      for (const int level : {0, 255}) {
        for (int row = top_px; row < picture.height_px(); ++row)
          for (int col = left_px; col < picture.width_px(); ++col)
            picture.at(row, col) = static_cast<unsigned char>(level);
        picture_hashes.push_back(hw_sim::content_hash(picture));
      }
    }
  }

  SequenceRules rules() {
    SequenceRules made =
        make_rules(rig_file, plan.exposures, rig.projector().report().measured_refresh_hz);
    if (rig_file.sequence.sync == rig::SyncMode::kSoftware) made.ledger.latency = latency();
    return made;
  }

  // As it would be measured: from the report of a swap, in halves of a refresh, with its margin of
  // a whole one.
  std::chrono::nanoseconds latency() const {
    const auto refresh = display.refresh_interval;
    const auto lag = std::max<std::chrono::nanoseconds>(
        refresh * display.input_lag_refreshes + display.light_delay - display.report_delay, {});
    return refresh / 2 * ((lag + refresh / 2 - std::chrono::nanoseconds(1)) / (refresh / 2)) +
           refresh;
  }

  RunResult run(const std::stop_token& stop = {}, const OnTransition& also = {}) {
    return run_capture({rig.projector(), rig.trigger(), rig.camera(), rig.timeline(), &rig}, plan,
                       rig_file.projector, rules(), keeper, stop,
                       [&](const Transition& transition) {
                         for (const Reacted& reacted : transition.reacted)
                           ++incidents[reacted.finding.incident];
                         if (also) also(transition);
                       });
  }

  // Is this frame what its slot says: lit by that pattern and nothing else, to the last pixel, for
  // that bracket's time?
  bool is_its_slots(const IdentityKeeper::Kept& kept) const {
    const hw_sim::FrameIdentity& identity = kept.identity;
    const SlotId slot = kept.captured.slot;
    const auto picture =
        static_cast<std::size_t>(2 * slot.pattern) + (kept.captured.evidence.is_light ? 1U : 0U);
    return identity.light.size() == 1 &&
           hw_sim::shown_picture(identity.light[0].picture_id).picture == slot.pattern &&
           identity.light[0].content_hash == picture_hashes[picture] &&
           identity.exposure == plan.exposures[static_cast<std::size_t>(slot.bracket)] &&
           identity.light[0].duration == identity.exposure;
  }

  // Frames handed to the consumer that are not what their slot says.
  int wrong_frame_count() const {
    int count = keeper.frame_count - static_cast<int>(keeper.frames.size());
    for (const auto& kept : keeper.frames)
      if (!is_its_slots(kept)) ++count;
    return count;
  }

  hw_sim::LedgerWorld world;
  rig::RigFile rig_file;
  Plan plan;
  hw_sim::DisplayTiming display;
  hw_sim::InProcessRig rig;
  IdentityKeeper keeper;
  std::map<Incident, int> incidents;
  std::vector<std::uint64_t> picture_hashes;  // [2 * pattern + is square light]
};

}  // namespace capture
