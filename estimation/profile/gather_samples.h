// From images of merged signals to a batch's compact rows.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "estimation/base/image.h"

namespace estimation {

// samples[image][i] = the image's element elements[i], rows `stride` apart; 0 from elements.size()
// up to the next multiple of 16. Neighbouring elements, or every second one as in a mosaic, are
// copied in runs, the next images fetched meanwhile. No allocation.
//   images    of one size and layout, at least one
//   elements  indices from the images' first element on, best in image order
void gather_samples(std::span<const ImageView<const float>> images,
                    std::span<const std::uint32_t> elements, std::size_t stride,
                    std::span<float> samples);

}  // namespace estimation
