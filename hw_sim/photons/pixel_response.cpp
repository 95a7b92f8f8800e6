#include "hw_sim/photons/pixel_response.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <mutex>

namespace hw_sim {

using estimation::Vec3;

namespace {

// Facets lie up to 0.05 mm off the smooth surface (surface.h).
constexpr double kClearMm = 0.1;
constexpr int kMostBounces = 8;  // a bounce keeps at most R_d: 0.6^8 is 2% of what is indirect

// One pixel's sums.
class Gatherer {
 public:
  Gatherer(const Surface& surface, const ShapeGrid& shape, const Illumination& light,
           bool has_indirect)
      : surface_(surface), shape_(shape), light_(light), has_indirect_(has_indirect) {}

  void add_path(const AdjointWalk& walk, PathStart start, PhotonRandom& random,
                std::span<double> by_column) {
    for (int bounce = 0; bounce <= kMostBounces; ++bounce) {
      deposits_.clear();
      const PathEnd end = walk.trace(start, random, deposits_);
      for (const Deposit& deposit : deposits_) add(deposit, by_column);
      if (!has_indirect_ || end.weight == 0) return;
      const auto again = met_again(end);
      if (!again) return;
      start = *again;
    }
  }

 private:
  void add(const Deposit& deposit, std::span<double> by_column) const {
    const ProjectedPoint at = light_.projector.project(deposit.entry_mm);
    const double col = std::floor(at.col_px + 0.5), row = std::floor(at.row_px + 0.5);
    if (!at.is_in_front || !(row >= 0 && row < light_.height_px) ||
        !(col >= 0 && col < light_.width_px) ||
        !surface_.is_seen_from(light_.projector.center_mm(), deposit.entry_mm, deposit.normal))
      return;
    by_column[static_cast<std::size_t>(col)] += deposit.weight;
  }

  std::optional<PathStart> met_again(const PathEnd& end) const {
    const Vec3 clear = end.point_mm + kClearMm * shape_.normal(end.point_mm);
    const std::optional<Hit> hit = surface_.first_hit({clear, end.way});
    if (!hit) return std::nullopt;
    auto start = entering(shape_, hit->point_mm, end.way);
    if (start) start->weight *= end.weight;
    return start;
  }

  const Surface& surface_;
  const ShapeGrid& shape_;
  const Illumination& light_;
  bool has_indirect_;
  std::vector<Deposit> deposits_;
};

}  // namespace

ColumnResponse::ColumnResponse(std::span<const double> sums, double paths_per_batch) {
  const std::size_t width = sums.size() / kBatches;
  const auto is_lit = [&](std::size_t column) {
    for (std::size_t batch = 0; batch < kBatches; ++batch)
      if (sums[batch * width + column] != 0) return true;
    return false;
  };
  std::size_t first = 0, last = width;
  while (first < last && !is_lit(first)) ++first;
  while (last > first && !is_lit(last - 1)) --last;
  begin_ = static_cast<int>(first);
  count_ = static_cast<int>(last - first);
  by_batch_.reserve(kBatches * (last - first));
  for (std::size_t batch = 0; batch < kBatches; ++batch)
    for (std::size_t column = first; column < last; ++column)
      by_batch_.push_back(static_cast<float>(sums[batch * width + column] / paths_per_batch));
}

double ColumnResponse::at(int column) const {
  if (column < begin() || column >= end()) return 0;
  double sum = 0;
  for (std::size_t batch = 0; batch < kBatches; ++batch)
    sum += static_cast<double>(by_batch_[batch * static_cast<std::size_t>(count_) +
                                         static_cast<std::size_t>(column - begin_)]);
  return sum / kBatches;
}

double ColumnResponse::lit_by(std::span<const double> brightness, std::size_t batch) const {
  const auto count = static_cast<std::size_t>(count_);
  double sum = 0;
  for (std::size_t i = 0; i < count; ++i)
    sum += brightness[static_cast<std::size_t>(begin_) + i] *
           static_cast<double>(by_batch_[batch * count + i]);
  return sum;
}

Estimate ColumnResponse::lit_by(std::span<const double> brightness) const {
  std::array<double, kBatches> batches{};
  for (std::size_t batch = 0; batch < kBatches; ++batch) batches[batch] = lit_by(brightness, batch);
  return estimate_of(batches);
}

Estimate estimate_of(std::span<const double> batches) {
  const auto count = static_cast<double>(batches.size());
  double mean = 0, squares = 0;
  for (const double batch : batches) mean += batch / count;
  for (const double batch : batches) squares += (batch - mean) * (batch - mean);
  return {mean, std::sqrt(squares / (count - 1) / count)};
}

std::vector<ColumnResponse> trace_window(const SeenPoints& seen, const Surface& surface,
                                         const ShapeGrid& shape,
                                         const std::array<const Matter*, 3>& matter_of_band,
                                         const Illumination& illumination,
                                         const PhotonOptions& options,
                                         const std::function<void(double)>& progress) {
  constexpr std::size_t kBatches = ColumnResponse::kBatches;
  const int per_batch =
      (options.paths_per_sample + static_cast<int>(kBatches) - 1) / static_cast<int>(kBatches);
  const Lamp lamp{illumination.projector.center_mm(),
                  illumination.reference_distance_mm * illumination.reference_distance_mm};
  const auto width = static_cast<std::size_t>(illumination.width_px);
  std::vector<ColumnResponse> responses(seen.samples.size());
  std::mutex progress_mutex;
  std::size_t done_count = 0;  // guarded by progress_mutex
  tbb::parallel_for(std::size_t{0}, seen.samples.size(), [&](std::size_t i) {
    const AdjointWalk walk(shape, *matter_of_band[seen.bands[i]], lamp);
    const Vec3& point = seen.points[static_cast<std::size_t>(seen.owners[i])].point_mm;
    Gatherer gatherer(surface, shape, illumination, options.has_indirect);
    std::vector<double> sums(kBatches * width, 0.0);
    const auto start = seen_path(shape, point, -point / cv::norm(point));
    // A stream of random numbers for each batch of each sample: threads change nothing.
    const auto stream = static_cast<std::uint64_t>(seen.samples[i].sample) * kBatches;
    for (std::size_t batch = 0; start && batch < kBatches; ++batch) {
      PhotonRandom random((options.seed << 40) + stream + batch);
      const auto by_column = std::span(sums).subspan(batch * width, width);
      for (int path = 0; path < per_batch; ++path)
        gatherer.add_path(walk, *start, random, by_column);
    }
    responses[i] = ColumnResponse(sums, per_batch);
    const std::lock_guard lock(progress_mutex);
    ++done_count;
    if (progress)
      progress(static_cast<double>(done_count) / static_cast<double>(seen.samples.size()));
  });
  return responses;
}

}  // namespace hw_sim
