// How far a world's making is, on a terminal; nothing in a log.
#pragma once

#include <string>

namespace hw_sim {

void show_progress(double done_frac, const std::string& what);

}  // namespace hw_sim
