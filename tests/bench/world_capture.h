// What the benches of the virtual rig share: the rig of a file, and a capture of a scene in
// process.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "capture/capture_job.h"
#include "hw_sim/world/head_world.h"
#include "hw_sim/world/scene.h"
#include "hw_sim/world/simulated_rig.h"
#include "rig/rig_file.h"

namespace bench {

// A bench says what is wrong on stderr, by its own name.
struct Program {
  std::string name;
  void complain(const std::string& message) const;
};

// nullopt: complained.
std::optional<rig::RigFile> rig_file_of(const Program& program, const std::filesystem::path& file);
std::optional<hw_sim::SimulatedRig> rig_of(const Program& program, const rig::RigFile& file);

struct FinishedCapture {
  capture::CaptureResult result;
  double lasted_s = 0;  // by the rig's own clock
};

// The same session for any number of threads: `options.created` is set. nullopt: complained.
std::optional<FinishedCapture> capture_in_process(const Program& program,
                                                  const hw_sim::HeadWorld& world,
                                                  const rig::RigFile& rig_file,
                                                  capture::CaptureOptions options);

}  // namespace bench
