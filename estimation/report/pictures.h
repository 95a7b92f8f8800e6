// The single quick-look pictures as canvases. OpenCV may throw; write_quicklook catches.
#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "estimation/report/plot.h"
#include "estimation/report/quicklook.h"

namespace estimation::plot {

// One panel a band on a common scale, with a colour bar.
Canvas draw_bands(const std::string& title, const std::string& unit, const BandMaps& bands,
                  int band_count);
Canvas draw_depth(const Image<float>& depth_mm);
// x, y, z of the normal as red, green, blue; facing the camera is bluish.
Canvas draw_normals(const std::array<Image<float>, 3>& normal);
// Each pixel by its gravest bit of any band, with a legend of the shares.
Canvas draw_validity(const std::array<Image<std::uint32_t>, 3>& validity, int band_count);
// Four plots, two by two.
Canvas draw_profiles(std::span<const ProfilePoint> points, int band_count);
// Demosaiced, gamma 2.2, black removed where known.
Canvas draw_frame(const QuicklookFrame& frame, const CameraInfo& camera);

}  // namespace estimation::plot
