#include "estimation/calibration/board_observation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <set>

namespace estimation {
namespace {

// Half of the window around a corner, as a share of the distance to the nearest corner: nearly the
// whole of the four squares around.
constexpr double kWindowFrac = 0.9;
// The picture changes by more than this share of the white nearby within two pixels: an edge.
constexpr float kEdgeFrac = 0.2F;
constexpr int kEdgeRadiusPx = 2;
constexpr int kLeastPixels = 40;
constexpr int kQuadric = 6;      // 1, x, y, x^2, x y, y^2
constexpr int kRippleTerms = 2;  // of a ripple's period and of half of it
constexpr int kCoefficients = kQuadric + kRippleTerms;
constexpr int kRounds = 6;
constexpr double kTukeySd = 4.7;
// No pixel's phase is better than this: aliasing and the projector's own raster.
constexpr double kLeastSdPx = 0.01;

using Coefficients = cv::Matx<double, kCoefficients, 1>;

struct Sample {
  double x = 0, y = 0;  // from the corner, in half windows
  double value_px = 0, sd_px = 0;
};

struct LocalSurface {
  Coefficients coefficients;
  double sd_px = 0;  // of the value at the corner

  double smooth_px(double x, double y) const {
    const Coefficients& c = coefficients;
    return c(0) + c(1) * x + c(2) * y + c(3) * x * x + c(4) * x * y + c(5) * y * y;
  }
};

// At a place that the projector lights at about `lit_px`.
Coefficients terms(const Sample& s, double lit_px, const PhaseRipple& ripple) {
  Coefficients t{1, s.x, s.y, s.x * s.x, s.x * s.y, s.y * s.y, 0, 0};
  for (int i = 0; i < kRippleTerms && ripple.period_px > 0; ++i)
    t(kQuadric + i) = std::sin(2 * CV_PI * (i + 1) * (lit_px - ripple.zero_px) / ripple.period_px);
  return t;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// A quadric and the phase's ripple through samples of one axis, by least squares with Tukey's
// weights. The ripple's place in its period is that of the quadric of the round before.
std::optional<LocalSurface> fit_quadric(const std::vector<Sample>& samples,
                                        const PhaseRipple& ripple) {
  std::vector<double> weight(samples.size(), 1);
  LocalSurface surface;
  double scale = 1;
  for (int round = 0; round < kRounds; ++round) {
    const auto terms_of = [&](const Sample& s) {
      return round == 0 ? terms(s, 0, {}) : terms(s, surface.smooth_px(s.x, s.y), ripple);
    };
    using Normal = cv::Matx<double, kCoefficients, kCoefficients>;
    Normal normal = Normal::zeros();
    Coefficients right = Coefficients::zeros();
    // What stripes without any blur would do is the least that is known of a ripple.
    for (int i = 0; i < kRippleTerms; ++i)
      normal(kQuadric + i, kQuadric + i) =
          std::pow(scale / std::max(ripple.greatest_px, kLeastSdPx), 2);
    double weight_sum = 0;
    std::vector<Coefficients> all_terms;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const Sample& s = samples[i];
      const double w = weight[i] / (s.sd_px * s.sd_px);
      all_terms.push_back(terms_of(s));
      normal += w * (all_terms.back() * all_terms.back().t());
      right += (w * s.value_px) * all_terms.back();
      weight_sum += weight[i] > 0.1 ? 1 : 0;
    }
    if (weight_sum < kLeastPixels) return std::nullopt;
    bool is_definite = false;
    const Normal inverse = normal.inv(cv::DECOMP_CHOLESKY, &is_definite);
    if (!is_definite) return std::nullopt;
    surface.coefficients = inverse * right;
    std::vector<double> size;
    for (std::size_t i = 0; i < samples.size(); ++i)
      size.push_back(std::abs(samples[i].value_px - surface.coefficients.dot(all_terms[i])) /
                     samples[i].sd_px);
    scale = std::max(median(size) / 0.6745, 1e-6);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const double u = size[i] / (kTukeySd * scale);
      weight[i] = u < 1 ? (1 - u * u) * (1 - u * u) : 0;
    }
    surface.sd_px = scale * std::sqrt(inverse(0, 0));
  }
  return surface;
}

// 1 where no edge of the printed pattern is near.
cv::Mat1b find_even(ImageView<const float> grey, int white_radius_px) {
  cv::Mat1f picture(grey.height_px, grey.width_px);
  for (int row = 0; row < grey.height_px; ++row)
    for (int col = 0; col < grey.width_px; ++col)
      picture(row, col) = std::isfinite(grey.at(row, col)) ? grey.at(row, col) : 0.0F;
  cv::medianBlur(picture, picture, 3);  // noise is not an edge
  const auto square = [](int radius_px) {
    return cv::getStructuringElement(cv::MORPH_RECT, {2 * radius_px + 1, 2 * radius_px + 1});
  };
  cv::Mat1f highest, lowest, white;
  cv::dilate(picture, highest, square(kEdgeRadiusPx));
  cv::erode(picture, lowest, square(kEdgeRadiusPx));
  cv::dilate(picture, white, square(white_radius_px));
  cv::Mat1b is_even(picture.size());
  for (int row = 0; row < picture.rows; ++row)
    for (int col = 0; col < picture.cols; ++col) {
      const float step = highest(row, col) - lowest(row, col);
      is_even(row, col) = step < kEdgeFrac * white(row, col) ? 1 : 0;
    }
  return is_even;
}

double nearest_distance_px(std::span<const DetectedCorner> corners, std::size_t of) {
  double nearest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < corners.size(); ++i)
    if (i != of) nearest = std::min(nearest, cv::norm(corners[i].frame_px - corners[of].frame_px));
  return nearest;
}

struct Neighbourhood {
  std::vector<Sample> column, row;
};

Neighbourhood pixels_around(const Vec2& corner_px, double half_px,
                            const Correspondence& correspondence, const cv::Mat1b& is_even) {
  Neighbourhood around;
  const int first_row = std::max(0, cvCeil(corner_px[1] - half_px));
  const int last_row = std::min(is_even.rows - 1, cvFloor(corner_px[1] + half_px));
  const int first_col = std::max(0, cvCeil(corner_px[0] - half_px));
  const int last_col = std::min(is_even.cols - 1, cvFloor(corner_px[0] + half_px));
  for (int row = first_row; row <= last_row; ++row)
    for (int col = first_col; col <= last_col; ++col) {
      if (!is_even(row, col)) continue;
      const double x = (col - corner_px[0]) / half_px, y = (row - corner_px[1]) / half_px;
      const auto add = [&](const Image<float>& value, const Image<float>& sd,
                           std::vector<Sample>& samples) {
        const auto value_px = static_cast<double>(value.at(row, col));
        if (!std::isfinite(value_px)) return;
        samples.push_back(
            {x, y, value_px, std::hypot(static_cast<double>(sd.at(row, col)), kLeastSdPx)});
      };
      add(correspondence.column_px, correspondence.column_sd_px, around.column);
      add(correspondence.row_px, correspondence.row_sd_px, around.row);
    }
  return around;
}

void light(const Neighbourhood& around, const PhaseRipples& ripples, double half_px,
           BoardCorner& corner) {
  corner.has_projector = false;
  const auto column = fit_quadric(around.column, ripples.column);
  const auto row = fit_quadric(around.row, ripples.row);
  if (!column || !row) return;
  corner.has_projector = true;
  corner.projector_px = {column->coefficients(0), row->coefficients(0)};
  corner.projector_sd_px = std::max(
      kLeastSdPx, std::sqrt((column->sd_px * column->sd_px + row->sd_px * row->sd_px) / 2));
  corner.projector_by_camera = Mat2(column->coefficients(1), column->coefficients(2),
                                    row->coefficients(1), row->coefficients(2)) *
                               (1 / half_px);
}

void add(ImageView<const float> signal, float factor, Image<float>& sum) {
  if (sum.empty()) sum = Image<float>(signal.height_px, signal.width_px);
  for (int row = 0; row < signal.height_px; ++row)
    for (int col = 0; col < signal.width_px; ++col)
      sum.at(row, col) += factor * signal.at(row, col);
}

// Of the finest stripes along the axis: theirs decides the phase.
PhaseRipple ripple_of(std::span<const PatternSignal> signals, Axis axis) {
  std::optional<Stripes> finest;
  for (const PatternSignal& signal : signals)
    if (const auto* stripes = std::get_if<Stripes>(signal.kind); stripes && stripes->axis == axis)
      if (!finest || stripes->period_px < finest->period_px) finest = *stripes;
  if (!finest) return {};
  std::set<int> shifts;
  for (const PatternSignal& signal : signals) {
    const auto* stripes = std::get_if<Stripes>(signal.kind);
    if (!stripes || stripes->axis != axis || stripes->period_px != finest->period_px ||
        stripes->width_px != finest->width_px)
      continue;
    shifts.insert((stripes->shift_px % finest->period_px + finest->period_px) % finest->period_px);
  }
  // Shifts that leave gaps ripple in other ways, which remain errors.
  const int count = static_cast<int>(shifts.size()), step = finest->period_px / count;
  bool is_even = count >= 3 && step * count == finest->period_px;
  for (const int shift : shifts) is_even = is_even && (shift - *shifts.begin()) % step == 0;
  if (!is_even) return {};
  return {static_cast<double>(step), *shifts.begin() + (finest->width_px - 1) / 2.0,
          finest->period_px / (2 * CV_PI * (count - 1))};
}

tl::unexpected<InputError> unusable(const std::string& name, const std::string& expectation) {
  return tl::unexpected(InputError{InputFault::kInsufficient, name, "", expectation});
}

Result<BoardPose> observe(const std::string& name, std::span<const PatternSignal> signals,
                          const Board& board, const CameraInfo& camera,
                          const ProjectorInfo& projector, const CorrespondenceOptions& options) {
  const Image<float> lit = evenly_lit(signals);
  if (lit.empty())
    return unusable(name, "has no white, Gray code or stripe patterns: the board cannot be seen");
  const Image<float> grey = grey_picture(lit.view(), camera.pixel_format.filter);
  const auto corners = detect_board(grey.view(), board);
  if (!corners) return unusable(name, corners.error().text());
  const Correspondence correspondence = decode_correspondence(signals, projector, options);
  if (correspondence.column_px.empty() || correspondence.row_px.empty()) {
    std::string expectation = "the patterns do not tell both projector axes";
    for (const std::string& note : correspondence.notes) expectation += "; " + note;
    return unusable(name, expectation);
  }
  return BoardPose{
      name, light_corners(*corners, correspondence, phase_ripples(signals), grey.view(), camera)};
}

}  // namespace

std::vector<BoardCorner> light_corners(std::span<const DetectedCorner> corners,
                                       const Correspondence& correspondence,
                                       const PhaseRipples& ripples, ImageView<const float> grey,
                                       const CameraInfo& camera) {
  double largest_px = 1;
  std::vector<double> half_px;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    half_px.push_back(kWindowFrac * nearest_distance_px(corners, i));
    largest_px = std::max(largest_px, half_px.back());
  }
  const cv::Mat1b is_even = find_even(grey, static_cast<int>(largest_px));
  std::vector<BoardCorner> lit;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Vec2& px = corners[i].frame_px;
    BoardCorner corner{.board_mm = corners[i].board_mm,
                       .camera_px = px + Vec2(camera.roi_x_px, camera.roi_y_px),
                       .projector_px = {},
                       .camera_sd_px = corners[i].sd_px};
    light(pixels_around(px, half_px[i], correspondence, is_even), ripples, half_px[i], corner);
    lit.push_back(corner);
  }
  return lit;
}

PhaseRipples phase_ripples(std::span<const PatternSignal> signals) {
  return {ripple_of(signals, Axis::kColumn), ripple_of(signals, Axis::kRow)};
}

Image<float> evenly_lit(std::span<const PatternSignal> signals) {
  Image<float> white, gray_code, stripes;
  for (const PatternSignal& signal : signals) {
    if (std::holds_alternative<White>(*signal.kind)) add(signal.signal, 1, white);
    if (std::holds_alternative<Stripes>(*signal.kind)) add(signal.signal, 1, stripes);
    const auto* code = std::get_if<GrayCode>(signal.kind);
    if (!code || code->inverted) continue;
    const auto inverse = std::ranges::find_if(signals, [code](const PatternSignal& other) {
      return *other.kind == PatternKind(GrayCode{code->axis, code->bit, true});
    });
    if (inverse == signals.end()) continue;
    add(signal.signal, 1, gray_code);
    add(inverse->signal, 1, gray_code);
  }
  if (!white.empty()) return white;
  return gray_code.empty() ? stripes : gray_code;
}

Result<BoardPose> observe_board(const std::string& name, std::span<const PatternSignal> signals,
                                const Board& board, const CameraInfo& camera,
                                const ProjectorInfo& projector,
                                const CorrespondenceOptions& options) {
  try {  // OpenCV says by exceptions what it cannot do
    return observe(name, signals, board, camera, projector, options);
  } catch (const cv::Exception& error) {
    return unusable(name, "the board cannot be read (" + error.err + ")");
  }
}

}  // namespace estimation
