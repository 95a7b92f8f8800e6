// The projector of the in-process rig: pictures at vertical blanks of the virtual clock.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "hw_sim/devices/timeline.h"
#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/light.h"
#include "rig/projector.h"

namespace hw_sim {

struct DisplayTiming {
  std::chrono::nanoseconds refresh_interval{16'666'667};
  int input_lag_refreshes = 1;  // from the swap to the light
  bool is_synchronised = true;  // as the start-up check finds
  // A starved computer: swaps are told of, and their light comes, that much late.
  std::chrono::nanoseconds report_delay{0};
  std::chrono::nanoseconds light_delay{0};
};

// Which picture of a load, and under which square, a Picture::id of a SimProjector stands for.
struct ShownPicture {
  int picture = rig::kBlackPicture;
  bool is_square_light = false;
};
ShownPicture shown_picture(std::uint64_t picture_id);

// Not thread-safe: lives on its Timeline's thread, unlike the real one.
class SimProjector final : public rig::Projector {
 public:
  // Called when the light of a picture begins, with the square's state and what goes wrong when it
  // changes.
  using OnLight = std::function<void(const std::shared_ptr<const Picture>&, bool is_square_light,
                                     const FlipFaults&)>;

  SimProjector(rig::ProjectorSettings settings, DisplayTiming timing, FaultSchedule& faults,
               Timeline& timeline, OnLight on_light);

  rig::DisplayReport report() const override;
  rig::Result<void> load(std::vector<estimation::Image<unsigned char>> pictures) override;
  rig::Result<void> show(const rig::ShowRequest& request) override;

  // Is the display as it was opened? Errors: kDisplayChanged.
  rig::Result<void> check() const;

  // Faults. The driver notices a changed gamma ramp when it shows the next picture, or by its
  // watch; an unplugged monitor at once; and recovers by itself when all is as it was.
  void set_gamma(double exponent);  // 1 is identity
  void unplug();
  void plug_in();

 private:
  rig::HostTime next_vertical_blank() const;
  void schedule_swap();
  void swap();
  void tell_of_swap(std::uint64_t show_id);
  void light(rig::HostTime when, const rig::ShowRequest& request, const FlipFaults& faults);
  std::shared_ptr<const Picture> compose(const rig::ShowRequest& request) const;
  std::shared_ptr<const Picture> after_gamma(const std::shared_ptr<const Picture>& picture) const;
  void watch();

  const rig::ProjectorSettings settings_;
  const DisplayTiming timing_;
  FaultSchedule& faults_;
  Timeline& timeline_;
  const OnLight on_light_;
  std::vector<estimation::Image<unsigned char>> pictures_;
  std::deque<rig::ShowRequest> requests_;  // not yet swapped in
  rig::HostTime latest_light_;
  std::uint64_t load_count_ = 0;
  rig::ShowRequest shown_;              // the newest
  std::optional<FlipFaults> flip_;      // of the swap to come, once taken
  std::shared_ptr<const Picture> lit_;  // the light of now, before gamma
  double gamma_exponent_ = 1;
  bool is_plugged_in_ = true;
  bool is_changed_ = false;  // and the driver knows
};

}  // namespace hw_sim
