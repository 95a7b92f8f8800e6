// Charts of the calibration's reports, on the report's plotting kit. Private to this folder.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "estimation/report/plot.h"
#include "estimation/session/error.h"

namespace estimation {

struct ChartSeries {
  std::string name;
  plot::Color color;
  bool is_line = false;
  std::vector<cv::Point2d> points;
};

struct Chart {
  std::string title, x_label, y_label;
  std::vector<ChartSeries> series;
  bool starts_at_zero = true;  // the y axis
};

inline const plot::Color kRedInk{45, 45, 205}, kGreenInk{60, 150, 40}, kBlueInk{200, 95, 30};
// Of the camera's bands, in their order.
plot::Color band_color(int band);

plot::Canvas draw_chart(const Chart& chart);

// A PNG in `folder`, made if absent; whole or not at all.
Result<void> save_picture(const std::filesystem::path& folder, const std::string& file,
                          const plot::Canvas& canvas);

}  // namespace estimation
