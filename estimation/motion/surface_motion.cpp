#include "estimation/motion/surface_motion.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "estimation/geometry/triangulation.h"
#include "estimation/motion/picture.h"

namespace estimation {
namespace {

constexpr double kSmoothing = 1.0;  // cells
constexpr int kParameters = 5;      // translation, gain, ambient light
using Vec5 = cv::Vec<double, kParameters>;
using Mat5 = cv::Matx<double, kParameters, kParameters>;

double value(const Image<float>& image, int row, int col) {
  return static_cast<double>(image.at(row, col));
}

// How the second picture differs from the first at one cell, and would with each parameter.
struct Equation {
  int block = 0;
  Vec5 slope;
  double residual = 0;
  double noise = 1;
};

struct Sums {
  Mat5 matrix = Mat5::zeros();
  Vec5 vector = Vec5::all(0);
  void add(const Equation& equation, double weight) {
    for (int i = 0; i < kParameters; ++i) {
      vector[i] += weight * equation.slope[i] * equation.residual;
      for (int k = 0; k < kParameters; ++k)
        matrix(i, k) += weight * equation.slope[i] * equation.slope[k];
    }
  }
  std::optional<Vec5> solution() const {
    // On the scale of each parameter's own sum: they have different units.
    Mat5 scaled = matrix;
    Vec5 scale;
    for (int i = 0; i < kParameters; ++i) scale[i] = std::sqrt(matrix(i, i));
    for (int i = 0; i < kParameters; ++i)
      for (int k = 0; k < kParameters; ++k) scaled(i, k) /= scale[i] * scale[k];
    bool is_regular = false;
    const Mat5 inverse = scaled.inv(cv::DECOMP_CHOLESKY, &is_regular);
    if (!is_regular) return std::nullopt;
    Vec5 right;
    for (int i = 0; i < kParameters; ++i) right[i] = vector[i] / scale[i];
    Vec5 answer = inverse * right;
    for (int i = 0; i < kParameters; ++i) answer[i] /= scale[i];
    return answer;
  }
};

Vec3 at(const std::array<Image<float>, 3>& map, int row, int col) {
  return {value(map[0], row, col), value(map[1], row, col), value(map[2], row, col)};
}

// Of the three directions, how much of the best told one's strength the worst told one has: 0.43 on
// a sphere, 0.15 on a face; 0.0002 on a plane, by the noise of its normals.
double evenness(const std::vector<Equation>& equations) {
  Mat3 sums = Mat3::zeros();
  for (const Equation& equation : equations)
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 3; ++k) sums(i, k) += equation.slope[i] * equation.slope[k];
  cv::Mat strengths;
  cv::SVD::compute(cv::Mat(sums), strengths, cv::SVD::NO_UV);
  return strengths.at<double>(2) / strengths.at<double>(0);
}

bool is_known(const Vec3& v) {
  return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]);
}

// The equations of all cells where the surface is known and lit.
class Equations {
 public:
  Equations(const CameraInfo& camera, const Calibration& calibration, Axis axis, const Maps& maps,
            const Picture& first, const Picture& second, double period_px)
      : stereo_(calibration, camera),
        axis_(axis),
        maps_(maps),
        bin_px_(first.bin_px),
        first_(smoothed(first.light, kSmoothing)),
        second_(smoothed(second.light, kSmoothing)),
        mean_(local_mean(first, period_px)),
        first_usable_(shrunk(first.is_usable, 3)),
        second_usable_(shrunk(second.is_usable, 3)),
        shot_dn_(1 / camera.gain_e_per_dn.value_or(1) / (first.bin_px * first.bin_px)) {}

  std::vector<Equation> gather() const {
    std::vector<Equation> equations;
    for (int row = 2; row + 2 < first_.height_px(); ++row)
      for (int col = 2; col + 2 < first_.width_px(); ++col)
        if (auto equation = equation_at(row, col)) equations.push_back(*equation);
    return equations;
  }
  static constexpr int kBlocksAcross = 12, kBlocksDown = 9;

 private:
  std::optional<Equation> equation_at(int row, int col) const {
    if (first_usable_.at(row, col) == 0 || second_usable_.at(row, col) == 0) return std::nullopt;
    const int r = row * bin_px_ + bin_px_ / 2, c = col * bin_px_ + bin_px_ / 2;
    if (r + bin_px_ >= maps_.height_px || c + bin_px_ >= maps_.width_px) return std::nullopt;
    const Vec3 point_mm = at(maps_.position_mm, r, c), normal = at(maps_.normal, r, c);
    if (!is_known(point_mm) || !is_known(normal) || !(point_mm[2] > 0)) return std::nullopt;
    const Image<float>& u = maps_.correspondence_px[axis_ == Axis::kColumn ? 0 : 1];
    const double u_by_row = 0.5 * (value(u, r + bin_px_, c) - value(u, r - bin_px_, c));
    const double u_by_col = 0.5 * (value(u, r, c + bin_px_) - value(u, r, c - bin_px_));
    const double square = u_by_row * u_by_row + u_by_col * u_by_col;
    const auto lit = stereo_.project(point_mm);
    const Vec3 ray = point_mm / point_mm[2];
    const double facing = normal.dot(ray);
    constexpr double kGrazing = 0.2;  // |cosine|: beyond, depth changes without bound
    if (!std::isfinite(square) || !(square > 0) || !lit || std::abs(facing) < kGrazing)
      return std::nullopt;
    const Vec3& by_point =
        axis_ == Axis::kColumn ? lit->column_gradient_px_per_mm : lit->row_gradient_px_per_mm;
    // Of both pictures: to second order that of the way between them.
    const auto light = [&](int i, int k) {
      return 0.5 * (value(first_, row + i, col + k) + value(second_, row + i, col + k));
    };
    // Over five cells: over three, a stripe of twelve would lose 4% of its slope.
    const double light_by_row =
        (8 * (light(1, 0) - light(-1, 0)) - (light(2, 0) - light(-2, 0))) / 12;
    const double light_by_col =
        (8 * (light(0, 1) - light(0, -1)) - (light(0, 2) - light(0, -2))) / 12;
    const double light_by_u = (light_by_row * u_by_row + light_by_col * u_by_col) / square;
    const Vec3 by_translation = normal * (light_by_u * by_point.dot(ray) / facing);
    const double here = value(first_, row, col);
    Equation equation;
    equation.block = (row * kBlocksDown / first_.height_px()) * kBlocksAcross +
                     col * kBlocksAcross / first_.width_px();
    equation.slope = {by_translation[0], by_translation[1], by_translation[2], here,
                      value(mean_, row, col)};
    equation.residual = value(second_, row, col) - here;
    // A hundredth of the light beside the noise: the model is no better.
    equation.noise = std::sqrt(1 + shot_dn_ * std::max(here, 0.0) + 1e-4 * here * here);
    return equation;
  }

  const Stereo stereo_;
  const Axis axis_;
  const Maps& maps_;
  const int bin_px_;
  const Image<float> first_, second_, mean_;
  const Image<unsigned char> first_usable_, second_usable_;
  const double shot_dn_;
};

// Least squares, outliers held down; [block] sums at the end.
std::optional<Vec5> solve(const std::vector<Equation>& equations, std::vector<Sums>& blocks) {
  std::optional<Vec5> answer = Vec5::all(0);
  double limit = 1e30;
  constexpr int kRounds = 5;
  for (int round = 0; round < kRounds; ++round) {
    std::fill(blocks.begin(), blocks.end(), Sums{});
    std::vector<double> sizes;
    for (const Equation& equation : equations) {
      const double left = std::abs(equation.residual - equation.slope.dot(*answer));
      const double size = left / equation.noise;
      const double weight = size > limit ? limit / size : 1;  // Huber's
      blocks[static_cast<std::size_t>(equation.block)].add(
          equation, weight / (equation.noise * equation.noise));
      sizes.push_back(size);
    }
    Sums all;
    for (const Sums& block : blocks) all.matrix += block.matrix, all.vector += block.vector;
    answer = all.solution();
    if (!answer) return std::nullopt;
    const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
    std::nth_element(sizes.begin(), middle, sizes.end());
    limit = std::max(2 * 1.4826 * *middle, 1e-6);
  }
  return answer;
}

// By leaving out one block at a time; nullopt: there are too few.
std::optional<Vec3> jackknife_sd_mm(const std::vector<Sums>& blocks) {
  Sums all;
  for (const Sums& block : blocks) all.matrix += block.matrix, all.vector += block.vector;
  std::vector<Vec5> answers;
  for (const Sums& block : blocks) {
    if (block.matrix(3, 3) == 0) continue;
    Sums rest;
    rest.matrix = all.matrix - block.matrix;
    rest.vector = all.vector - block.vector;
    if (const auto answer = rest.solution()) answers.push_back(*answer);
  }
  constexpr std::size_t kFewestAnswers = 3;
  if (answers.size() < kFewestAnswers) return std::nullopt;
  const auto count = static_cast<double>(answers.size());
  Vec3 sd_mm;
  for (int i = 0; i < 3; ++i) {
    double mean = 0, squares = 0;
    for (const Vec5& answer : answers) mean += answer[i] / count;
    for (const Vec5& answer : answers) squares += (answer[i] - mean) * (answer[i] - mean);
    sd_mm[i] = std::sqrt(squares * (count - 1) / count);
  }
  return sd_mm;
}

}  // namespace

Result<SurfaceMotion> measure_surface_motion(const CameraInfo& camera,
                                             const Calibration& calibration, Axis axis,
                                             double period_px, const Maps& maps,
                                             ImageView<const std::uint16_t> first,
                                             ImageView<const std::uint16_t> second) {
  for (const auto& frame : {first, second}) {
    if (frame.height_px != camera.height_px || frame.width_px != camera.width_px ||
        maps.height_px != camera.height_px || maps.width_px != camera.width_px)
      return tl::unexpected(InputError{InputFault::kInvalid, "", "",
                                       "frames and maps to compare are not of the camera's size"});
  }
  const auto insufficient = [](const std::string& why) {
    return tl::unexpected(InputError{InputFault::kInsufficient, "", "", why});
  };
  if (maps.position_mm[0].empty() || maps.normal[0].empty() ||
      maps.correspondence_px[axis == Axis::kColumn ? 0 : 1].empty())
    return insufficient("there is no surface");
  const Picture before = make_picture(camera, first), after = make_picture(camera, second);
  const auto equations =
      Equations(camera, calibration, axis, maps, before, after, period_px).gather();
  constexpr std::size_t kFewestCells = 200;
  if (equations.size() < kFewestCells) return insufficient("too little of the surface is lit");
  constexpr double kLeastEvenness = 0.01;
  if (!(evenness(equations) > kLeastEvenness))
    return insufficient("the surface does not tell three directions apart");
  std::vector<Sums> blocks(
      static_cast<std::size_t>(Equations::kBlocksAcross * Equations::kBlocksDown));
  const auto answer = solve(equations, blocks);
  if (!answer) return insufficient("the surface does not tell three directions apart");
  const auto sd_mm = jackknife_sd_mm(blocks);
  if (!sd_mm) return insufficient("too little of the surface is lit");
  return SurfaceMotion{
      {(*answer)[0], (*answer)[1], (*answer)[2]}, *sd_mm, static_cast<int>(equations.size())};
}

}  // namespace estimation
