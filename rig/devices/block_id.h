// GVSP block ids as one growing count.
#pragma once

#include <cstdint>
#include <optional>

namespace rig {

// Turns a camera's block ids into 1, 2, 3, ... since arming. GigE Vision 1.x ids are 16 bit and
// skip 0 when they wrap; 2.x ids are 64 bit. Not thread-safe.
class BlockIdCounter {
 public:
  // Cameras that restart their ids with each acquisition begin at 1; others (Aravis' fake camera at
  // 65401) just go on. A first id above `plausible_loss` is taken for the latter and counts as 1.
  explicit BlockIdCounter(std::uint64_t plausible_loss) : plausible_loss_(plausible_loss) {}

  // The number of the block with this id, and the latest from now on. nullopt for an id that is
  // none: 0, the latest again, or one from before it.
  std::optional<std::uint64_t> advance(std::uint64_t wire_id);
  std::uint64_t latest() const { return latest_; }

 private:
  std::uint64_t plausible_loss_;
  std::uint64_t latest_ = 0;
  std::uint64_t latest_wire_id_ = 0;  // 0: none yet
};

}  // namespace rig
