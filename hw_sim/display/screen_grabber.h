// The simulated projector's optics: what a product draws on its monitor becomes light on a time
// line and a reading of the photodiode.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "hw_sim/display/photodiode.h"
#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/light.h"
#include "rig/clock.h"
#include "rig/fault.h"
#include "rig/projector.h"

namespace hw_sim {

struct GrabberSettings {
  std::string display{};          // ":3"
  std::string output = "DUMMY1";  // the projector's connector
  double refresh_hz = 60;
  int input_lag_frames = 0;  // refreshes that the projector takes beyond the next one
  std::chrono::nanoseconds square_delay{
      0};  // of the square's light, behind its picture's first row
  rig::SyncSquareSettings sync_square{};
  PhotodiodeSettings photodiode{};
  FaultSchedule* faults = nullptr;  // outlives the grabber
};

// A picture drawn between two vertical blanks is lit from the second one on (plus input lag), until
// the next one is; of several drawn in between the last is lit. Light has the times of the
// simulated blanks, never of a thread that woke up late: drawings are dated by the X server (to
// 1 ms), and who reads the time line waits until all drawn before has been seen. The photodiode
// alone is as late as the thread.
//   picture drawn ─► damage ─► grab, gamma ramp applied ─► LightTimeline
//                                    └─► sync square ─► photodiode ─► on_level, at or after its
//                                    time
// The photodiode sits in front of the sync square and keeps its light off the scene: the square is
// black in the Picture, and a pattern is one Picture whatever its square's level was. An unplugged
// monitor, or a dead X server, is a dark projector.
class ScreenGrabber {
 public:
  // The photodiode's ADC reading from that time on; times never go back, and never precede the
  // start of the picture on the time line. From the grabber's thread.
  using LevelCallback = std::function<void(rig::HostTime, int level_adc)>;
  // A picture that is about to be lit, for World::prepare(). From the grabber's thread.
  using PictureCallback = std::function<void(const std::shared_ptr<const Picture>&)>;

  // Is the source of `light` as long as it lives. Errors: kNotFound if there is no such X server or
  // output.
  static rig::Result<std::unique_ptr<ScreenGrabber>> start(const GrabberSettings& settings,
                                                           LightTimeline& light,
                                                           PictureCallback on_picture,
                                                           LevelCallback on_level);
  ~ScreenGrabber();  // stop it before the X server

  // Faults of the photodiode. Thread-safe.
  void stick_photodiode(bool is_stuck);
  void dim_photodiode(double level_frac);  // 1: as it was

 private:
  class Eye;
  ScreenGrabber(std::unique_ptr<Eye> eye, LightTimeline& light);

  LightTimeline& light_;
  std::unique_ptr<Eye> eye_;
  std::jthread thread_;
};

}  // namespace hw_sim
