// A simulated face before tests/wire/rig's small rig, and captures of it on the virtual clock.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <utility>

#include "capture/capture_job.h"
#include "hw_sim/devices/in_process_rig.h"
#include "hw_sim/world/head_world.h"
#include "hw_sim/world/simulated_rig.h"
#include "rig/rig_file.h"

namespace capture {

inline rig::RigFile small_rig() {
  auto rig_file = rig::read_rig_file(std::filesystem::path(SMALL_RIG));
  EXPECT_TRUE(rig_file) << rig_file.error().detail;
  return *rig_file;
}

inline std::unique_ptr<hw_sim::HeadWorld> make_face(const rig::RigFile& rig_file,
                                                    const hw_sim::SceneOptions& options) {
  const auto rig = hw_sim::simulated_rig(rig_file);
  EXPECT_TRUE(rig) << rig.error().detail;
  auto world = hw_sim::HeadWorld::create(rig->camera, rig->projector, rig->calibration, options);
  EXPECT_TRUE(world) << world.error().detail;
  return std::move(*world);
}

// At one and the same time of day, so that two captures can be the same to the byte.
inline CaptureResult capture_once(const rig::RigFile& rig_file, const hw_sim::World& world,
                                  CaptureOptions options) {
  options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
  const auto job = CaptureJob::prepare(rig_file, options);
  EXPECT_TRUE(job) << job.error().message;
  hw_sim::InProcessRig rig(world,
                           {rig_file.projector, rig_file.trigger, rig_file.camera, {}, {}, {}});
  return job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, {}, {});
}

}  // namespace capture
