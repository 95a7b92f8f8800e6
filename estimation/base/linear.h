// Three-vectors and 3x3 matrices: OpenCV's small fixed-size types, under our names.
#pragma once

#include <opencv2/core/matx.hpp>

namespace estimation {

using Vec3 = cv::Vec3d;
using Mat3 = cv::Matx33d;  // row-major

}  // namespace estimation
