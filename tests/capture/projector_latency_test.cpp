// How late a rig without a photodiode has to trigger, measured on projectors of known lag.
#include "capture/projector_latency.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stop_token>

#include "tests/capture/ledger_rig.h"

namespace capture {
namespace {

struct Bench {
  explicit Bench(int lag_refreshes, const hw_sim::World& world,
                 const hw_sim::FaultPlan& faults = {})
      : rig(world, {rig_file.projector,
                    rig_file.trigger,
                    rig_file.camera,
                    {.input_lag_refreshes = lag_refreshes},
                    {},
                    faults,
                    rig_file.sequence.sync}) {}
  rig::Result<std::chrono::nanoseconds> measure(const std::stop_token& stop = {}) {
    const LedgerRules rules = make_rules(rig_file, rig_file.sequence.exposures, 60).ledger;
    refresh_interval = rules.refresh_interval;
    return measure_latency({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()},
                           rig_file.projector, rules, stop);
  }

  rig::RigFile rig_file = boxless_rig_file(rig::SyncMode::kSoftware);
  hw_sim::InProcessRig rig;
  std::chrono::nanoseconds refresh_interval{0};
};

class DarkWorld final : public hw_sim::World {
 public:
  int width_px() const override { return hw_sim::LedgerWorld::kWidthPx; }
  int height_px() const override { return hw_sim::LedgerWorld::kHeightPx; }
  int channel_count() const override { return 1; }
  void expose(const hw_sim::Exposure&,
              estimation::ImageView<std::uint16_t> frame_dn) const override {
    for (int row = 0; row < frame_dn.height_px; ++row)
      for (std::uint16_t& dn : frame_dn.row(row)) dn = 64;
  }
};

TEST(ProjectorLatency, IsTheLagAndAMarginOfARefresh) {
  const hw_sim::LedgerWorld world;
  for (const int lag_refreshes : {0, 1, 2, 5}) {
    SCOPED_TRACE(lag_refreshes);
    Bench bench(lag_refreshes, world);
    const auto latency = bench.measure();
    ASSERT_TRUE(latency.has_value()) << latency.error().detail;
    const auto lag = lag_refreshes * bench.refresh_interval;
    EXPECT_GE(*latency, lag + bench.refresh_interval);
    EXPECT_LE(*latency, lag + bench.refresh_interval * 3 / 2);
    EXPECT_TRUE(bench.rig.camera().arm({std::chrono::milliseconds(1)}, 1)) << "still armed";
  }
}

TEST(ProjectorLatency, ADamagedFrameIsTakenAgain) {
  const hw_sim::LedgerWorld world;
  hw_sim::PlannedFault damage = hw_sim::default_fault(hw_sim::FaultKind::kFrameTruncated);
  damage.rate_frac = 0.2;
  damage.count = 4;
  Bench bench(2, world, {.faults = {damage}});
  const auto latency = bench.measure();
  ASSERT_TRUE(latency.has_value()) << latency.error().detail;
  EXPECT_GE(*latency, 3 * bench.refresh_interval);
}

TEST(ProjectorLatency, ALagBeyondAllReasonIsRefused) {
  const hw_sim::LedgerWorld world;
  Bench bench(14, world);
  const auto latency = bench.measure();
  ASSERT_FALSE(latency.has_value());
  EXPECT_EQ(latency.error().fault, rig::Fault::kUnsupported);
}

TEST(ProjectorLatency, BlackAndWhiteThatLookAlikeAreNamedWithTheRemedy) {
  const DarkWorld world;
  Bench bench(1, world);
  const auto latency = bench.measure();
  ASSERT_FALSE(latency.has_value());
  EXPECT_EQ(latency.error().fault, rig::Fault::kUnsupported);
  EXPECT_THAT(latency.error().detail, testing::HasSubstr("64.000000 DN under a white one"));
  EXPECT_THAT(latency.error().detail, testing::HasSubstr("lens cap"));
}

TEST(ProjectorLatency, StopsWhenAsked) {
  const hw_sim::LedgerWorld world;
  Bench bench(1, world);
  std::stop_source stop;
  stop.request_stop();
  EXPECT_FALSE(bench.measure(stop.get_token()).has_value());
}

}  // namespace
}  // namespace capture
