#include "tests/bench/world_capture.h"

#include <chrono>
#include <cstdio>
#include <utility>

#include "hw_sim/devices/in_process_rig.h"

namespace bench {

void Program::complain(const std::string& message) const {
  std::fprintf(stderr, "%s: %s\n", name.c_str(), message.c_str());
}

std::optional<rig::RigFile> rig_file_of(const Program& program, const std::filesystem::path& file) {
  auto rig_file = rig::read_rig_file(file);
  if (rig_file) return std::move(*rig_file);
  program.complain(rig_file.error().detail);
  return std::nullopt;
}

std::optional<hw_sim::SimulatedRig> rig_of(const Program& program, const rig::RigFile& file) {
  auto rig = hw_sim::simulated_rig(file);
  if (rig) return std::move(*rig);
  program.complain(rig.error().detail);
  return std::nullopt;
}

std::optional<FinishedCapture> capture_in_process(const Program& program,
                                                  const hw_sim::HeadWorld& world,
                                                  const rig::RigFile& rig_file,
                                                  capture::CaptureOptions options) {
  options.created = std::chrono::system_clock::time_point(std::chrono::seconds(1'790'000'000));
  const auto job = capture::CaptureJob::prepare(rig_file, options);
  if (!job) {
    program.complain(job.error().message);
    return std::nullopt;
  }
  hw_sim::InProcessRig rig(world,
                           {rig_file.projector, rig_file.trigger, rig_file.camera, {}, {}, {}});
  const auto begin = rig.timeline().now();
  FinishedCapture finished;
  finished.result =
      job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, {}, {});
  finished.lasted_s = std::chrono::duration<double>(rig.timeline().now() - begin).count();
  return finished;
}

}  // namespace bench
