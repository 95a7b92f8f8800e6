// What goes wrong between the computer and the trigger box, provoked at the far end of the wire.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <variant>

#include "tests/wire/usb/wire_trigger_rig.h"

namespace {

using namespace std::chrono_literals;
using rig::Fault;
using testing::HasSubstr;
using trigger_contract::kDark_adc;
using trigger_contract::kLight_adc;

class TriggerFaults : public testing::Test {
 protected:
  void SetUp() override {
    wire = WireTriggerRig::plug_in();
    ASSERT_NE(wire, nullptr) << "without umockdev's preload library";
  }

  void open_and_arm(std::uint32_t run_id = 1) {
    const auto opened = wire->open();
    ASSERT_TRUE(opened) << opened.error().detail;
    const auto armed = wire->trigger().arm({1ms}, run_id);
    ASSERT_TRUE(armed) << armed.error().detail;
  }

  void light(int level_adc) { wire->light(wire->now() + 5ms, level_adc); }

  // The next event of type `T`; all others are passed over, faults only if `may_pass_faults`.
  template <typename T>
  std::optional<T> next(bool may_pass_faults = false) {
    const rig::HostTime deadline = wire->now() + 20s;
    while (const auto event = wire->wait(deadline)) {
      if (const auto* wanted = std::get_if<T>(&*event)) return *wanted;
      const auto* fault = std::get_if<rig::DeviceFault>(&*event);
      if (fault != nullptr && !may_pass_faults) {
        ADD_FAILURE() << "unexpected fault: " << fault->error.detail;
        return std::nullopt;
      }
    }
    return std::nullopt;
  }
  void expect_fault(Fault fault) {
    const auto posted = next<rig::DeviceFault>();
    ASSERT_TRUE(posted);
    EXPECT_EQ(posted->error.fault, fault) << posted->error.detail;
    EXPECT_EQ(posted->device, rig::Device::kTrigger);
  }
  void expect_a_pulse(bool may_pass_faults = false) {
    EXPECT_TRUE(next<rig::PulseEnded>(may_pass_faults));
  }
  // Of everything posted up to now.
  int pending_fault_count() {
    int count = 0;
    while (const auto event = wire->wait(wire->now())) {
      count += std::holds_alternative<rig::DeviceFault>(*event) ? 1 : 0;
    }
    return count;
  }

  std::unique_ptr<WireTriggerRig> wire;
};

// ---- Opening ----

TEST_F(TriggerFaults, NothingPluggedInSaysWhatToCheck) {
  wire->box().unplug();
  const auto opened = wire->open();
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().fault, Fault::kNotFound);
  EXPECT_THAT(opened.error().detail, HasSubstr("1209:0001"));
}

TEST_F(TriggerFaults, OtherUsbDevicesAreNotTaken) {
  auto settings = trigger_contract::settings();
  settings.product_id = 0x0002;
  const auto opened = wire->open(settings);
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().fault, Fault::kNotFound);
}

TEST_F(TriggerFaults, WrongSerialNamesTheOneThatIsThere) {
  auto settings = trigger_contract::settings();
  settings.serial = "TB-0042";
  const auto opened = wire->open(settings);
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().fault, Fault::kNotFound);
  EXPECT_THAT(opened.error().detail, HasSubstr("TB-0042"));
  EXPECT_THAT(opened.error().detail, HasSubstr("TB-SIM-0001"));
}

TEST_F(TriggerFaults, TwoBoxesNeedASerial) {
  hw_sim::UsbTriggerBox second(wire->testbed(), {.serial = "TB-SIM-0002", .address = {1, 9}},
                               [](hw_sim::LinePulse) {});
  auto settings = trigger_contract::settings();
  const auto opened = wire->open(settings);
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().fault, Fault::kConfiguration);
  EXPECT_THAT(opened.error().detail, HasSubstr("TB-SIM-0001"));
  EXPECT_THAT(opened.error().detail, HasSubstr("TB-SIM-0002"));

  settings.serial = "TB-SIM-0002";
  const auto chosen = wire->open(settings);
  ASSERT_TRUE(chosen) << chosen.error().detail;
  EXPECT_EQ(wire->trigger().identity().serial, "TB-SIM-0002");
  wire->close();
}

TEST_F(TriggerFaults, BoxHeldByAnotherProgramIsAccessDenied) {
  wire->box().refuse_claims(true);
  const auto opened = wire->open();
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().fault, Fault::kAccessDenied);
  EXPECT_THAT(opened.error().detail, HasSubstr("another program"));
}

// ---- Running ----

TEST_F(TriggerFaults, PulsesReachTheCamerasLineAsTheyAreReported) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm());
  light(kLight_adc);
  const auto pulse = next<rig::PulseEnded>();
  ASSERT_TRUE(pulse);
  const auto line = wire->line_pulses(1);
  ASSERT_EQ(line.size(), 1u);
  EXPECT_EQ(line[0].width, 1ms);
  // Half a round trip of clock uncertainty, on a loaded machine.
  EXPECT_LT(std::chrono::abs(line[0].start - pulse->started), 50ms);
}

TEST_F(TriggerFaults, UnpluggedWhileArmedIsLostOnceAndReopensAfterReplug) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm());
  light(kLight_adc);
  expect_a_pulse();
  wire->box().unplug();
  expect_fault(Fault::kDeviceLost);

  EXPECT_EQ(wire->trigger().counters().error().fault, Fault::kDeviceLost);
  wire->trigger().disarm();
  EXPECT_EQ(wire->trigger().arm({1ms}, 2).error().fault, Fault::kDeviceLost);
  wire->close();
  EXPECT_EQ(pending_fault_count(), 0);

  wire->box().replug();
  ASSERT_NO_FATAL_FAILURE(open_and_arm(3));
  light(kDark_adc);
  expect_a_pulse();
}

TEST_F(TriggerFaults, UnpluggedWhileIdleIsLost) {
  ASSERT_TRUE(wire->open());
  wire->box().unplug();
  expect_fault(Fault::kDeviceLost);
}

TEST_F(TriggerFaults, LostRecordIsASequenceGapAndTheRunGoesOn) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm());
  light(kLight_adc);
  expect_a_pulse();
  wire->box().drop_next_record();  // at the latest the next heartbeat
  expect_fault(Fault::kSequenceGap);
  light(kDark_adc);
  expect_a_pulse();
}

TEST_F(TriggerFaults, StalledEndpointIsClearedAndReadAgain) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm());
  for (const int level_adc : {kLight_adc, kDark_adc}) {
    wire->box().stall_in();
    expect_fault(Fault::kProtocol);
    light(level_adc);
    expect_a_pulse();
  }
}

TEST_F(TriggerFaults, EndpointThatStallsForEverIsLost) {
  ASSERT_TRUE(wire->open());
  wire->box().set_mute(true);  // no good read in between
  for (int i = 0; i < 100; ++i) {
    wire->box().stall_in();
    const auto fault = next<rig::DeviceFault>();
    ASSERT_TRUE(fault);
    if (fault->error.fault == Fault::kDeviceLost) return;
  }
  FAIL() << "read for ever";
}

TEST_F(TriggerFaults, RequestsThatAreNotAnsweredTimeOut) {
  ASSERT_TRUE(wire->open());
  wire->box().set_control_naked(true);
  EXPECT_EQ(wire->trigger().counters().error().fault, Fault::kTimeout);
  EXPECT_EQ(wire->trigger().arm({1ms}, 1).error().fault, Fault::kTimeout);
  wire->box().set_control_naked(false);
  const auto armed = wire->trigger().arm({1ms}, 2);
  ASSERT_TRUE(armed) << armed.error().detail;
  light(kLight_adc);
  expect_a_pulse();
}

TEST_F(TriggerFaults, DisarmThatIsNotAnsweredIsReported) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm());
  wire->box().set_control_naked(true);
  wire->trigger().disarm();
  expect_fault(Fault::kTimeout);
  wire->box().set_control_naked(false);
}

TEST_F(TriggerFaults, SilentBoxIsATimeoutOnceUntilItSpeaksAgain) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm());
  light(kLight_adc);
  expect_a_pulse();
  wire->box().set_mute(true);
  expect_fault(Fault::kTimeout);
  wire->box().set_mute(false);
  expect_fault(Fault::kSequenceGap);  // what it said in between
  light(kDark_adc);
  expect_a_pulse();
  wire->box().set_mute(true);
  expect_fault(Fault::kTimeout);
}

TEST_F(TriggerFaults, ConfigurationThatDoesNotTakeIsNotArmed) {
  ASSERT_TRUE(wire->open());
  wire->box().corrupt_next_config();
  EXPECT_EQ(wire->trigger().arm({1ms}, 1).error().fault, Fault::kReadBackMismatch);
  const auto again = wire->trigger().arm({1ms}, 2);
  EXPECT_TRUE(again) << again.error().detail;
}

TEST_F(TriggerFaults, ClosingDisarmsTheBox) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm());
  wire->close();
  wire->light(wire->now(), kLight_adc);  // seen before anything that is asked of the box later
  ASSERT_NO_FATAL_FAILURE(open_and_arm(2));
  light(kDark_adc);
  expect_a_pulse();
  EXPECT_EQ(wire->line_pulses(1).size(), 1u);
}

TEST_F(TriggerFaults, LevelsAreReadForTheOperator) {
  ASSERT_TRUE(wire->open());
  const rig::HostTime start = wire->now();
  wire->light(start, 77);
  wire->light(start, 901);
  const auto levels = wire->usb_trigger().levels();
  ASSERT_TRUE(levels) << levels.error().detail;
  EXPECT_EQ(levels->minimum_adc, 0);
  EXPECT_EQ(levels->maximum_adc, 901);
}

}  // namespace
