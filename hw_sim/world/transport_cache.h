// Computed transport on disk, found by the content of everything it was computed from.
#pragma once

#include <filesystem>
#include <string>

#include "estimation/session/manifest.h"
#include "hw_sim/world/transport.h"

namespace hw_sim {

// Names the transport of a scene under these optics: 32 hexadecimal digits.
std::string cache_key(const estimation::CameraInfo& camera,
                      const estimation::ProjectorInfo& projector,
                      const estimation::Calibration& calibration, const std::string& scene_name,
                      ScatteringModel model, int photons_per_angle,
                      const std::vector<SeenSample>& samples);

// A cache never fails: a file that is missing, damaged or unwritable is computed again.
class TransportCache {
 public:
  TransportCache(const std::filesystem::path& folder, const std::string& key);  // empty: no cache
  bool load(Transport& transport, const std::vector<SeenSample>& samples,
            const ProjectorLight& light, const ScatterTable* table) const;
  void save(const Transport& transport) const;  // under a temporary name, then renamed

 private:
  std::filesystem::path file_;
};

}  // namespace hw_sim
