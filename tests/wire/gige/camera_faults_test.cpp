// What the camera class makes of a bad network, a bad camera, and a wrong rig file.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/wire/gige/wire_bench.h"

namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::HasSubstr;

// Only failures wait this long.
constexpr seconds kPatience{10};

class CameraFaults : public testing::Test {
 protected:
  const std::vector<microseconds> exposures_{microseconds(1000), microseconds(2000)};

  void open(std::unique_ptr<WireBench> bench = std::make_unique<WireBench>()) {
    bench_ = std::move(bench);
    auto camera = bench_->open();
    ASSERT_TRUE(camera.has_value()) << camera.error().detail;
    camera_ = std::move(*camera);
  }
  void arm(int frame_count) {
    const auto armed = camera_->arm(exposures_, frame_count);
    ASSERT_TRUE(armed.has_value()) << armed.error().detail;
  }
  void open_and_arm(int frame_count) {
    ASSERT_NO_FATAL_FAILURE(open());
    ASSERT_NO_FATAL_FAILURE(arm(frame_count));
  }
  hw_sim::GigeFaults& faults() { return bench_->device().faults(); }

  template <typename Enough>
  void collect(rig::HostTime deadline, const Enough& is_enough) {
    while (!is_enough()) {
      std::optional<rig::Event> event = bench_->source().wait(deadline, {});
      if (!event) return;
      if (auto* frame = std::get_if<rig::FrameArrived>(&*event))
        frames_.push_back(std::move(frame->frame));
      else if (auto* damage = std::get_if<rig::FrameDamaged>(&*event))
        damages_.push_back(std::move(*damage));
      else if (auto* fault = std::get_if<rig::DeviceFault>(&*event))
        device_faults_.push_back(std::move(*fault));
    }
  }
  void pulse(int count) {
    for (int i = 0; i < count; ++i) {
      bench_->pulse(exposures_[0]);
      collect(rig::HostClock::now() + milliseconds(4), [] { return false; });
    }
  }
  void expect(std::size_t frame_count, std::size_t damage_count) {
    collect(rig::HostClock::now() + kPatience,
            [&] { return frames_.size() >= frame_count && damages_.size() >= damage_count; });
    EXPECT_EQ(frames_.size(), frame_count);
    EXPECT_EQ(damages_.size(), damage_count);
    EXPECT_TRUE(device_faults_.empty());
  }
  // Every frame shows the pulse that its block id says, to the last pixel.
  void expect_own_pixels(std::uint64_t pulses_without_frame = 0) {
    for (const rig::Frame& frame : frames_) {
      EXPECT_EQ(sample(frame, 0, 0), frame.block_id + pulses_without_frame);
      for (int row = 0; row < frame.height_px; ++row)
        for (int col = 2; col < frame.width_px; ++col)
          ASSERT_EQ(sample(frame, row, col), IdentityWorld::place(row, col));
    }
  }
  std::vector<std::uint64_t> block_ids() const {
    std::vector<std::uint64_t> ids;
    for (const rig::Frame& frame : frames_) ids.push_back(frame.block_id);
    return ids;
  }

  std::unique_ptr<WireBench> bench_;
  std::vector<rig::Frame> frames_;
  std::vector<rig::FrameDamaged> damages_;
  std::vector<rig::DeviceFault> device_faults_;
  std::unique_ptr<rig::Camera> camera_;
};

TEST_F(CameraFaults, OnePercentPacketLossIsMadeGoodByResends) {
  for (const bool has_64_bit_block_ids : {false, true}) {
    SCOPED_TRACE(has_64_bit_block_ids);
    camera_.reset();
    frames_.clear();
    ASSERT_NO_FATAL_FAILURE(open(
        std::make_unique<WireBench>(rig::Bracketing::kSequencer, has_64_bit_block_ids, 640, 480)));
    ASSERT_NO_FATAL_FAILURE(arm(20));
    faults().packet_loss_frac = 0.01;
    pulse(20);
    expect(20, 0);
    EXPECT_GT(bench_->device().counters().lost_packet_count, 0U);
    const auto counters = camera_->counters();
    ASSERT_TRUE(counters.has_value());
    EXPECT_GT(counters->resent_packet_count, 0);
  }
}

TEST_F(CameraFaults, LostLeaderAndTrailerAreMadeGoodByResends) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(3));
  faults().lost_leaders = 1;
  pulse(1);
  faults().lost_trailers = 1;
  pulse(2);
  expect(3, 0);
  EXPECT_THAT(block_ids(), testing::ElementsAre(1, 2, 3));
  expect_own_pixels();
}

TEST_F(CameraFaults, DuplicatedPacketsAreHarmless) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(4));
  faults().are_packets_duplicated = true;
  pulse(4);
  expect(4, 0);
  expect_own_pixels();
}

// The buffer of a block without a leader keeps the id and the pixels of its last use.
TEST_F(CameraFaults, BlockWithoutLeaderIsNeverMistakenForAnother) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(8));
  faults().is_resend_ignored = true;
  pulse(2);
  expect(2, 0);
  faults().lost_leaders = 1;
  pulse(1);
  expect(2, 1);
  EXPECT_EQ(damages_[0].error.fault, rig::Fault::kFrameIncomplete);
  EXPECT_TRUE(damages_[0].block_id == 0 || damages_[0].block_id == 3);
  pulse(1);
  collect(rig::HostClock::now() + kPatience, [&] { return frames_.size() >= 3; });
  EXPECT_THAT(block_ids(), testing::ElementsAre(1, 2, 4));
  expect_own_pixels();
}

TEST_F(CameraFaults, FrameThatNeverLeftIsAGapAndNotAWrongAssignment) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(4));
  pulse(1);
  expect(1, 0);
  faults().lost_frames = 1;
  pulse(3);
  expect(3, 1);
  EXPECT_EQ(damages_[0].block_id, 2U);
  EXPECT_EQ(damages_[0].error.fault, rig::Fault::kSequenceGap);
  EXPECT_THAT(block_ids(), testing::ElementsAre(1, 3, 4));
  expect_own_pixels();
}

TEST_F(CameraFaults, FirstFrameLostIsAGapToo) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(4));
  faults().lost_frames = 1;
  pulse(2);
  expect(1, 1);
  EXPECT_EQ(damages_[0].block_id, 1U);
  EXPECT_THAT(block_ids(), testing::ElementsAre(2));
}

TEST_F(CameraFaults, TruncatedFrameIsDamaged) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(3));
  faults().truncated_frames = 1;
  pulse(2);
  expect(1, 1);
  EXPECT_EQ(damages_[0].block_id, 1U);
  EXPECT_EQ(damages_[0].error.fault, rig::Fault::kFrameIncomplete);
  EXPECT_THAT(block_ids(), testing::ElementsAre(2));
  expect_own_pixels();
}

TEST_F(CameraFaults, WrongSizeAndFormatAreFound) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(4));
  faults().wrong_size_frames = 1;
  pulse(1);
  expect(0, 1);
  faults().wrong_format_frames = 1;
  pulse(2);
  expect(1, 2);
  EXPECT_EQ(damages_[0].error.fault, rig::Fault::kFrameMalformed);
  EXPECT_THAT(damages_[0].error.detail, HasSubstr("64 x 24 px instead of 64 x 48 px"));
  EXPECT_EQ(damages_[1].error.fault, rig::Fault::kFrameMalformed);
  EXPECT_THAT(damages_[1].error.detail, HasSubstr("BayerRG12"));
  EXPECT_EQ(damages_[1].block_id, 2U);
}

// The rows of a frame are read as if they lay next to each other.
TEST_F(CameraFaults, PaddedRowsAreFound) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(2));
  faults().padded_frames = 1;
  pulse(2);
  expect(1, 1);
  EXPECT_EQ(damages_[0].error.fault, rig::Fault::kFrameMalformed);
  EXPECT_THAT(damages_[0].error.detail, HasSubstr("4 bytes behind each row"));
}

TEST_F(CameraFaults, LateFrameStillArrives) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(2));
  faults().late_frames = 1;
  faults().late_frame_ms = 100;
  pulse(2);
  expect(2, 0);
  expect_own_pixels();
}

TEST_F(CameraFaults, SlippedSequencerShowsInTheChunks) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(2));
  faults().sequencer_slips = 1;
  pulse(2);
  expect(2, 0);
  EXPECT_EQ(frames_[0].sequencer_set, 1);
  EXPECT_EQ(frames_[0].exposure, exposures_[1]);
  EXPECT_EQ(frames_[1].exposure, exposures_[0]);
}

TEST_F(CameraFaults, StuckExposureShowsInTheChunks) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(2));
  faults().is_exposure_stuck = true;
  pulse(2);
  expect(2, 0);
  EXPECT_EQ(frames_[1].sequencer_set, 1);
  EXPECT_EQ(frames_[1].exposure, exposures_[0]);
  EXPECT_EQ(sample(frames_[1], 0, 1), exposures_[0].count());
}

TEST_F(CameraFaults, RevokedControlIsADeviceFaultOnce) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(2));
  faults().is_control_kicked = true;
  collect(rig::HostClock::now() + kPatience, [&] { return !device_faults_.empty(); });
  ASSERT_EQ(device_faults_.size(), 1U);
  EXPECT_EQ(device_faults_[0].device, rig::Device::kCamera);
  EXPECT_EQ(device_faults_[0].error.fault, rig::Fault::kDeviceLost);
  const auto counters = camera_->counters();
  ASSERT_FALSE(counters.has_value());
  EXPECT_EQ(counters.error().fault, rig::Fault::kDeviceLost);
  camera_->disarm();
  const auto armed = camera_->arm(exposures_, 1);
  ASSERT_FALSE(armed.has_value());
  EXPECT_EQ(armed.error().fault, rig::Fault::kDeviceLost);
  collect(rig::HostClock::now() + milliseconds(100), [] { return false; });
  EXPECT_EQ(device_faults_.size(), 1U);
  // And the next one works.
  camera_.reset();
  device_faults_.clear();
  auto camera = bench_->open();
  ASSERT_TRUE(camera.has_value()) << camera.error().detail;
  camera_ = std::move(*camera);
  ASSERT_NO_FATAL_FAILURE(arm(1));
  pulse(1);
  expect(1, 0);
}

// The driver learns of it at the next heartbeat, or here, when arming is refused.
TEST_F(CameraFaults, ControlThatIsGoneWhenArmingIsALostCamera) {
  ASSERT_NO_FATAL_FAILURE(open());
  faults().is_control_taken = true;
  faults().is_control_kicked = true;
  collect(rig::HostClock::now() + milliseconds(60), [] { return false; });
  const auto armed = camera_->arm(exposures_, 1);
  ASSERT_FALSE(armed.has_value());
  EXPECT_EQ(armed.error().fault, rig::Fault::kDeviceLost) << armed.error().detail;
  const auto second = bench_->open();
  ASSERT_FALSE(second.has_value());
  EXPECT_EQ(second.error().fault, rig::Fault::kAccessDenied) << second.error().detail;
}

// Sync modes without a trigger box ask for the clock as the last thing before they run.
TEST_F(CameraFaults, ControlThatIsGoneWhenTheClockIsReadIsALostCamera) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(2));
  faults().is_control_taken = true;
  faults().is_control_kicked = true;
  collect(rig::HostClock::now() + milliseconds(60), [] { return false; });
  const auto clock = camera_->read_clock();
  ASSERT_FALSE(clock.has_value());
  EXPECT_EQ(clock.error().fault, rig::Fault::kDeviceLost) << clock.error().detail;
}

// Aravis asks a dead camera for 2.5 s, in which no abort would be heard.
TEST_F(CameraFaults, ADeadCameraIsNotWaitedForWhenDisarmedButLost) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(2));
  pulse(1);
  expect(1, 0);
  faults().is_mute = true;
  camera_->disarm();
  collect(rig::HostClock::now() + milliseconds(10), [] { return false; });
  ASSERT_EQ(device_faults_.size(), 1U);
  EXPECT_EQ(device_faults_[0].error.fault, rig::Fault::kDeviceLost);
  EXPECT_THAT(device_faults_[0].error.detail, HasSubstr("does not answer"));
  const auto armed = camera_->arm(exposures_, 2);
  ASSERT_FALSE(armed.has_value());
  EXPECT_EQ(armed.error().fault, rig::Fault::kDeviceLost);
  expect_own_pixels();
  faults().is_mute = false;  // or closing it takes ten seconds more
}

TEST_F(CameraFaults, LostPowerIsADeviceFaultAndFramesStay) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(2));
  pulse(1);
  expect(1, 0);
  bench_->power_off();
  collect(rig::HostClock::now() + kPatience, [&] { return !device_faults_.empty(); });
  ASSERT_EQ(device_faults_.size(), 1U);
  EXPECT_EQ(device_faults_[0].error.fault, rig::Fault::kDeviceLost);
  camera_->disarm();
  camera_.reset();
  expect_own_pixels();
}

TEST_F(CameraFaults, SecondControllerIsRefusedAndToldWho) {
  ASSERT_NO_FATAL_FAILURE(open());
  const auto second = bench_->open();
  ASSERT_FALSE(second.has_value());
  EXPECT_EQ(second.error().fault, rig::Fault::kAccessDenied);
  EXPECT_THAT(second.error().detail, HasSubstr("a program at 127."));
  EXPECT_THAT(second.error().detail, HasSubstr(bench_->settings.address));
  ASSERT_NO_FATAL_FAILURE(arm(1));  // the first is unharmed
  pulse(1);
  expect(1, 0);
}

TEST_F(CameraFaults, DeadAddressIsNotFound) {
  rig::EventQueue queue;
  rig::CameraSettings settings;
  settings.address = own_address();
  const auto camera = rig::AravisCamera::open(settings, queue);
  ASSERT_FALSE(camera.has_value());
  EXPECT_EQ(camera.error().fault, rig::Fault::kNotFound);
  EXPECT_THAT(camera.error().detail, HasSubstr("no camera answers at 127."));
}

TEST_F(CameraFaults, RegionOfInterestIsCutFromTheSensor) {
  auto bench = std::make_unique<WireBench>();
  bench->settings.width_px = 20;
  bench->settings.height_px = 10;
  bench->settings.offset_x_px = 30;
  bench->settings.offset_y_px = 25;
  ASSERT_NO_FATAL_FAILURE(open(std::move(bench)));
  ASSERT_NO_FATAL_FAILURE(arm(1));
  pulse(1);
  expect(1, 0);
  EXPECT_EQ(frames_[0].pixels.size(), 20U * 10 * 2);
  EXPECT_EQ(sample(frames_[0], 0, 0), IdentityWorld::place(25, 30));
  EXPECT_EQ(sample(frames_[0], 9, 19), IdentityWorld::place(34, 49));
}

TEST_F(CameraFaults, SingleExposureNeedsNoSequencer) {
  ASSERT_NO_FATAL_FAILURE(open());
  ASSERT_TRUE(camera_->arm({microseconds(1500)}, 2).has_value());
  pulse(2);
  expect(2, 0);
  EXPECT_EQ(frames_[1].exposure, microseconds(1500));
}

TEST_F(CameraFaults, AnyEdgeOfTheLineIsATrigger) {
  auto bench = std::make_unique<WireBench>();
  bench->settings.trigger_edge = rig::TriggerEdge::kAny;
  ASSERT_NO_FATAL_FAILURE(open(std::move(bench)));
  ASSERT_NO_FATAL_FAILURE(arm(3));
  for (const bool is_high : {true, false, true}) {
    bench_->device().line(rig::HostClock::now(), is_high);
    collect(rig::HostClock::now() + milliseconds(10), [] { return false; });
  }
  expect(3, 0);
}

TEST_F(CameraFaults, EachFrameTellsTheLevelOfItsLine) {
  auto bench = std::make_unique<WireBench>();
  bench->settings.trigger_edge = rig::TriggerEdge::kAny;
  hw_sim::FaultPlan plan;
  plan.faults.push_back(hw_sim::default_fault(hw_sim::FaultKind::kTriggerDoubled));
  plan.faults.back().place = hw_sim::FaultPlace{hw_sim::kPrimingShowing, 1};
  hw_sim::FaultSchedule faults(plan);
  bench->options.faults = &faults;
  bench->options.is_the_trigger = true;
  ASSERT_NO_FATAL_FAILURE(open(std::move(bench)));
  EXPECT_TRUE(camera_->identity().tells_line_level);
  ASSERT_NO_FATAL_FAILURE(arm(4));
  for (const bool is_high : {true, false, true}) {
    bench_->device().line(rig::HostClock::now(), is_high);
    collect(rig::HostClock::now() + milliseconds(30), [] { return false; });
  }
  expect(4, 0);
  EXPECT_EQ(frames_[0].is_line_high, true) << "the driver turns an inverter off";
  EXPECT_EQ(frames_[1].is_line_high, false);
  EXPECT_EQ(frames_[2].is_line_high, false) << "a trigger that the line did not make";
  EXPECT_EQ(frames_[3].is_line_high, true);
  camera_.reset();
  bench_.reset();  // before the schedule of its faults
}

TEST(GigeDevice, ACameraThatDoesNotTellTheLevelSaysSo) {
  for (const bool is_any_edge : {true, false}) {
    WireBench bench;
    bench.options.has_line_status = false;
    if (is_any_edge) bench.settings.trigger_edge = rig::TriggerEdge::kAny;
    const auto camera = bench.open();
    ASSERT_TRUE(camera.has_value()) << camera.error().detail;
    EXPECT_FALSE((*camera)->identity().tells_line_level);
    EXPECT_EQ((*camera)->identity().note.find("chunk LineStatusAll") != std::string::npos,
              is_any_edge);
  }
}

// set_number() reads it back.
TEST_F(CameraFaults, APhotodiodesBouncesAreFilteredByTheCamera) {
  auto bench = std::make_unique<WireBench>();
  bench->settings.trigger_edge = rig::TriggerEdge::kAny;
  bench->settings.line_debounce = microseconds(300);
  ASSERT_NO_FATAL_FAILURE(open(std::move(bench)));
  EXPECT_FLOAT_EQ(bench_->device().line_debounce_us(), 300);
  EXPECT_EQ(camera_->identity().note, "");
}

TEST(GigeDevice, ADebouncerOutOfRangeIsNamedWithItsKey) {
  WireBench bench;
  bench.settings.trigger_edge = rig::TriggerEdge::kAny;
  bench.settings.line_debounce = milliseconds(30);
  const auto camera = bench.open();
  ASSERT_FALSE(camera.has_value());
  EXPECT_EQ(camera.error().fault, rig::Fault::kOutOfRange);
  EXPECT_THAT(camera.error().detail, HasSubstr("takes LineDebouncerTime from 0 to 20000 us, not "
                                               "30000 us; correct camera.line_debounce_us"));
}

TEST(GigeDevice, ACameraWithoutADebouncerDoesWithoutAndSaysSo) {
  for (const bool is_any_edge : {true, false}) {
    WireBench bench;
    bench.options.has_debouncer = false;
    if (is_any_edge) bench.settings.trigger_edge = rig::TriggerEdge::kAny;
    const auto camera = bench.open();
    ASSERT_TRUE(camera.has_value()) << camera.error().detail;
    EXPECT_EQ((*camera)->identity().note.find("has no LineDebouncerTime") != std::string::npos,
              is_any_edge);
  }
}

TEST_F(CameraFaults, OnlyARiseIsATriggerUnlessAskedFor) {
  ASSERT_NO_FATAL_FAILURE(open_and_arm(2));
  bench_->device().line(rig::HostClock::now(), true);
  collect(rig::HostClock::now() + milliseconds(10), [] { return false; });
  bench_->device().line(rig::HostClock::now(), false);
  collect(rig::HostClock::now() + milliseconds(50), [] { return false; });
  expect(1, 0);
}

TEST(GigeDevice, ACameraWithoutAnyEdgeIsRefusedForThePhotodiode) {
  WireBench bench;
  bench.options.has_any_edge = false;
  bench.settings.trigger_edge = rig::TriggerEdge::kAny;
  const auto camera = bench.open();
  ASSERT_FALSE(camera.has_value());
  EXPECT_EQ(camera.error().fault, rig::Fault::kUnsupported);
  EXPECT_THAT(camera.error().detail, HasSubstr("has no TriggerActivation AnyEdge but RisingEdge"));
  EXPECT_THAT(camera.error().detail, HasSubstr("set sequence.sync to \"trigger_box\""));
}

TEST_F(CameraFaults, SoftwareTriggerWorksWithoutALine) {
  auto bench = std::make_unique<WireBench>();
  bench->settings.trigger_line = "Software";
  ASSERT_NO_FATAL_FAILURE(open(std::move(bench)));
  ASSERT_NO_FATAL_FAILURE(arm(1));
  const auto triggered = camera_->trigger_software();
  EXPECT_TRUE(triggered.has_value()) << triggered.error().detail;
  expect(1, 0);
}

struct WrongSetting {
  std::string name;
  rig::CameraSettings settings;
  rig::Fault fault;
  std::string expected;  // in the message
};

class WrongSettings : public testing::TestWithParam<WrongSetting> {};

TEST_P(WrongSettings, AreRefusedByName) {
  WireBench bench;
  const std::string address = bench.settings.address;
  bench.settings = GetParam().settings;
  bench.settings.address = address;
  const auto camera = bench.open();
  ASSERT_FALSE(camera.has_value());
  EXPECT_EQ(camera.error().fault, GetParam().fault) << camera.error().detail;
  EXPECT_THAT(camera.error().detail, HasSubstr(GetParam().expected));
}

rig::CameraSettings sound() {
  rig::CameraSettings settings;
  settings.width_px = 64;
  settings.height_px = 48;
  settings.packet_size_bytes = 1500;
  return settings;
}

template <typename Change>
rig::CameraSettings changed(const Change& change) {
  rig::CameraSettings settings = sound();
  change(settings);
  return settings;
}

INSTANTIATE_TEST_SUITE_P(
    Wire, WrongSettings,
    testing::Values(
        WrongSetting{"Serial", changed([](auto& s) { s.serial = "OTHER"; }), rig::Fault::kNotFound,
                     "has serial number SIM0001"},
        WrongSetting{"PixelFormat", changed([](auto& s) { s.pixel_format = "BayerXX12"; }),
                     rig::Fault::kUnsupported, "has no pixel format BayerXX12 but BayerRG12"},
        WrongSetting{"Width", changed([](auto& s) { s.width_px = 65; }), rig::Fault::kOutOfRange,
                     "takes Width from 1 to 64 px here, not 65"},
        WrongSetting{"Offset", changed([](auto& s) { s.offset_y_px = 1; }), rig::Fault::kOutOfRange,
                     "OffsetY to 1"},
        WrongSetting{"PacketSize", changed([](auto& s) { s.packet_size_bytes = 100; }),
                     rig::Fault::kOutOfRange, "packet size"},
        WrongSetting{"TriggerLine", changed([](auto& s) { s.trigger_line = "Line7"; }),
                     rig::Fault::kUnsupported, "TriggerSource Line7"}),
    [](const auto& made) { return made.param.name; });

TEST(GigeDevice, TakenAddressFailsLoudly) {
  WireBench first;
  ASSERT_TRUE(first.start().has_value());
  WireBench second;
  second.options.address = first.options.address;
  const auto started = second.start();
  ASSERT_FALSE(started.has_value());
  EXPECT_EQ(started.error().fault, rig::Fault::kNotFound);
  EXPECT_THAT(started.error().detail, HasSubstr(first.options.address + ":3956"));
}

TEST(GigeDevice, UnknownPixelFormatIsAConfigurationError) {
  WireBench bench;
  bench.options.pixel_formats = {"BayerXX12"};
  const auto started = bench.start();
  ASSERT_FALSE(started.has_value());
  EXPECT_EQ(started.error().fault, rig::Fault::kConfiguration);
}

}  // namespace
