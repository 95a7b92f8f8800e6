#include <cstdio>

#include "hw_sim/app/commands.h"
#include "hw_sim/world/judge.h"

namespace hw_sim {

int judge_command(const JudgeOptions& options) {
  const std::filesystem::path maps = options.maps.empty() ? options.session / "maps" : options.maps;
  const std::filesystem::path truth =
      options.truth.empty() ? options.session / "truth" : options.truth;
  const estimation::Result<JudgeReport> report = judge(maps, truth);
  if (!report) {
    std::fprintf(stderr, "ssrig-sim: %s\n", report.error().text().c_str());
    return kExitFailed;
  }
  std::puts(options.is_json ? report->json().c_str() : report->table().c_str());
  return kExitDone;
}

}  // namespace hw_sim
