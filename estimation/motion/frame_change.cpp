#include "estimation/motion/frame_change.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <optional>
#include <string>

#include "estimation/motion/block_change.h"
#include "estimation/motion/picture.h"
#include "estimation/motion/picture_fit.h"

namespace estimation {
namespace {

constexpr int kBlocksAcross = 24, kSmallestBlock = 8;
// An eye is smaller than what a shift can be told from.
constexpr int kPlacesAcross = 48, kSmallestPlace = 4;

// Standard deviations of the whole by leaving out one block at a time: that needs no assumption
// about how errors of neighbours hang together within a block. nullopt: there are too few.
std::optional<cv::Vec4d> jackknife_sd(const std::vector<AlignmentSums>& sums,
                                      const AlignmentSums& all) {
  std::vector<cv::Vec4d> answers;
  for (const AlignmentSums& block : sums) {
    if (block.cell_count == 0) continue;
    if (const auto without = (all - block).solution()) answers.push_back(*without);
  }
  constexpr std::size_t kFewestAnswers = 3;
  if (answers.size() < kFewestAnswers) return std::nullopt;
  cv::Vec4d mean{0, 0, 0, 0}, squares{0, 0, 0, 0}, sd{0, 0, 0, 0};
  const auto count = static_cast<double>(answers.size());
  for (const cv::Vec4d& answer : answers) mean += answer * (1 / count);
  for (const cv::Vec4d& answer : answers)
    for (int i = 0; i < 4; ++i) squares[i] += (answer[i] - mean[i]) * (answer[i] - mean[i]);
  for (int i = 0; i < 4; ++i) sd[i] = std::sqrt(squares[i] * (count - 1) / count);
  return sd;
}

tl::unexpected<InputError> cannot_compare(const std::string& why) {
  return tl::unexpected(InputError{InputFault::kInsufficient, "", "", why});
}

// The best of the starts: where the picture was, and where phase correlation sees it.
std::optional<Alignment> align(const CameraInfo& camera, const Picture& first,
                               const Picture& second, const PictureBlocks& blocks, PictureFit& fine,
                               double period_px) {
  const CellShift coarse =
      coarse_shift(smoothed(first.light, kFineSmoothing), smoothed(second.light, kFineSmoothing));
  std::vector<CellShift> starts{{0, 0}};
  if (coarse.row != 0 || coarse.col != 0) starts.push_back(coarse);
  std::optional<Alignment> best;
  double best_frac = 0;
  for (const CellShift& start : starts) {
    Alignment at{start.row, start.col, 1, 0};
    PictureFit rough(camera, first, second, blocks, kCoarseSmoothing, period_px);
    constexpr int kRoughSteps = 6, kFineSteps = 12;
    if (!rough.descend(at, kRoughSteps)) at = {start.row, start.col, 1, 0};
    if (!fine.descend(at, kFineSteps)) continue;
    const double frac = fine.unexplained_frac(at);
    if (best && frac >= best_frac) continue;
    best = at;
    best_frac = frac;
  }
  return best;
}

}  // namespace

Result<FrameChange> measure_change(const CameraInfo& camera, double period_px,
                                   ImageView<const std::uint16_t> first,
                                   ImageView<const std::uint16_t> second) {
  for (const auto& frame : {first, second}) {
    if (frame.height_px != camera.height_px || frame.width_px != camera.width_px ||
        frame.channel_count != sample_channel_count(camera.pixel_format.filter))
      return tl::unexpected(InputError{InputFault::kInvalid, "", "",
                                       "a frame to compare is not of the camera's size"});
  }
  const Picture before = make_picture(camera, first), after = make_picture(camera, second);
  constexpr int kShortestSide =
      2 * kFitMargin + kSmallestPlace;  // cells: less, and none is compared
  if (std::min(before.light.height_px(), before.light.width_px()) < kShortestSide)
    return cannot_compare("the picture is too small to compare it");
  const PictureBlocks blocks = find_lit_blocks(before, kBlocksAcross, kSmallestBlock);
  PictureFit fit(camera, before, after, blocks, kFineSmoothing, period_px);
  constexpr int kFewestCells = 200;
  if (fit.cell_count() < kFewestCells)
    return cannot_compare("too little of the picture is lit and not clipped to compare it");
  const auto found = align(camera, before, after, blocks, fit, period_px);
  // Half of the variation unexplained: what is left is no picture of the same thing.
  constexpr double kMostUnexplainedFrac = 0.5;
  const double unexplained_frac = found ? fit.unexplained_frac(*found) : 1;
  if (!found || unexplained_frac > kMostUnexplainedFrac)
    return cannot_compare("no shift makes the two showings alike: they do not show the same");

  const auto sums = fit.normal_equations(*found);
  AlignmentSums all;
  for (const AlignmentSums& block : sums) all += block;
  const auto sd = jackknife_sd(sums, all);
  if (!sd) return cannot_compare("too little of the picture is lit and not clipped to compare it");
  const auto changes = block_changes(fit.normal_equations(*found, Outliers::kCounted), *found);

  FrameChange change;
  change.lit_frac =
      fit.cell_count() / static_cast<double>(before.light.height_px() * before.light.width_px());
  change.shift_row_px = found->row * before.bin_px;
  change.shift_col_px = found->col * before.bin_px;
  change.shift_row_sd_px = (*sd)[0] * before.bin_px;
  change.shift_col_sd_px = (*sd)[1] * before.bin_px;
  change.local_shift_px = rms_shift_cells(changes) * before.bin_px;
  change.light_frac = found->gain - 1;
  change.light_sd_frac = (*sd)[2];
  change.ambient_frac = found->ambient;
  change.ambient_sd_frac = (*sd)[3];
  change.residual_frac = unexplained_frac;
  const PictureBlocks places = find_lit_blocks(before, kPlacesAcross, kSmallestPlace);
  PictureFit at_places(camera, before, after, places, kFineSmoothing, period_px);
  change.local_changes = find_local_changes(
      block_changes(at_places.normal_equations(*found, Outliers::kCounted), *found), places,
      before.bin_px);
  return change;
}

}  // namespace estimation
