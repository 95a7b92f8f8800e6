#include <poll.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include "estimation/session/manifest.h"
#include "hw_sim/app/commands.h"
#include "hw_sim/app/interrupts.h"
#include "hw_sim/app/scratch_folder.h"
#include "hw_sim/app/session_watch.h"
#include "hw_sim/app/show_progress.h"
#include "hw_sim/app/virtual_rig.h"
#include "hw_sim/devices/ledger_world.h"
#include "hw_sim/display/child_process.h"
#include "hw_sim/faults/fault_plan.h"
#include "hw_sim/faults/fault_schedule.h"
#include "hw_sim/world/board_world.h"
#include "hw_sim/world/head_world.h"
#include "hw_sim/world/simulated_rig.h"
#include "rig/rig_file.h"

namespace hw_sim {
namespace {

int complain(const rig::Error& error) {
  std::fprintf(stderr, "ssrig-sim: %s\n", error.detail.c_str());
  return error.fault == rig::Fault::kConfiguration ? kExitUsage : kExitDevice;
}

// What stands before the camera, and how the truth of the n-th new session is written.
struct Stage {
  std::unique_ptr<World> world;
  std::function<estimation::Result<void>(const std::filesystem::path& folder, std::size_t n)>
      write_truth;
};

rig::Result<Stage> make_targets(const estimation::CameraInfo& camera,
                                const estimation::ProjectorInfo& projector,
                                const estimation::Calibration& calibration,
                                const SceneOptions& scene, const SessionWatch& sessions) {
  rig::Result<TargetScene> targets = make_target_scene(scene.name);
  if (!targets) return tl::unexpected(targets.error());
  auto world =
      TargetWorld::create(camera, projector, calibration, *std::move(targets), scene.effects,
                          scene.seed, [&sessions] { return sessions.new_sessions().size(); });
  if (!world) return tl::unexpected(world.error());
  const TargetWorld& made = **world;
  return Stage{*std::move(world),
               [&made](const auto& folder, std::size_t n) { return made.write_truth(folder, n); }};
}

rig::Result<Stage> make_ledger(const rig::RigFile& rig) {
  if (rig.camera.width_px != LedgerWorld::kWidthPx ||
      rig.camera.height_px != LedgerWorld::kHeightPx || rig.camera.pixel_format != "Mono16")
    return rig::failure(rig::Fault::kConfiguration,
                        rig.path.string() + ": scene ledger needs a camera of " +
                            std::to_string(LedgerWorld::kWidthPx) + " x " +
                            std::to_string(LedgerWorld::kHeightPx) + " px in Mono16");
  return Stage{std::make_unique<LedgerWorld>(),
               [](const auto&, std::size_t) { return estimation::Result<void>(); }};
}

// `sessions` outlives the stage.
rig::Result<Stage> make_stage(const rig::RigFile& rig, const RunOptions& options,
                              const SessionWatch& sessions) {
  if (options.scene == kLedgerScene) return make_ledger(rig);
  const rig::Result<SimulatedRig> simulated = simulated_rig(rig);
  if (!simulated) return tl::unexpected(simulated.error());
  const auto& [camera, projector, calibration] = *simulated;
  SceneOptions scene;
  scene.name = options.scene;
  scene.has_indirect = options.has_indirect;
  scene.scattering = options.is_dipole ? ScatteringModel::kDipole : ScatteringModel::kMonteCarlo;
  scene.seed = options.seed;
  if (!options.effects_file.empty()) {
    const rig::Result<Effects> effects = read_effects(options.effects_file);
    if (!effects) return tl::unexpected(effects.error());
    scene.effects = *effects;
  }
  scene.cache_folder = default_cache_folder();
  const std::vector<std::string> targets = target_scene_names();
  if (std::find(targets.begin(), targets.end(), scene.name) != targets.end())
    return make_targets(camera, projector, calibration, scene, sessions);
  auto world = HeadWorld::create(camera, projector, calibration, scene, show_progress);
  if (!world) return tl::unexpected(world.error());
  const HeadWorld& made = **world;
  return Stage{*std::move(world),
               [&made](const auto& folder, std::size_t /*n*/) { return made.write_truth(folder); }};
}

// Until the child has ended, and passing on what we are told to end by.
int wait_for(ChildProcess& child, Interrupts& interrupts) {
  while (true) {
    if (const std::optional<int> code = child.wait(rig::HostClock::now()); code) return *code;
    std::array<pollfd, 2> sources{
        {{child.descriptor(), POLLIN, 0}, {interrupts.descriptor(), POLLIN, 0}}};
    poll(sources.data(), sources.size(), -1);
    if (const std::optional<Interrupt> interrupt = interrupts.take();
        interrupt && !interrupt->is_from_terminal)
      child.send(interrupt->signal);
  }
}

// False if a truth could not be written.
bool write_truths(const Stage& stage, const SessionWatch& sessions) {
  bool is_written = true;
  std::size_t n = 0;
  for (const std::filesystem::path& session : sessions.new_sessions()) {
    const estimation::Result<void> written = stage.write_truth(session / "truth", n++);
    if (written) continue;
    std::fprintf(stderr, "ssrig-sim: %s\n", written.error().text().c_str());
    is_written = false;
  }
  return is_written;
}

rig::Result<FaultPlan> plan_of(const RunOptions& options) {
  if (options.faults_file.empty()) return FaultPlan{};
  return read_fault_plan(options.faults_file);
}

// What of the plan came to pass, for the log.
void tell(const FaultSchedule& faults) {
  for (const std::string& happened : faults.happened())
    std::fprintf(stderr, "ssrig-sim: fault: %s\n", happened.c_str());
  for (const std::string& outstanding : faults.outstanding())
    std::fprintf(stderr, "ssrig-sim: fault that found no occasion: %s\n", outstanding.c_str());
}

}  // namespace

int run_command(const RunOptions& options) {
  Interrupts interrupts;
  const rig::Result<rig::RigFile> rig = rig::read_rig_file(options.rig_file);
  if (!rig) return complain(rig.error());
  const rig::Result<FaultPlan> plan = plan_of(options);
  if (!plan) return complain(plan.error());
  const rig::Result<std::unique_ptr<ScratchFolder>> scratch = ScratchFolder::make();
  if (!scratch) return complain(scratch.error());
  const SessionWatch sessions(rig->storage.directory, options.command);
  rig::Result<Stage> stage = [&] {
    const ExitOnInterrupt exit_on_interrupt(interrupts);
    return make_stage(*rig, options, sessions);
  }();
  if (!stage) return complain(stage.error());

  FaultSchedule faults(*plan);
  rig::Result<std::unique_ptr<VirtualRig>> devices =
      VirtualRig::start(*rig, *stage->world, faults, {.has_line_status = options.has_line_status});
  if (!devices) return complain(devices.error());
  int exit_code = kExitFailed;
  {
    std::map<std::string, std::string> environment = (*devices)->child_environment();
    environment["TMPDIR"] = (*scratch)->outer_tmpdir();
    rig::Result<ChildProcess> child =
        ChildProcess::start({.argv = options.command, .environment = std::move(environment)});
    if (!child) {
      complain(child.error());
      return kExitUsage;
    }
    exit_code = wait_for(*child, interrupts);
  }
  devices->reset();  // after the child: its USB calls must find an answer to the last
  tell(faults);
  if (!write_truths(*stage, sessions) && exit_code == kExitDone) return kExitFailed;
  return exit_code;
}

}  // namespace hw_sim
