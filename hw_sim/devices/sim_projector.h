// The projector of the in-process rig: pictures at vertical blanks of the virtual clock.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <vector>

#include "hw_sim/devices/sim_faults.h"
#include "hw_sim/devices/timeline.h"
#include "hw_sim/light.h"
#include "rig/projector.h"

namespace hw_sim {

struct DisplayTiming {
  std::chrono::nanoseconds refresh_interval{16'666'667};
  int input_lag_refreshes = 1;  // from the swap to the light
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
  // Called when the light of a picture begins, with the square's state.
  using OnLight = std::function<void(const std::shared_ptr<const Picture>&, bool is_square_light)>;

  SimProjector(rig::ProjectorSettings settings, DisplayTiming timing, const SimFaults& faults,
               Timeline& timeline, OnLight on_light);

  rig::DisplayReport report() const override;
  rig::Result<void> load(std::vector<estimation::Image<unsigned char>> pictures) override;
  rig::Result<void> show(const rig::ShowRequest& request) override;

 private:
  rig::HostTime next_vertical_blank() const;
  void schedule_swap();
  void swap();
  std::shared_ptr<const Picture> compose(const rig::ShowRequest& request) const;
  void lose();

  const rig::ProjectorSettings settings_;
  const DisplayTiming timing_;
  const SimFaults& faults_;
  Timeline& timeline_;
  const OnLight on_light_;
  std::vector<estimation::Image<unsigned char>> pictures_;
  std::deque<rig::ShowRequest> requests_;  // not yet swapped in
  rig::HostTime latest_light_;
  std::uint64_t load_count_ = 0;
  std::uint64_t swap_count_ = 0;
  bool is_lost_ = false;
};

}  // namespace hw_sim
