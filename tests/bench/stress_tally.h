// What became of random pixels: counts that can be added up, and kept in a file.
#pragma once

#include <cstdint>
#include <filesystem>

#include "tests/bench/stress_pixels.h"

namespace bench {

struct StressTally {
  std::uint64_t pixels = 0, valid = 0, not_finite = 0, negative_sigma = 0;
  std::uint64_t saturated = 0, too_dark = 0, outside = 0, not_identifiable = 0;
  std::uint64_t bits = 0;  // a sum over batches of what all numbers of a batch hash to

  StressTally operator+(const StressTally& other) const;
};

// Batches `first` to `last` - 1, in the caller's oneTBB arena.
StressTally stress(const StressPixels& pixels, std::uint64_t first, std::uint64_t last);

// A count under way: batches 0 to batch_count - 1 so far.
struct StressCount {
  std::uint64_t batch_count = 0;
  double seconds = 0;
  StressTally tally;
};

// Counts up to `batch_count` batches in constant memory. Every few million pixels says on standard
// error how far it is and writes that to `file`; goes on from there if the file exists, which must
// be of the same build, and takes it away in the end.
StressCount stress_with_progress(const StressPixels& pixels, std::uint64_t batch_count,
                                 const std::filesystem::path& file);

}  // namespace bench
