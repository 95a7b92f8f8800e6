#include "estimation/calibration/board.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "estimation/calibration/corner_model.h"

namespace estimation {
namespace {

constexpr int kLeastSquares = 3, kMostSquares = 100;
// Larger pictures are reduced for the search (not for the refinement).
constexpr int kSearchWidthPx = 1300;
constexpr double kWhiteQuantile = 0.995;
// Half of the rough refinement's window, as a share of the distance to the nearest corner; px.
constexpr double kWindowFrac = 0.3;
constexpr int kLeastWindowPx = 2, kLargestWindowPx = 15;
// Of a corner that stays where the rough refinement put it, and what the model of two edges errs by
// without any noise (0.0003 px usually, 0.008 where perfectly sharp edges lie along the pixels).
constexpr double kRoughSdPx = 0.1, kModelSdPx = 0.002;
// The board's axes at a corner are those of the corners so near.
constexpr double kAxesReachSquares = 2.5;
// A ChArUco board's markers begin an eighth of a square from its edges, and their blur before that.
constexpr double kMarkerBlurPx = 2, kLeastStripPx = 2;

tl::unexpected<InputError> not_found(const std::string& expectation) {
  return tl::unexpected(InputError{InputFault::kInsufficient, "", "", expectation});
}

double quantile(std::vector<float> values, double share) {
  if (values.empty()) return 0;
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return static_cast<double>(*at);
}

// 0 for black or missing, 1 for white paper.
cv::Mat1f normalised(ImageView<const float> grey) {
  std::vector<float> finite;
  for (int row = 0; row < grey.height_px; ++row)
    for (const float value : grey.row(row))
      if (std::isfinite(value)) finite.push_back(value);
  const double white = std::max(quantile(std::move(finite), kWhiteQuantile), 1e-30);
  cv::Mat1f picture(grey.height_px, grey.width_px);
  for (int row = 0; row < grey.height_px; ++row)
    for (int col = 0; col < grey.width_px; ++col) {
      const double value = static_cast<double>(grey.at(row, col)) / white;
      picture(row, col) =
          std::isfinite(value) ? static_cast<float>(std::clamp(value, 0.0, 1.2)) : 0.0F;
    }
  return picture;
}

struct SearchPicture {
  cv::Mat1b picture;
  double scale = 1;  // of the picture over the search picture
  cv::Point2f to_full(cv::Point2f at) const {
    const auto s = static_cast<float>(scale);
    return {(at.x + 0.5F) * s - 0.5F, (at.y + 0.5F) * s - 0.5F};
  }
};

SearchPicture search_picture(const cv::Mat1f& picture) {
  SearchPicture search;
  cv::Mat1f reduced = picture;
  if (picture.cols > kSearchWidthPx) {
    const cv::Size size(kSearchWidthPx,
                        cvRound(1.0 * picture.rows * kSearchWidthPx / picture.cols));
    cv::resize(picture, reduced, size, 0, 0, cv::INTER_AREA);
    search.scale = 1.0 * picture.cols / kSearchWidthPx;
  }
  // The square root lifts dark corners of the picture and ink that reflects little.
  cv::Mat1f lifted;
  cv::sqrt(reduced, lifted);
  lifted.convertTo(search.picture, CV_8U, 255 / std::sqrt(1.2));
  return search;
}

struct Found {
  std::vector<Vec2> board_mm;
  std::vector<cv::Point2f> px;
};

Found find_checkerboard(const SearchPicture& search, const Board& board) {
  Found found;
  const cv::Size corners(board.col_count - 1, board.row_count - 1);
  constexpr int kFlags = cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_EXHAUSTIVE;
  if (!cv::findChessboardCornersSB(search.picture, corners, found.px, kFlags)) return {};
  for (int row = 0; row < corners.height; ++row)
    for (int col = 0; col < corners.width; ++col)
      found.board_mm.emplace_back(board.square_mm * col, board.square_mm * row);
  return found;
}

Found find_charuco(const SearchPicture& search, const Board& board) {
  const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_5X5_250);
  const auto square = static_cast<float>(board.square_mm);
  const auto charuco =
      cv::aruco::CharucoBoard::create(board.col_count, board.row_count, square,
                                      square * static_cast<float>(kCharucoMarkerFrac), dictionary);
  std::vector<std::vector<cv::Point2f>> markers;
  std::vector<int> marker_ids, ids;
  Found found;
  cv::aruco::detectMarkers(search.picture, dictionary, markers, marker_ids);
  if (marker_ids.empty()) return {};
  cv::aruco::interpolateCornersCharuco(markers, marker_ids, search.picture, charuco, found.px, ids);
  for (const int id : ids) {
    // From the board's border to its first inner corner is one square.
    const cv::Point3f& corner = charuco->chessboardCorners[static_cast<std::size_t>(id)];
    found.board_mm.emplace_back(static_cast<double>(corner.x) - board.square_mm,
                                static_cast<double>(corner.y) - board.square_mm);
  }
  return found;
}

double nearest_distance_px(const std::vector<cv::Point2f>& corners, std::size_t of) {
  double nearest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < corners.size(); ++i)
    if (i != of) nearest = std::min(nearest, cv::norm(corners[i] - corners[of]));
  return nearest;
}

// Good to some tenths of a pixel, for the fit to start from.
void refine_roughly(const cv::Mat1f& picture, std::vector<cv::Point2f>& corners) {
  double least_px = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < corners.size(); ++i)
    least_px = std::min(least_px, nearest_distance_px(corners, i));
  const int window_px =
      std::clamp(static_cast<int>(kWindowFrac * least_px), kLeastWindowPx, kLargestWindowPx);
  const cv::TermCriteria criteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 50, 1e-4);
  cv::cornerSubPix(picture, corners, {window_px, window_px}, {-1, -1}, criteria);
}

// How a step of one square along either axis of the board looks near a corner: by least squares
// over the corners around.
std::optional<Mat2> local_axes(const Found& found, std::size_t of, double square_mm) {
  Mat2 moments = Mat2::zeros(), mixed = Mat2::zeros();
  for (std::size_t i = 0; i < found.px.size(); ++i) {
    const Vec2 step = (found.board_mm[i] - found.board_mm[of]) / square_mm;
    if (i == of || std::max(std::abs(step[0]), std::abs(step[1])) > kAxesReachSquares) continue;
    const Vec2 px(cv::Point2d(found.px[i]) - cv::Point2d(found.px[of]));
    moments += step * step.t();
    mixed += px * step.t();
  }
  if (std::abs(cv::determinant(moments)) < 1e-6) return std::nullopt;
  return Mat2(mixed * moments.inv());
}

// Corners that the model does not fit stay where they are.
std::vector<DetectedCorner> refine(ImageView<const float> grey, const Board& board,
                                   const Found& found) {
  const bool has_markers = board.kind == BoardKind::kCharuco;
  std::vector<DetectedCorner> refined;
  for (std::size_t i = 0; i < found.px.size(); ++i) {
    DetectedCorner corner{found.board_mm[i], Vec2(cv::Point2d(found.px[i])), kRoughSdPx};
    std::optional<FittedCorner> fitted;
    if (const auto axes = local_axes(found, i, board.square_mm)) {
      CornerStart start{corner.frame_px, *axes};
      const double edge_px = std::sqrt(std::abs(cv::determinant(*axes)));
      if (has_markers)
        start.strip_frac = std::max((1 - kCharucoMarkerFrac) / 2 - kMarkerBlurPx / edge_px,
                                    kLeastStripPx / edge_px);
      fitted = fit_corner(grey, start);
    }
    if (fitted) {
      corner.frame_px = fitted->px;
      corner.sd_px = std::hypot(fitted->sd_px, kModelSdPx);
    }
    refined.push_back(corner);
  }
  return refined;
}

Result<std::vector<DetectedCorner>> detect(ImageView<const float> grey, const Board& board) {
  const cv::Mat1f picture = normalised(grey);
  const SearchPicture search = search_picture(picture);
  const bool is_checkerboard = board.kind == BoardKind::kCheckerboard;
  Found found = is_checkerboard ? find_checkerboard(search, board) : find_charuco(search, board);
  constexpr std::size_t kLeastCorners = 6;
  if (found.px.size() < kLeastCorners)
    return not_found(
        is_checkerboard
            ? "no " + to_string(board) +
                  " is seen whole (counts are of squares, not of inner corners); hold all of it in "
                  "the picture, with a white border, evenly lit and sharp"
            : std::to_string(found.px.size()) + " corners of the " + to_string(board) +
                  " are seen; expected 6 or more of OpenCV's DICT_5X5_250, sharp and evenly lit");
  for (cv::Point2f& px : found.px) px = search.to_full(px);
  if (is_checkerboard) refine_roughly(picture, found.px);
  return refine(grey, board, found);
}

std::optional<int> whole(std::string_view text) {
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  if (value < kLeastSquares || value > kMostSquares) return std::nullopt;
  return value;
}

}  // namespace

Result<Board> parse_board(std::string_view kind, std::string_view counts, double square_mm) {
  Board board;
  board.square_mm = square_mm;
  std::string problems;
  const auto add = [&problems](const std::string& problem) {
    problems += (problems.empty() ? "" : "; ") + problem;
  };
  if (kind == "charuco")
    board.kind = BoardKind::kCharuco;
  else if (kind != "checkerboard")
    add("a board is a checkerboard or charuco, not \"" + std::string(kind) + "\"");
  const std::size_t cross = counts.find('x');
  const auto rows = whole(counts.substr(0, cross));
  const auto cols =
      cross == std::string_view::npos ? std::nullopt : whole(counts.substr(cross + 1));
  if (rows && cols) {
    board.row_count = *rows;
    board.col_count = *cols;
  } else {
    add("the squares are \"" + std::string(counts) + "\"; expected ROWSxCOLS, 3 to 100 each");
  }
  if (!(square_mm > 0) || !std::isfinite(square_mm)) add("a square's edge must be above 0 mm");
  constexpr int kDictionarySize = 250;
  if (board.kind == BoardKind::kCharuco && board.row_count * board.col_count / 2 > kDictionarySize)
    add("a charuco board has at most 500 squares");
  if (!problems.empty())
    return tl::unexpected(InputError{InputFault::kInvalid, "", "board", problems});
  return board;
}

std::string to_string(const Board& board) {
  char text[96];
  std::snprintf(text, sizeof text, "%s of %d x %d squares of %g mm",
                board.kind == BoardKind::kCharuco ? "ChArUco board" : "checkerboard",
                board.row_count, board.col_count, board.square_mm);
  return text;
}

Image<float> grey_picture(ImageView<const float> signal, ColorFilter filter) {
  Image<float> grey(signal.height_px, signal.width_px);
  for (int row = 0; row < signal.height_px; ++row)
    for (int col = 0; col < signal.width_px; ++col)
      for (int channel = 0; channel < signal.channel_count; ++channel)
        grey.at(row, col) += signal.at(row, col, channel);
  if (filter == ColorFilter::kMono || filter == ColorFilter::kRgb) return grey;
  std::array<double, 4> level{};
  for (std::size_t site = 0; site < 4; ++site) {
    std::vector<float> values;
    for (int row = static_cast<int>(site / 2); row < grey.height_px(); row += 2)
      for (int col = static_cast<int>(site % 2); col < grey.width_px(); col += 2)
        if (std::isfinite(grey.at(row, col))) values.push_back(grey.at(row, col));
    // The bright half of a grey subject is paper under the projector's light, at every site.
    level[site] = quantile(std::move(values), 0.9);
  }
  for (int row = 0; row < grey.height_px(); ++row)
    for (int col = 0; col < grey.width_px(); ++col) {
      const double own = level[static_cast<std::size_t>(2 * (row % 2) + col % 2)];
      if (own > 0) grey.at(row, col) *= static_cast<float>(level[1] / own);
    }
  return grey;
}

Result<std::vector<DetectedCorner>> detect_board(ImageView<const float> grey, const Board& board) {
  try {
    return detect(grey, board);
  } catch (const cv::Exception& error) {
    return not_found("no " + to_string(board) + " can be found (" + error.err + ")");
  }
}

}  // namespace estimation
