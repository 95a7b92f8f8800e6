#include "hw_sim/world/board_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>

namespace hw_sim {

using estimation::Image;

namespace {

constexpr int kFine = 32;             // samples of a line, a px
constexpr double kBlurStepPx = 0.05;  // between lines; light is interpolated between them
constexpr double kReachSd = 5;        // a Gaussian's tail beyond is 6e-7
constexpr int kMostTaps = 512;        // more than twice the reach of the greatest blur
constexpr double kSharpestPx = 0.02;  // less blur than this is none

// Share of a Gaussian's mass below `x` of its standard deviations.
double share_below(double x) { return 0.5 * std::erfc(-x / std::numbers::sqrt2); }

// How much of the light at a place comes from the unit square whose centre is `offset_px` away.
double weight(double offset_px, double blur_px) {
  const double blur = std::max(blur_px, kSharpestPx);
  return share_below((offset_px + 0.5) / blur) - share_below((offset_px - 0.5) / blur);
}

int reach_px(double blur_px) { return static_cast<int>(std::ceil(kReachSd * blur_px + 0.5)) + 1; }

std::vector<unsigned char> most_common_lines(const Image<unsigned char>& brightness,
                                             bool is_along_columns) {
  const int count = is_along_columns ? brightness.width_px() : brightness.height_px();
  const int across = is_along_columns ? brightness.height_px() : brightness.width_px();
  std::vector<unsigned char> profile;
  for (int i = 0; i < count; ++i) {
    // The sync square covers less than half of any line.
    const std::array<int, 3> places{across / 8, across / 2, across - 1 - across / 8};
    std::array<unsigned char, 3> values{};
    for (std::size_t k = 0; k < places.size(); ++k)
      values[k] = is_along_columns ? brightness.at(places[k], i) : brightness.at(i, places[k]);
    std::sort(values.begin(), values.end());
    profile.push_back(values[1]);
  }
  return profile;
}

}  // namespace

BlurredPicture::BlurredPicture(const Image<unsigned char>& brightness, double gamma,
                               double least_blur_px, double greatest_blur_px)
    : brightness_(brightness), greatest_blur_px_(std::max(greatest_blur_px, kSharpestPx)) {
  for (std::size_t grey = 0; grey < light_.size(); ++grey)
    light_[grey] = std::pow(static_cast<double>(grey) / 255, gamma);
  find_line(brightness);
  const double first = std::max(least_blur_px, kSharpestPx);
  for (double blur = first; blur < greatest_blur_px_ + kBlurStepPx; blur += kBlurStepPx)
    blur_line(blur);
}

// The axis that leaves the smaller box.
void BlurredPicture::find_line(const Image<unsigned char>& brightness) {
  const auto box_of = [&](const std::vector<unsigned char>& profile, bool is_along_columns) {
    Box box{brightness.height_px(), -1, brightness.width_px(), -1};
    for (int row = 0; row < brightness.height_px(); ++row)
      for (int col = 0; col < brightness.width_px(); ++col) {
        const auto i = static_cast<std::size_t>(is_along_columns ? col : row);
        if (brightness.at(row, col) == profile[i]) continue;
        box.first_row = std::min(box.first_row, row);
        box.last_row = std::max(box.last_row, row);
        box.first_col = std::min(box.first_col, col);
        box.last_col = std::max(box.last_col, col);
      }
    return box;
  };
  const auto area = [](const Box& box) {
    return std::max(0, box.last_row - box.first_row + 1) *
           std::max(0, box.last_col - box.first_col + 1);
  };
  auto columns = most_common_lines(brightness, true), rows = most_common_lines(brightness, false);
  const Box of_columns = box_of(columns, true), of_rows = box_of(rows, false);
  is_along_columns_ = area(of_columns) <= area(of_rows);
  profile_ = is_along_columns_ ? std::move(columns) : std::move(rows);
  box_ = is_along_columns_ ? of_columns : of_rows;
}

void BlurredPicture::blur_line(double blur_px) {
  const int reach = reach_px(blur_px), size = static_cast<int>(profile_.size());
  Line line{blur_px, {}};
  // The same weights for each whole px.
  std::vector<double> weights(static_cast<std::size_t>(2 * reach + 1));
  line.samples.assign(static_cast<std::size_t>((size + 2 * reach) * kFine + 1), 0.0F);
  for (int phase = 0; phase < kFine; ++phase) {
    for (int k = -reach; k <= reach; ++k)
      weights[static_cast<std::size_t>(k + reach)] =
          weight(static_cast<double>(k) - static_cast<double>(phase) / kFine, blur_px);
    for (int whole = -reach; whole < size + reach; ++whole) {
      double sum = 0;
      const int first = std::max(0, whole - reach), last = std::min(size - 1, whole + reach);
      for (int i = first; i <= last; ++i)
        sum += weights[static_cast<std::size_t>(i - whole + reach)] *
               light_[profile_[static_cast<std::size_t>(i)]];
      line.samples[static_cast<std::size_t>((whole + reach) * kFine + phase)] =
          static_cast<float>(sum);
    }
  }
  lines_.push_back(std::move(line));
}

bool BlurredPicture::is_near_box(double col_px, double row_px) const {
  const double reach = reach_px(greatest_blur_px_);
  // Lines do not end at the picture's other two borders; sums do.
  const double across = is_along_columns_ ? row_px : col_px;
  const int across_size = is_along_columns_ ? brightness_.height_px() : brightness_.width_px();
  if (across < reach || across > across_size - 1 - reach) return true;
  return col_px > box_.first_col - reach && col_px < box_.last_col + reach &&
         row_px > box_.first_row - reach && row_px < box_.last_row + reach;
}

double BlurredPicture::summed(double col_px, double row_px, double blur_px) const {
  const int reach = reach_px(blur_px);
  const int first_col = std::max(0, static_cast<int>(std::floor(col_px)) - reach);
  const int last_col =
      std::min(brightness_.width_px() - 1, static_cast<int>(std::ceil(col_px)) + reach);
  const int first_row = std::max(0, static_cast<int>(std::floor(row_px)) - reach);
  const int last_row =
      std::min(brightness_.height_px() - 1, static_cast<int>(std::ceil(row_px)) + reach);
  std::array<double, kMostTaps> of_col{};
  for (int col = first_col; col <= last_col; ++col)
    of_col[static_cast<std::size_t>(col - first_col)] = weight(col - col_px, blur_px);
  double sum = 0;
  for (int row = first_row; row <= last_row; ++row) {
    double of_row = 0;
    for (int col = first_col; col <= last_col; ++col)
      of_row +=
          of_col[static_cast<std::size_t>(col - first_col)] * light_[brightness_.at(row, col)];
    sum += weight(row - row_px, blur_px) * of_row;
  }
  return sum;
}

double BlurredPicture::on_line(const Line& line, double position_px) const {
  const double at = (position_px + reach_px(line.blur_px)) * kFine;
  const double last = static_cast<double>(line.samples.size()) - 2;
  if (!(at >= 0 && at <= last)) return 0;
  const auto i = static_cast<std::size_t>(at);
  return std::lerp(static_cast<double>(line.samples[i]), static_cast<double>(line.samples[i + 1]),
                   at - std::floor(at));
}

double BlurredPicture::at(double col_px, double row_px, double blur_px) const {
  const double margin = reach_px(greatest_blur_px_);
  const bool is_beside = col_px < -margin || row_px < -margin ||
                         col_px > brightness_.width_px() - 1 + margin ||
                         row_px > brightness_.height_px() - 1 + margin;
  if (is_beside) return 0;
  if (is_near_box(col_px, row_px)) return summed(col_px, row_px, blur_px);
  const double position_px = is_along_columns_ ? col_px : row_px;
  const double step = (blur_px - lines_.front().blur_px) / kBlurStepPx;
  const double last = static_cast<double>(lines_.size()) - 1;
  const double place = std::clamp(step, 0.0, last);
  const auto lower = static_cast<std::size_t>(place);
  const double low = on_line(lines_[lower], position_px);
  if (lower + 1 >= lines_.size()) return low;
  return std::lerp(low, on_line(lines_[lower + 1], position_px),
                   place - static_cast<double>(lower));
}

}  // namespace hw_sim
