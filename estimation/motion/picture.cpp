#include "estimation/motion/picture.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace estimation {
namespace {

cv::Mat as_mat(const Image<float>& image) {
  // OpenCV knows no const pixels; it only reads here.
  return {
      image.height_px(), image.width_px(), CV_32F,
      const_cast<float*>(image.samples().data())};  // NOLINT(cppcoreguidelines-pro-type-const-cast)
}

cv::Mat as_mat(Image<float>& image) {
  return {image.height_px(), image.width_px(), CV_32F, image.samples().data()};
}

int cell_side(const CameraInfo& camera) {
  constexpr int kMostCells = 640;
  const bool is_bayer = camera.pixel_format.filter != ColorFilter::kMono &&
                        camera.pixel_format.filter != ColorFilter::kRgb;
  const int base = is_bayer ? 2 : 1;
  const int needed = (camera.width_px + kMostCells - 1) / kMostCells;
  return std::max(base, (needed + base - 1) / base * base);
}

// A Gaussian around `centre`, in [-1/2, 1/2], sampled at whole cells; its sum is 1.
cv::Mat kernel_around(double centre, double sigma_cells) {
  const int reach = static_cast<int>(std::ceil(4 * sigma_cells + 0.5));
  cv::Mat kernel(2 * reach + 1, 1, CV_32F);
  double sum = 0;
  for (int pass = 0; pass < 2; ++pass) {
    const double scale = pass == 0 ? 1 : 1 / sum;
    for (int k = -reach; k <= reach; ++k) {
      const double distance = (k - centre) / sigma_cells;
      const double weight = std::exp(-0.5 * distance * distance);
      kernel.at<float>(k + reach) = static_cast<float>(scale * weight);
      if (pass == 0) sum += weight;
    }
  }
  return kernel;
}

}  // namespace

double clip_level_dn(const CameraInfo& camera) {
  return camera.saturation_level_dn.value_or((1 << camera.pixel_format.bit_depth) - 1);
}

Picture make_picture(const CameraInfo& camera, ImageView<const std::uint16_t> frame_dn) {
  Picture picture;
  picture.bin_px = cell_side(camera);
  const int height = frame_dn.height_px / picture.bin_px,
            width = frame_dn.width_px / picture.bin_px;
  picture.light = Image<float>(height, width);
  picture.is_usable = Image<unsigned char>(height, width, 1, 1);
  const auto black_dn = static_cast<float>(camera.black_level_dn.value_or(0));
  const double clipped_dn = clip_level_dn(camera);
  const int samples_a_row = picture.bin_px * frame_dn.channel_count;
  const auto sample_count = static_cast<float>(samples_a_row * picture.bin_px);
  for (int row = 0; row < height; ++row) {
    for (int col = 0; col < width; ++col) {
      std::uint32_t sum = 0;
      std::uint16_t largest = 0;
      for (int i = 0; i < picture.bin_px; ++i) {
        const std::uint16_t* samples = &frame_dn.at(row * picture.bin_px + i, col * picture.bin_px);
        for (int k = 0; k < samples_a_row; ++k) {
          sum += samples[k];
          largest = std::max(largest, samples[k]);
        }
      }
      picture.light.at(row, col) = static_cast<float>(sum) / sample_count - black_dn;
      if (largest >= clipped_dn) picture.is_usable.at(row, col) = 0;
    }
  }
  return picture;
}

Image<float> smoothed(const Image<float>& light, double sigma_cells, const CellShift& shift) {
  const int height = light.height_px(), width = light.width_px();
  const double whole_rows = std::round(shift.row), whole_cols = std::round(shift.col);
  Image<float> result(height, width);
  if (result.empty()) return result;
  cv::Mat into = as_mat(result);
  cv::sepFilter2D(as_mat(light), into, CV_32F, kernel_around(shift.col - whole_cols, sigma_cells),
                  kernel_around(shift.row - whole_rows, sigma_cells), {-1, -1}, 0,
                  cv::BORDER_REPLICATE);
  if (whole_rows == 0 && whole_cols == 0) return result;
  Image<float> moved(height, width);
  for (int row = 0; row < height; ++row) {
    const int from_row = std::clamp(row + static_cast<int>(whole_rows), 0, height - 1);
    for (int col = 0; col < width; ++col)
      moved.at(row, col) =
          result.at(from_row, std::clamp(col + static_cast<int>(whole_cols), 0, width - 1));
  }
  return moved;
}

Image<float> local_mean(const Picture& picture, double period_px) {
  // Of the period: levels the stripes to 3%, and the face's own picture as little as may be.
  constexpr double kPeriodSmoothing = 0.42;
  constexpr double kLeastSmoothing = 1.0;    // cells
  constexpr double kLongestSmoothing = 0.1;  // of the width: a coarse Gray code has no mean
  const double longest = std::max(kLeastSmoothing, kLongestSmoothing * picture.light.width_px());
  return smoothed(picture.light, std::clamp(kPeriodSmoothing * period_px / picture.bin_px,
                                            kLeastSmoothing, longest));
}

CellShift coarse_shift(const Image<float>& first, const Image<float>& second) {
  cv::Mat window;
  cv::createHanningWindow(window, {first.width_px(), first.height_px()}, CV_32F);
  const cv::Point2d shift = cv::phaseCorrelate(as_mat(first), as_mat(second), window);
  return {std::round(shift.y), std::round(shift.x)};
}

Image<unsigned char> shrunk(const Image<unsigned char>& is_usable, int margin_cells) {
  const int height = is_usable.height_px(), width = is_usable.width_px();
  Image<unsigned char> result(height, width);
  for (int row = margin_cells; row < height - margin_cells; ++row) {
    for (int col = margin_cells; col < width - margin_cells; ++col) {
      bool is_clear = true;
      for (int r = row - margin_cells; r <= row + margin_cells && is_clear; ++r)
        for (int c = col - margin_cells; c <= col + margin_cells; ++c)
          is_clear = is_clear && is_usable.at(r, c) != 0;
      result.at(row, col) = is_clear ? 1 : 0;
    }
  }
  return result;
}

double median_of(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace estimation
