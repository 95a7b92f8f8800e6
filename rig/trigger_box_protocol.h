// TB1, the trigger box's wire protocol.
#pragma once

#include <cstdint>

namespace rig::tb1 {

struct Record {
  std::uint8_t type = 0;
};

}  // namespace rig::tb1
