#include "tests/bench/scene_frames.h"

#include <chrono>
#include <utility>

namespace bench {
namespace {

std::chrono::nanoseconds in_ns(double time_s) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
      std::chrono::duration<double>(time_s));
}

double length_s(const capture::Plan& plan, double cycle_s) {
  return cycle_s * static_cast<double>(plan.order.size());
}

}  // namespace

std::unique_ptr<SceneFrames> SceneFrames::open(
    const Program& program, const SceneFramesOptions& options,
    const std::function<hw_sim::Effects(double capture_s)>& effects_of) {
  auto file = rig_file_of(program, options.rig_file);
  if (!file) return nullptr;
  if (options.is_in_order) file->sequence.is_shuffled = false;
  auto rig = rig_of(program, *file);
  if (!rig) return nullptr;
  auto plan = capture::make_plan("paper", file->projector, file->sequence);
  if (!plan) {
    program.complain(plan.error().detail);
    return nullptr;
  }
  const hw_sim::Effects effects = effects_of(length_s(*plan, options.cycle_ms / 1000));
  auto world = hw_sim::HeadWorld::create(rig->camera, rig->projector, rig->calibration,
                                         {.name = options.scene,
                                          .effects = effects,
                                          .has_indirect = false,
                                          .has_identity = false,
                                          .seed = options.seed,
                                          .thread_count = 2,
                                          .cache_folder = hw_sim::default_cache_folder()});
  if (!world) {
    program.complain(world.error().detail);
    return nullptr;
  }
  return std::unique_ptr<SceneFrames>(new SceneFrames(
      options, *file, std::move(*rig), std::move(*plan), effects, std::move(*world)));
}

SceneFrames::SceneFrames(const SceneFramesOptions& options, const rig::RigFile& file,
                         hw_sim::SimulatedRig rig, capture::Plan plan,
                         const hw_sim::Effects& effects, std::unique_ptr<hw_sim::HeadWorld> world)
    : cycle_s_(options.cycle_ms / 1000),
      rig_(std::move(rig)),
      plan_(std::move(plan)),
      effects_(effects),
      world_(std::move(world)) {
  std::uint64_t id = 1;
  for (auto& picture : capture::render_pictures(plan_, file.projector))
    pictures_.push_back(
        std::make_shared<const hw_sim::Picture>(hw_sim::Picture{id++, std::move(picture)}));
}

void SceneFrames::capture(int number, const OnSceneFrame& on_frame) {
  const double start_s = number * (length_s(plan_, cycle_s_) + 1);
  estimation::Image<std::uint16_t> frame_dn(rig_.camera.height_px, rig_.camera.width_px);
  for (std::size_t place = 0; place < plan_.order.size(); ++place) {
    const int pattern = plan_.order[place];
    double at_s = start_s + static_cast<double>(place) * cycle_s_;
    for (std::size_t bracket = 0; bracket < plan_.exposures.size(); ++bracket) {
      const auto duration = plan_.exposures[bracket];
      const double exposure_s = std::chrono::duration<double>(duration).count();
      world_->expose({.light = {{pictures_[static_cast<std::size_t>(pattern)], duration}},
                      .duration = duration,
                      .start = in_ns(at_s),
                      .trigger_number = ++trigger_number_},
                     frame_dn.view());
      on_frame({pattern, static_cast<int>(bracket), at_s, at_s - start_s, exposure_s},
               std::as_const(frame_dn).view());
      constexpr double kGapS = 0.002;
      at_s += exposure_s + kGapS;
    }
  }
}

}  // namespace bench
