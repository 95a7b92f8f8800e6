// What bending costs: balls and rods of a lip's material by photons through them and by the
// surface's transport, whose kernel is that of a half space.
#pragma once

#include "tests/bench/photon_window.h"
#include "tests/bench/report.h"

namespace bench {

void show_curvature(Report& report, const WindowOptions& options);

}  // namespace bench
