// The commands of ssrig-sim. Each returns the program's exit code.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace hw_sim {

enum ExitCode { kExitDone = 0, kExitFailed = 1, kExitUsage = 2, kExitDevice = 3 };

// The scene of 64 x 48 px of identity instead of a head: whose every frame is, without truth.
inline constexpr const char* kLedgerScene = "ledger";

struct RunOptions {
  std::filesystem::path rig_file;
  std::string scene = "face_female";
  bool has_indirect = true;
  std::filesystem::path effects_file;  // empty: perfect optics, nobody moves
  std::filesystem::path faults_file;   // empty: nothing goes wrong
  bool is_dipole = false;              // the paper's model in place of Monte Carlo
  std::uint64_t seed = 1;
  bool has_line_status = true;  // the camera tells the level of its line with its frames
  std::vector<std::string> command;
};

// Starts the virtual rig, runs the command against it, writes the truth beside the sessions that
// it made. The command's exit code, if it comes to that.
int run_command(const RunOptions& options);

struct PictureOptions {
  std::filesystem::path rig_file;
  std::vector<std::string> scenes;
  std::filesystem::path out;
  std::filesystem::path effects_file;  // empty: perfect optics
  bool is_dipole = false;
};

// Writes each scene under white light and under one stripe pattern as PNG files.
int picture_command(const PictureOptions& options);

struct JudgeOptions {
  std::filesystem::path session;
  std::filesystem::path maps;   // empty: SESSION/maps
  std::filesystem::path truth;  // empty: SESSION/truth
  bool is_json = false;
};

// Prints how far a session's maps are from its truth.
int judge_command(const JudgeOptions& options);

}  // namespace hw_sim
