#include "rig/devices/aravis_look.h"

#include <array>

namespace rig {
namespace {

// SFNC's names and those of before it; selectors ahead of what they select.
constexpr std::array<const char*, 16> kNames{"GainSelector",
                                             "Gain",
                                             "GainRaw",
                                             "BlackLevelSelector",
                                             "BlackLevel",
                                             "BlackLevelRaw",
                                             "GammaEnable",
                                             "Gamma",
                                             "LUTEnable",
                                             "DigitalShift",
                                             "BinningVertical",
                                             "BinningHorizontal",
                                             "DecimationVertical",
                                             "DecimationHorizontal",
                                             "ReverseX",
                                             "ReverseY"};

}  // namespace

Result<CameraLook> read_look(const AravisFeatures& features) {
  CameraLook look;
  for (const char* name : kNames) {
    if (!features.has(name)) continue;
    Result<std::string> value = features.value(name);
    if (!value) return tl::unexpected(value.error());
    look.emplace_back(name, std::move(*value));
  }
  return look;
}

Result<void> restore_look(const AravisFeatures& features, const CameraLook& look) {
  for (const auto& [name, wanted] : look) {
    const Result<std::string> present = features.value(name);
    if (!present) return tl::unexpected(present.error());
    if (*present == wanted) continue;
    if (auto set = features.set_value(name, wanted); !set) return set;
  }
  return {};
}

}  // namespace rig
