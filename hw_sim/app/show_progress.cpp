#include "hw_sim/app/show_progress.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace hw_sim {

void show_progress(double done_frac, const std::string& what) {
  if (isatty(STDERR_FILENO) == 0) return;
  constexpr int kWidth = 30;
  const auto full = static_cast<std::size_t>(std::clamp(done_frac, 0.0, 1.0) * kWidth);
  std::fprintf(stderr, "\r\033[Kssrig-sim: [%s%s] %3.0f%% %s", std::string(full, '#').c_str(),
               std::string(kWidth - full, '.').c_str(), std::floor(100 * done_frac), what.c_str());
  if (done_frac >= 1) std::fputs("\r\033[K", stderr);
}

}  // namespace hw_sim
