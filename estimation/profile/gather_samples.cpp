#include "estimation/profile/gather_samples.h"

#include <algorithm>
#include <array>

namespace estimation {
namespace {

constexpr std::size_t kRun = 16;
constexpr std::size_t kRunsAtOnce = 64;
constexpr std::size_t kAhead = 2;  // images

enum class Spacing : std::uint8_t { kNeighbours, kEverySecond, kApart };

Spacing spacing_of(std::span<const std::uint32_t> elements) {
  if (elements.size() < kRun) return Spacing::kApart;
  bool are_neighbours = true, are_seconds = true;
  for (std::size_t i = 1; i < kRun; ++i) {
    are_neighbours = are_neighbours && elements[i] == elements[0] + i;
    are_seconds = are_seconds && elements[i] == elements[0] + 2 * i;
  }
  if (are_neighbours) return Spacing::kNeighbours;
  return are_seconds ? Spacing::kEverySecond : Spacing::kApart;
}

void copy_run(const float* image, std::span<const std::uint32_t> elements, Spacing spacing,
              float* out) {
  const float* const in = image + elements[0];
  switch (spacing) {
    case Spacing::kNeighbours:
      std::copy_n(in, kRun, out);
      return;
    case Spacing::kEverySecond:
      for (std::size_t i = 0; i < kRun; ++i) out[i] = in[2 * i];
      return;
    case Spacing::kApart:
      for (std::size_t i = 0; i < elements.size(); ++i) out[i] = image[elements[i]];
      std::fill(out + elements.size(), out + kRun, 0.0F);
      return;
  }
}

void prefetch_run(const float* image, std::span<const std::uint32_t> elements) {
  constexpr std::uint32_t kLine = 16;  // floats
  const std::uint32_t last = elements.back();
  for (std::uint32_t at = elements.front(); at <= last && at < elements.front() + 3 * kLine;
       at += kLine)
    __builtin_prefetch(image + at);
}

}  // namespace

void gather_samples(std::span<const ImageView<const float>> images,
                    std::span<const std::uint32_t> elements, std::size_t stride,
                    std::span<float> samples) {
  std::array<Spacing, kRunsAtOnce> spacings;
  for (std::size_t first = 0; first < elements.size(); first += kRun * kRunsAtOnce) {
    const auto part =
        elements.subspan(first, std::min(kRun * kRunsAtOnce, elements.size() - first));
    const std::size_t run_count = (part.size() + kRun - 1) / kRun;
    const auto run = [&](std::size_t index) {
      return part.subspan(index * kRun, std::min(kRun, part.size() - index * kRun));
    };
    for (std::size_t i = 0; i < run_count; ++i) spacings[i] = spacing_of(run(i));
    for (std::size_t image = 0; image < images.size(); ++image)
      for (std::size_t i = 0; i < run_count; ++i) {
        // Each image brings a few kilobytes only, too few for the processor to see them coming.
        if (image + kAhead < images.size()) prefetch_run(images[image + kAhead].data, run(i));
        copy_run(images[image].data, run(i), spacings[i],
                 samples.data() + image * stride + first + i * kRun);
      }
  }
}

}  // namespace estimation
