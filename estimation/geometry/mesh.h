// The surface's points joined to triangles, for programs that know meshes.
#pragma once

#include <array>
#include <optional>

#include "estimation/base/image.h"
#include "estimation/base/linear.h"
#include "estimation/session/maps.h"
#include "estimation/session/ply.h"

namespace estimation {

struct MeshOptions {
  // Depth per sideways mm between neighbouring pixels; steeper is a step, which no face crosses.
  double max_slope = 4;
  // From camera rgb to linear sRGB, for the colours alone.
  std::optional<Mat3> color_matrix;
};

// A vertex for every pixel with position and normal that belongs to a triangle; coloured by the
// diffuse reflectance where the maps have one (a pixel without takes the mean of those around it,
// else grey). Empty maps give an empty mesh.
Mesh make_mesh(const Maps& maps, const MeshOptions& options);

}  // namespace estimation
