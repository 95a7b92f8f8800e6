// The in-process devices keep the same contracts as the ones behind wires.
#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <optional>

#include "hw_sim/devices/in_process_rig.h"
#include "hw_sim/devices/ledger_world.h"
#include "tests/contract/camera_contract.h"
#include "tests/contract/projector_contract.h"
#include "tests/contract/trigger_contract.h"

namespace {

class SimTriggerRig final : public trigger_contract::TriggerRig {
 public:
  rig::Trigger& trigger() override { return trigger_; }
  rig::HostTime now() override { return timeline_.now(); }
  void light(rig::HostTime time, int level_adc) override {
    timeline_.schedule(time, [this, level_adc] { trigger_.photodiode(level_adc); });
  }
  std::optional<rig::Event> wait(rig::HostTime deadline) override {
    return timeline_.wait(deadline, {});
  }

 private:
  hw_sim::FaultSchedule faults_;
  hw_sim::Timeline timeline_;
  hw_sim::SimTrigger trigger_{trigger_contract::settings(), faults_, timeline_,
                              [](const hw_sim::LinePulse&) {}};
};

std::unique_ptr<trigger_contract::TriggerRig> make_sim_trigger_rig() {
  return std::make_unique<SimTriggerRig>();
}

class SimCameraBench final : public CameraBench {
 public:
  explicit SimCameraBench(rig::Bracketing bracketing) {
    settings_.pixel_format = "Mono16";
    settings_.bracketing = bracketing;
  }
  rig::Result<std::unique_ptr<rig::Camera>> open() override {
    auto camera = std::make_unique<hw_sim::SimCamera>(settings_, hw_sim::CameraTiming{}, faults_,
                                                      timeline_, world_, light_);
    camera_ = camera.get();
    return camera;
  }
  void pulse(std::chrono::microseconds width) override { camera_->pulse({timeline_.now(), width}); }
  rig::EventSource& source() override { return timeline_; }
  std::chrono::microseconds readout() const override { return hw_sim::CameraTiming{}.readout; }

 private:
  hw_sim::FaultSchedule faults_;
  hw_sim::Timeline timeline_;
  hw_sim::LedgerWorld world_;
  hw_sim::LightTimeline light_;
  rig::CameraSettings settings_;
  hw_sim::SimCamera* camera_ = nullptr;  // the one that is open, owned by the test
};

struct SimProjectorFixture {
  static rig::ProjectorSettings settings() {
    rig::ProjectorSettings settings;
    settings.monitor = "SIM-1";
    settings.width_px = 64;
    settings.height_px = 48;
    settings.sync_square.size_px = 8;
    return settings;
  }
  void run(const std::function<void(rig::Projector&, rig::EventSource&)>& body) {
    hw_sim::FaultSchedule faults;
    hw_sim::Timeline timeline;
    hw_sim::SimProjector projector(
        settings(), {}, faults, timeline,
        [](const std::shared_ptr<const hw_sim::Picture>&, bool, const hw_sim::FlipFaults&) {});
    body(projector, timeline);
  }
};

}  // namespace

INSTANTIATE_TEST_SUITE_P(InProcess, TriggerContract, testing::Values(&make_sim_trigger_rig));

INSTANTIATE_TEST_SUITE_P(InProcess, CameraContract,
                         testing::Values(CameraBenchMaker{"Sequencer",
                                                          [] {
                                                            return std::make_unique<SimCameraBench>(
                                                                rig::Bracketing::kSequencer);
                                                          }},
                                         CameraBenchMaker{"TriggerWidth",
                                                          [] {
                                                            return std::make_unique<SimCameraBench>(
                                                                rig::Bracketing::kTriggerWidth);
                                                          }}),
                         camera_bench_name);

namespace rig::contract {
INSTANTIATE_TYPED_TEST_SUITE_P(InProcess, ProjectorContract, SimProjectorFixture);
}  // namespace rig::contract
