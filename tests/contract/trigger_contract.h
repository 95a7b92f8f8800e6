// What every rig::Trigger does, as one suite. It runs on the production driver over a simulated
// wire (tests/wire/usb) and on the in-process trigger (tests/hw_sim/devices). To run it on another:
//
//   INSTANTIATE_TEST_SUITE_P(Mine, TriggerContract, testing::Values(&make_my_trigger_rig));
//
// Include it in the source file that does so, and in no other; trigger_rig.h has the rest.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>
#include <variant>
#include <vector>

#include "rig/event.h"
#include "rig/trigger.h"
#include "tests/contract/trigger_rig.h"

namespace trigger_contract {

// Everything that a trigger said, by kind.
struct Heard {
  std::vector<rig::EdgeSeen> edges;
  std::vector<rig::PulseEnded> pulses;
  std::vector<rig::EdgeIgnored> ignored;
  std::vector<rig::DeviceFault> faults;
};

}  // namespace trigger_contract

class TriggerContract : public testing::TestWithParam<trigger_contract::MakeTriggerRig> {
 protected:
  using Widths = std::vector<std::chrono::microseconds>;

  void SetUp() override {
    rig_ = GetParam()();
    ASSERT_NE(rig_, nullptr);
  }

  rig::Trigger& trigger() { return rig_->trigger(); }

  void arm(const Widths& widths, std::uint32_t run_id) {
    const auto armed = trigger().arm(widths, run_id);
    ASSERT_TRUE(armed) << armed.error().detail;
  }

  // The lamp goes on or off, a little later so that the change is not past when the rig hears it.
  rig::HostTime light_in(std::chrono::milliseconds delay, int level_adc) {
    const rig::HostTime time = rig_->now() + delay;
    rig_->light(time, level_adc);
    return time;
  }

  // Listens until `is_enough(heard_)`. The limit is only for failures: a loaded machine is slow.
  template <typename Predicate>
  void listen_until(Predicate is_enough) {
    const rig::HostTime deadline = rig_->now() + std::chrono::seconds(20);
    while (!is_enough(heard_)) {
      const auto event = rig_->wait(deadline);
      ASSERT_TRUE(event) << "no further event; heard " << heard_.edges.size() << " edges, "
                         << heard_.pulses.size() << " pulses, " << heard_.ignored.size()
                         << " ignored edges, " << heard_.faults.size() << " faults";
      hear(*event);
    }
  }
  void listen_for(std::chrono::milliseconds duration) {
    const rig::HostTime deadline = rig_->now() + duration;
    while (const auto event = rig_->wait(deadline)) hear(*event);
  }
  void listen_until_pulses(std::size_t count) {
    listen_until([count](const auto& heard) { return heard.pulses.size() >= count; });
  }

  void forget() { heard_ = {}; }
  const trigger_contract::Heard& heard() const { return heard_; }

  // A box tick of 1 us at either end of a duration, and the drift of its clock.
  static void expect_duration(rig::HostClock::duration duration,
                              std::chrono::microseconds expected) {
    EXPECT_GE(duration, expected - std::chrono::microseconds(50));
    EXPECT_LE(duration, expected + std::chrono::microseconds(50));
  }

  std::unique_ptr<trigger_contract::TriggerRig> rig_;

 private:
  void hear(const rig::Event& event) {
    if (const auto* edge = std::get_if<rig::EdgeSeen>(&event)) heard_.edges.push_back(*edge);
    if (const auto* pulse = std::get_if<rig::PulseEnded>(&event)) heard_.pulses.push_back(*pulse);
    if (const auto* edge = std::get_if<rig::EdgeIgnored>(&event)) heard_.ignored.push_back(*edge);
    if (const auto* fault = std::get_if<rig::DeviceFault>(&event)) heard_.faults.push_back(*fault);
  }

  trigger_contract::Heard heard_;
};

TEST_P(TriggerContract, SaysWhatItIs) {
  EXPECT_FALSE(trigger().identity().serial.empty());
  EXPECT_EQ(trigger().identity().protocol_version, 1);
}

TEST_P(TriggerContract, EachEdgeIsAnsweredWithItsPulsesInOrder) {
  using namespace std::chrono_literals;
  ASSERT_NO_FATAL_FAILURE(arm({1ms, 2ms, 4ms}, 1));
  light_in(5ms, trigger_contract::kLight_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(3));
  light_in(5ms, trigger_contract::kDark_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(6));

  ASSERT_EQ(heard().edges.size(), 2u);
  EXPECT_TRUE(heard().faults.empty());
  EXPECT_TRUE(heard().ignored.empty());
  const Widths widths = {1ms, 2ms, 4ms};
  for (std::uint32_t i = 0; i < 6; ++i) {
    SCOPED_TRACE(i);
    const rig::PulseEnded& pulse = heard().pulses[i];
    const rig::EdgeSeen& edge = heard().edges[i / 3];
    EXPECT_EQ(edge.edge_number, i / 3 + 1);
    EXPECT_EQ(edge.is_light, i < 3);
    EXPECT_EQ(pulse.edge_number, edge.edge_number);
    EXPECT_EQ(pulse.pulse_index, static_cast<int>(i % 3));
    EXPECT_EQ(pulse.pulse_number, i + 1);
    expect_duration(pulse.ended - pulse.started, widths[i % 3]);
    if (i % 3 == 0) {
      expect_duration(pulse.started - edge.time, edge.is_light ? 1ms : 3ms);
    } else {
      expect_duration(pulse.started - heard().pulses[i - 1].ended, 5ms);
    }
  }
}

TEST_P(TriggerContract, EdgeTimesAreOnTheHostsClock) {
  using namespace std::chrono_literals;
  ASSERT_NO_FATAL_FAILURE(arm({1ms}, 1));
  const rig::HostTime before = rig_->now();
  light_in(5ms, trigger_contract::kLight_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(1));
  // Over a wire the offset is known to half a round trip, some ms on a loaded machine.
  EXPECT_GT(heard().edges.at(0).time, before - 50ms);
  EXPECT_LT(heard().edges.at(0).time, rig_->now() + 50ms);
}

TEST_P(TriggerContract, LightThatIsOnAlreadyIsNoEdge) {
  using namespace std::chrono_literals;
  light_in(1ms, trigger_contract::kLight_adc);
  listen_for(20ms);
  ASSERT_NO_FATAL_FAILURE(arm({1ms}, 1));
  light_in(5ms, trigger_contract::kDark_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(1));
  ASSERT_EQ(heard().edges.size(), 1u);
  EXPECT_FALSE(heard().edges[0].is_light);
}

TEST_P(TriggerContract, RippleBetweenTheThresholdsIsNoEdge) {
  using namespace std::chrono_literals;
  ASSERT_NO_FATAL_FAILURE(arm({1ms}, 1));
  const rig::HostTime start = rig_->now() + 5ms;
  for (int i = 0; i < 20; ++i) rig_->light(start + i * 1ms, i % 2 == 0 ? 590 : 410);
  rig_->light(start + 30ms, trigger_contract::kLight_adc);
  for (int i = 0; i < 20; ++i) rig_->light(start + 40ms + i * 1ms, i % 2 == 0 ? 410 : 900);
  rig_->light(start + 70ms, trigger_contract::kDark_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(2));
  EXPECT_EQ(heard().edges.size(), 2u);
  EXPECT_TRUE(heard().ignored.empty());
}

TEST_P(TriggerContract, EdgeDuringATrainIsReportedAndNotAnswered) {
  using namespace std::chrono_literals;
  ASSERT_NO_FATAL_FAILURE(arm({40ms}, 1));
  const rig::HostTime start = light_in(5ms, trigger_contract::kLight_adc);
  rig_->light(start + 20ms, trigger_contract::kDark_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(1));
  ASSERT_EQ(heard().ignored.size(), 1u);
  EXPECT_FALSE(heard().ignored[0].is_light);
  expect_duration(heard().ignored[0].time - heard().edges.at(0).time, 20ms);
  EXPECT_EQ(heard().edges.size(), 1u);

  const auto counters = trigger().counters();
  ASSERT_TRUE(counters) << counters.error().detail;
  EXPECT_EQ(counters->edge_count, 1u);
  EXPECT_EQ(counters->pulse_count, 1u);
  EXPECT_EQ(counters->ignored_edge_count, 1u);
}

TEST_P(TriggerContract, EdgeWithinTheDebounceTimeIsReportedAndNotAnswered) {
  using namespace std::chrono_literals;
  ASSERT_NO_FATAL_FAILURE(arm({100us}, 1));
  const rig::HostTime start = light_in(5ms, trigger_contract::kLight_adc);
  rig_->light(start + 1500us, trigger_contract::kDark_adc);
  rig_->light(start + 10ms, trigger_contract::kLight_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(2));
  ASSERT_EQ(heard().edges.size(), 2u);
  EXPECT_TRUE(heard().edges[0].is_light);
  EXPECT_TRUE(heard().edges[1].is_light);
  EXPECT_EQ(heard().ignored.size(), 1u);
}

TEST_P(TriggerContract, CountersCountSinceArming) {
  using namespace std::chrono_literals;
  ASSERT_NO_FATAL_FAILURE(arm({100us, 100us}, 1));
  light_in(5ms, trigger_contract::kLight_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(2));
  light_in(5ms, trigger_contract::kDark_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(4));
  const auto counters = trigger().counters();
  ASSERT_TRUE(counters) << counters.error().detail;
  EXPECT_EQ(counters->edge_count, 2u);
  EXPECT_EQ(counters->pulse_count, 4u);
  EXPECT_EQ(counters->ignored_edge_count, 0u);
  EXPECT_EQ(counters->dropped_record_count, 0u);
}

TEST_P(TriggerContract, ArmedIsBusyAndStaysArmed) {
  using namespace std::chrono_literals;
  ASSERT_NO_FATAL_FAILURE(arm({1ms}, 1));
  const auto again = trigger().arm({1ms}, 2);
  ASSERT_FALSE(again);
  EXPECT_EQ(again.error().fault, rig::Fault::kBusy);
  light_in(5ms, trigger_contract::kLight_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(1));
}

TEST_P(TriggerContract, WhatItCannotPulseIsOutOfRangeAndLeavesItIdle) {
  using namespace std::chrono_literals;
  for (const Widths& widths : {Widths{}, Widths(9, 1ms), Widths{0us}, Widths{-1us}}) {
    const auto armed = trigger().arm(widths, 1);
    ASSERT_FALSE(armed);
    EXPECT_EQ(armed.error().fault, rig::Fault::kOutOfRange);
  }
  ASSERT_NO_FATAL_FAILURE(arm(Widths(8, 100us), 2));
  light_in(5ms, trigger_contract::kLight_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until_pulses(8));
  EXPECT_EQ(heard().pulses.back().pulse_index, 7);
}

TEST_P(TriggerContract, DisarmedItAnswersNothing) {
  using namespace std::chrono_literals;
  ASSERT_NO_FATAL_FAILURE(arm({1ms}, 1));
  trigger().disarm();
  forget();
  light_in(5ms, trigger_contract::kLight_adc);
  listen_for(40ms);
  EXPECT_TRUE(heard().edges.empty());
  EXPECT_TRUE(heard().pulses.empty());
  EXPECT_TRUE(heard().faults.empty());
}

TEST_P(TriggerContract, DisarmStopsTheRestOfATrain) {
  using namespace std::chrono_literals;
  ASSERT_NO_FATAL_FAILURE(arm({1ms, 2s}, 1));
  light_in(5ms, trigger_contract::kLight_adc);
  ASSERT_NO_FATAL_FAILURE(listen_until([](const auto& heard) { return !heard.edges.empty(); }));
  trigger().disarm();
  listen_for(0ms);  // what was posted before
  forget();
  listen_for(40ms);
  EXPECT_TRUE(heard().pulses.empty());
  EXPECT_TRUE(heard().faults.empty());
}

TEST_P(TriggerContract, DisarmMayBeCalledIdleAndTwice) {
  using namespace std::chrono_literals;
  trigger().disarm();
  ASSERT_NO_FATAL_FAILURE(arm({1ms}, 1));
  trigger().disarm();
  trigger().disarm();
  ASSERT_NO_FATAL_FAILURE(arm({1ms}, 2));
  listen_for(0ms);
  EXPECT_TRUE(heard().faults.empty());
}

TEST_P(TriggerContract, StartsAgainAndAgainCountingFromOne) {
  using namespace std::chrono_literals;
  bool is_light = false;
  // The last two share an id, as two programs in a row may.
  for (const std::uint32_t run_id : {1u, 2u, 70'000u, 3u, 3u}) {
    SCOPED_TRACE(run_id);
    forget();
    ASSERT_NO_FATAL_FAILURE(arm({1ms}, run_id));
    is_light = !is_light;
    light_in(5ms, is_light ? trigger_contract::kLight_adc : trigger_contract::kDark_adc);
    ASSERT_NO_FATAL_FAILURE(listen_until_pulses(1));
    ASSERT_EQ(heard().edges.size(), 1u);
    EXPECT_EQ(heard().edges[0].edge_number, 1u);
    EXPECT_EQ(heard().edges[0].is_light, is_light);
    EXPECT_EQ(heard().pulses[0].pulse_number, 1u);
    EXPECT_TRUE(heard().faults.empty());
    trigger().disarm();
  }
}
