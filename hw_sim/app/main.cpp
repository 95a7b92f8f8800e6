// ssrig-sim: the virtual rig.
#include <CLI/CLI.hpp>
#include <string>
#include <vector>

#include "hw_sim/app/commands.h"
#include "hw_sim/world/board_scene.h"
#include "hw_sim/world/scene.h"

namespace {

struct RunWords {
  std::string indirect = "on";
  std::string scattering = "monte_carlo";
};

std::vector<std::string> all_scene_names() {
  std::vector<std::string> names = hw_sim::scene_names();
  const std::vector<std::string> targets = hw_sim::target_scene_names();
  names.insert(names.end(), targets.begin(), targets.end());
  names.emplace_back(hw_sim::kLedgerScene);
  return names;
}

void add_run(CLI::App& app, hw_sim::RunOptions& options, RunWords& words) {
  CLI::App* run = app.add_subcommand(
      "run", "Start a virtual rig, run a command against it, write the truth beside its sessions");
  run->add_option("--rig", options.rig_file, "Rig file of the rig to simulate")->required();
  run->add_option("--scene", options.scene, "Who or what sits in front of the camera")
      ->check(CLI::IsMember(all_scene_names()))
      ->capture_default_str();
  run->add_option("--scattering", words.scattering,
                  "How light scatters in skin: monte_carlo, or the paper's dipole")
      ->check(CLI::IsMember({"monte_carlo", "dipole"}))
      ->capture_default_str();
  run->add_option("--indirect", words.indirect, "Light between parts of the scene: on, off")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  run->add_option("--effects", options.effects_file,
                  "TOML file of what optics, room and subject do: config/effects.example.toml");
  run->add_option("--faults", options.faults_file,
                  "TOML file of what goes wrong, where: config/faults.example.toml");
  run->add_flag("!--without-line-status", options.has_line_status,
                "A camera that does not tell with its frames which level its line had");
  run->add_option("--seed", options.seed, "Of the sensor's noise")->capture_default_str();
  run->add_option("COMMAND", options.command, "After --: the command and its arguments")
      ->required();
}

void add_picture(CLI::App& app, hw_sim::PictureOptions& options, std::string& scattering) {
  CLI::App* picture = app.add_subcommand(
      "picture", "Write scenes under white light and under one stripe pattern as PNG files");
  picture->add_option("--rig", options.rig_file, "Rig file of the rig to simulate")->required();
  picture->add_option("--out", options.out, "Folder of the pictures")->required();
  options.scenes = hw_sim::scene_names();
  picture->add_option("--scene", options.scenes, "Which; by default all")
      ->check(CLI::IsMember(hw_sim::scene_names()));
  picture->add_option("--scattering", scattering, "How light scatters in skin")
      ->check(CLI::IsMember({"monte_carlo", "dipole"}))
      ->capture_default_str();
  picture->add_option("--effects", options.effects_file,
                      "TOML file of what optics, room and subject do");
}

void add_judge(CLI::App& app, hw_sim::JudgeOptions& options) {
  CLI::App* judge = app.add_subcommand("judge", "Errors of a session's maps against its truth");
  judge->add_option("SESSION", options.session, "Session folder")->required();
  judge->add_option("--maps", options.maps, "Folder of the maps (default: SESSION/maps)");
  judge->add_option("--truth", options.truth, "Folder of the truth (default: SESSION/truth)");
  judge->add_flag("--json", options.is_json, "As JSON instead of a table");
}

}  // namespace

int main(int argc, char** argv) {  // NOLINT(bugprone-exception-escape): CLI11's own are caught
  CLI::App app(
      "The virtual rig: devices at the far end of real wires, and a head in front of them");
  app.require_subcommand(1);
  hw_sim::RunOptions run;
  RunWords words;
  hw_sim::JudgeOptions judge;
  add_run(app, run, words);
  add_judge(app, judge);
  hw_sim::PictureOptions picture;
  std::string picture_scattering = "monte_carlo";
  add_picture(app, picture, picture_scattering);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {  // also --help
    return app.exit(error) == 0 ? hw_sim::kExitDone : hw_sim::kExitUsage;
  }
  run.has_indirect = words.indirect == "on";
  run.is_dipole = words.scattering == "dipole";
  picture.is_dipole = picture_scattering == "dipole";
  if (app.got_subcommand("picture")) return hw_sim::picture_command(picture);
  return app.got_subcommand("run") ? hw_sim::run_command(run) : hw_sim::judge_command(judge);
}
