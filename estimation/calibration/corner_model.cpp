#include "estimation/calibration/corner_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <span>
#include <vector>

namespace estimation {
namespace {

// Column and row of the corner, directions of the normals of both edges, blur, then levels.
enum Parameter { kCol, kRow, kFirst, kSecond, kBlur, kBlack, kContrast, kSlopeCol, kSlopeRow };
constexpr int kParameters = 9;
using Parameters = cv::Matx<double, kParameters, 1>;
using Normal = cv::Matx<double, kParameters, kParameters>;

constexpr double kLeastBlurPx = 0.1, kGreatestBlurPx = 6, kStartBlurPx = 0.8;
// Edges sharper than this are summed at more places of a pixel.
constexpr double kSharpPx = 0.45;
// Beyond so many blurs from a pixel, an edge does not change over it.
constexpr double kReachBlurs = 5;
constexpr double kFarthestPx = 1.5;  // from the start
constexpr std::size_t kLeastPixels = 25;
constexpr double kLeastContrast = 0.1;  // of white
constexpr int kIterations = 30;

struct Pixel {
  double col = 0, row = 0, value = 0;
};

struct Prediction {
  double value = 0;
  Parameters derivative = Parameters::zeros();
};

// White where both edges have the pixel on the same side: contrast (1 + s1 s2) / 2 over black, s
// from -1 to 1 across an edge.
Prediction predict(const Parameters& p, double col, double row) {
  const double x = col - p(kCol), y = row - p(kRow);
  struct Edge {
    double step, slope;      // s, and its derivative by the distance
    double distance, along;  // px
    double cosine, sine;
  };
  const auto edge = [&](double angle) {
    Edge e{};
    e.cosine = std::cos(angle);
    e.sine = std::sin(angle);
    e.distance = e.cosine * x + e.sine * y;
    e.along = -e.sine * x + e.cosine * y;
    const double t = e.distance / p(kBlur);
    e.step = std::erf(t / std::numbers::sqrt2);
    e.slope = std::sqrt(2 / std::numbers::pi) / p(kBlur) * std::exp(-t * t / 2);
    return e;
  };
  const Edge a = edge(p(kFirst)), b = edge(p(kSecond));
  const double light = 1 + p(kSlopeCol) * x + p(kSlopeRow) * y;
  const double share = (1 + a.step * b.step) / 2;
  const double scale = p(kContrast) * light;
  const double by_a = scale * a.slope * b.step / 2, by_b = scale * b.slope * a.step / 2;
  Prediction out;
  out.value = p(kBlack) + scale * share;
  out.derivative(kCol) = -by_a * a.cosine - by_b * b.cosine - p(kContrast) * p(kSlopeCol) * share;
  out.derivative(kRow) = -by_a * a.sine - by_b * b.sine - p(kContrast) * p(kSlopeRow) * share;
  out.derivative(kFirst) = by_a * a.along;
  out.derivative(kSecond) = by_b * b.along;
  out.derivative(kBlur) = -(by_a * a.distance + by_b * b.distance) / p(kBlur);
  out.derivative(kBlack) = 1;
  out.derivative(kContrast) = light * share;
  out.derivative(kSlopeCol) = p(kContrast) * x * share;
  out.derivative(kSlopeRow) = p(kContrast) * y * share;
  return out;
}

std::vector<Pixel> pixels_around(ImageView<const float> grey, const CornerStart& start) {
  const Mat2 squares_from_px = start.px_from_squares.inv();
  const double reach_px =
      start.reach_frac *
      (std::abs(start.px_from_squares(0, 0)) + std::abs(start.px_from_squares(0, 1)) +
       std::abs(start.px_from_squares(1, 0)) + std::abs(start.px_from_squares(1, 1)));
  std::vector<Pixel> pixels;
  const int first_row = std::max(0, static_cast<int>(std::ceil(start.px[1] - reach_px)));
  const int last_row =
      std::min(grey.height_px - 1, static_cast<int>(std::floor(start.px[1] + reach_px)));
  const int first_col = std::max(0, static_cast<int>(std::ceil(start.px[0] - reach_px)));
  const int last_col =
      std::min(grey.width_px - 1, static_cast<int>(std::floor(start.px[0] + reach_px)));
  for (int row = first_row; row <= last_row; ++row)
    for (int col = first_col; col <= last_col; ++col) {
      const Vec2 at = squares_from_px * (Vec2(col, row) - start.px);
      const double across = std::abs(at[0]), down = std::abs(at[1]);
      const bool is_used =
          std::max(across, down) < start.reach_frac && std::min(across, down) < start.strip_frac;
      const float value = grey.at(row, col);
      if (is_used && std::isfinite(value))
        pixels.push_back(
            {static_cast<double>(col), static_cast<double>(row), static_cast<double>(value)});
    }
  return pixels;
}

// Directions from the board's axes, levels from the four quadrants.
std::optional<Parameters> first_guess(const std::vector<Pixel>& pixels, const CornerStart& start) {
  const Mat2& axes = start.px_from_squares;
  Parameters p = Parameters::zeros();
  p(kCol) = start.px[0];
  p(kRow) = start.px[1];
  p(kFirst) = std::atan2(-axes(0, 1), axes(1, 1));   // normal of the edge along the second axis
  p(kSecond) = std::atan2(axes(0, 0), -axes(1, 0));  // and of the one along the first
  p(kBlur) = kStartBlurPx;
  double sums[2] = {0, 0}, counts[2] = {0, 0};
  for (const Pixel& pixel : pixels) {
    const double x = pixel.col - p(kCol), y = pixel.row - p(kRow);
    const double a = std::cos(p(kFirst)) * x + std::sin(p(kFirst)) * y;
    const double b = std::cos(p(kSecond)) * x + std::sin(p(kSecond)) * y;
    if (std::min(std::abs(a), std::abs(b)) < 1) continue;
    const std::size_t is_same = a * b > 0 ? 1 : 0;
    sums[is_same] += pixel.value;
    ++counts[is_same];
  }
  if (counts[0] < 3 || counts[1] < 3) return std::nullopt;
  double other = sums[0] / counts[0], same = sums[1] / counts[1];
  if (same < other) {  // the white squares are the other two: turn an edge round
    p(kFirst) += std::numbers::pi;
    std::swap(same, other);
  }
  if (!(same - other > kLeastContrast * same)) return std::nullopt;
  p(kBlack) = other;
  p(kContrast) = same - other;
  return p;
}

struct System {
  Normal normal = Normal::zeros();
  Parameters right = Parameters::zeros();
  double cost = 0;
};

// Places and weights of a mean over -1/2 .. 1/2, by Gauss and Legendre.
struct Quadrature {
  std::span<const double> places, weights;
};

constexpr std::array<double, 1> kMiddle{0}, kWhole{1};
constexpr std::array<double, 3> kThreePlaces{-0.387298334620742, 0, 0.387298334620742};
constexpr std::array<double, 3> kThreeWeights{5.0 / 18, 8.0 / 18, 5.0 / 18};
constexpr std::array<double, 8> kEightPlaces{
    -0.480144928248768, -0.398333238706813, -0.262766204958165, -0.091717321247825,
    0.091717321247825,  0.262766204958165,  0.398333238706813,  0.480144928248768};
constexpr std::array<double, 8> kEightWeights{
    0.050614268145188, 0.111190517226687, 0.156853322938944, 0.181341891689181,
    0.181341891689181, 0.156853322938944, 0.111190517226687, 0.050614268145188};

// As many places as the edges near the pixel ask for.
Quadrature quadrature_for(const Parameters& p, const Pixel& pixel) {
  const double x = pixel.col - p(kCol), y = pixel.row - p(kRow);
  const double reach = kReachBlurs * p(kBlur) + std::numbers::sqrt2 / 2;
  const auto is_far = [&](double angle) {
    return std::abs(std::cos(angle) * x + std::sin(angle) * y) > reach;
  };
  if (is_far(p(kFirst)) && is_far(p(kSecond))) return {kMiddle, kWhole};
  if (p(kBlur) < kSharpPx) return {kEightPlaces, kEightWeights};
  return {kThreePlaces, kThreeWeights};
}

// A pixel is a square: the mean over it.
Prediction predict_pixel(const Parameters& p, const Pixel& pixel) {
  const Quadrature quadrature = quadrature_for(p, pixel);
  Prediction mean;
  for (std::size_t i = 0; i < quadrature.places.size(); ++i)
    for (std::size_t j = 0; j < quadrature.places.size(); ++j) {
      const Prediction at =
          predict(p, pixel.col + quadrature.places[i], pixel.row + quadrature.places[j]);
      const double weight = quadrature.weights[i] * quadrature.weights[j];
      mean.value += weight * at.value;
      mean.derivative += weight * at.derivative;
    }
  return mean;
}

System linearise(const std::vector<Pixel>& pixels, const Parameters& p) {
  System system;
  for (const Pixel& pixel : pixels) {
    const Prediction predicted = predict_pixel(p, pixel);
    const double residual = pixel.value - predicted.value;
    const Parameters& d = predicted.derivative;
    system.normal += d * d.t();
    system.right += residual * d;
    system.cost += residual * residual;
  }
  return system;
}

bool is_sane(const Parameters& p, const CornerStart& start) {
  const double moved = std::hypot(p(kCol) - start.px[0], p(kRow) - start.px[1]);
  return moved < kFarthestPx && p(kBlur) > kLeastBlurPx && p(kBlur) < kGreatestBlurPx &&
         p(kContrast) > 0;
}

// From the residuals' variance and the normal equations.
std::optional<double> place_sd_px(const System& system, std::size_t pixel_count) {
  bool is_definite = false;
  const Normal inverse = system.normal.inv(cv::DECOMP_CHOLESKY, &is_definite);
  if (!is_definite) return std::nullopt;
  const double variance = system.cost / static_cast<double>(pixel_count - kParameters);
  return std::sqrt(variance * (inverse(kCol, kCol) + inverse(kRow, kRow)) / 2);
}

}  // namespace

std::optional<FittedCorner> fit_corner(ImageView<const float> grey, const CornerStart& start) {
  const std::vector<Pixel> pixels = pixels_around(grey, start);
  if (pixels.size() < kLeastPixels) return std::nullopt;
  const auto guess = first_guess(pixels, start);
  if (!guess) return std::nullopt;
  Parameters p = *guess;
  System system = linearise(pixels, p);
  double damping = 1e-3;
  for (int i = 0; i < kIterations; ++i) {
    Normal damped = system.normal;
    for (int k = 0; k < kParameters; ++k) damped(k, k) *= 1 + damping;
    bool is_definite = false;
    const Normal inverse = damped.inv(cv::DECOMP_CHOLESKY, &is_definite);
    if (!is_definite) return std::nullopt;
    const Parameters step = inverse * system.right;
    Parameters next = p + step;
    next(kBlur) = std::clamp(next(kBlur), 1.01 * kLeastBlurPx, 0.99 * kGreatestBlurPx);
    const System there = linearise(pixels, next);
    if (!(there.cost <= system.cost)) {
      damping *= 10;
      if (damping > 1e6) break;
      continue;
    }
    p = next;
    system = there;
    damping = std::max(damping / 10, 1e-9);
    constexpr double kStillPx = 1e-5;
    if (std::hypot(step(kCol), step(kRow)) < kStillPx) break;
  }
  if (!is_sane(p, start)) return std::nullopt;
  const auto sd_px = place_sd_px(system, pixels.size());
  if (!sd_px) return std::nullopt;
  return FittedCorner{{p(kCol), p(kRow)}, *sd_px};
}

}  // namespace estimation
