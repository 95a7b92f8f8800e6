#include "hw_sim/world/transport.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <istream>
#include <mutex>
#include <ostream>
#include <utility>

#include "hw_sim/world/scatter_table.h"
#include "hw_sim/world/surroundings.h"

namespace hw_sim {

namespace {

// Lattice spacing, in units of the kernel's depth z_r, from which the finer lattice is used: its
// aliases are exp(-2 pi / 0.8) of the kernel, 4e-4.
constexpr double kCoarseSpacing = 0.8;
constexpr std::size_t kChunk = 512;  // samples a task

std::size_t to_size(int value) { return static_cast<std::size_t>(value); }

using Rect = SplitPicture::Rect;

bool needs_fine(const SeenSample& sample, const Pinhole& projector) {
  const double distance_mm = cv::norm(point_of(sample) - projector.center_mm());
  const double cosine = std::max(0.05, static_cast<double>(sample.cos_projector));
  const Scattering& s = sample.scattering;
  const double depth_mm = 1 / (s.sigma_a_per_mm + s.sigma_s_prime_per_mm);
  return distance_mm / projector.focal_px() / cosine > kCoarseSpacing * depth_mm;
}

// What a sum over lattice points says about whole pixels: the square filter, then pixels.
std::vector<float> to_pixels(const std::vector<float>& points, int margin, int per_px) {
  std::vector<float> pixels((points.size() - 2 * to_size(margin)) / to_size(per_px), 0.0F);
  for (std::size_t px = 0; px < pixels.size(); ++px)
    for (std::size_t k = 0; k < to_size(per_px); ++k) {
      const std::size_t center = px * to_size(per_px) + k + to_size(margin);
      for (std::size_t tap = 0; tap < 5; ++tap)
        pixels[px] += kSquareTaps[tap] * points[center + tap - 2];
    }
  return pixels;
}

// Adds `weight`, spread evenly over `extent` px around `center_px`, to the pixels from `first` on.
void spread(double center_px, double extent, double weight, int first, std::vector<float>& pixels) {
  const double begin = center_px - extent / 2 + 0.5 - first, end = begin + extent;
  const int last = static_cast<int>(pixels.size()) - 1;
  for (int px = std::max(0, static_cast<int>(std::floor(begin)));
       px <= std::min(last, static_cast<int>(std::floor(end))); ++px) {
    const double covered = std::min(end, px + 1.0) - std::max(begin, static_cast<double>(px));
    if (covered > 0) pixels[to_size(px)] += static_cast<float>(weight * covered / extent);
  }
}

}  // namespace

// What one task makes for its chunk of samples.
struct Transport::Worker {
  Surroundings surroundings;
  const LightLattice& coarse;
  const LightLattice& fine;  // `coarse` where no sample needs the finer one
  std::vector<std::uint16_t> responses = {};

  Entry measure(const SeenSample& sample) {
    Entry entry;
    surroundings.around(sample, [&](const auto& around) { measure(sample, around, entry); });
    return entry;
  }

  template <typename Around>
  void measure(const SeenSample& sample, const Around& around, Entry& entry) {
    const Disc disc = surroundings.disc_of(sample);
    entry.reach = surroundings.reach_of(disc);
    if (entry.reach.empty()) return;
    entry.is_fine =
        surroundings.table == nullptr && needs_fine(sample, surroundings.light.projector()) ? 1 : 0;
    const LightLattice& lattice = entry.is_fine != 0 ? fine : coarse;
    constexpr int kMargin = 2;  // for the square filter
    const int n = lattice.per_px;
    const Rect& reach = entry.reach;
    std::vector<float> by_col(to_size((reach.col_end - reach.col_begin) * n + 2 * kMargin), 0.0F);
    std::vector<float> by_row(to_size((reach.row_end - reach.row_begin) * n + 2 * kMargin), 0.0F);
    const int first_col = reach.col_begin * n - kMargin, first_row = reach.row_begin * n - kMargin;
    for_each_lit(lattice, disc, reach, kMargin, sample.point_mm, around,
                 [&](int row, int col, std::size_t, float weight) {
                   by_col[to_size(col - first_col)] += weight;
                   by_row[to_size(row - first_row)] += weight;
                 });
    std::vector<float> cols = to_pixels(by_col, kMargin, n), rows = to_pixels(by_row, kMargin, n);
    for (const SkinAround::Patch& patch : around.near_patches()) {
      spread(patch.col_px, patch.col_extent_px, patch.weight, reach.col_begin, cols);
      spread(patch.row_px, patch.row_extent_px, patch.weight, reach.row_begin, rows);
    }
    entry.windows[0] = store(cols, reach.col_begin);
    entry.windows[1] = store(rows, reach.row_begin);
  }

  // 16 bits relative to the largest: steps of 8e-6 of what a whole picture adds. Leading and
  // trailing zeros are left out.
  Window store(const std::vector<float>& pixels, int begin) {
    const float largest = *std::max_element(pixels.begin(), pixels.end());
    Window window;
    window.offset = static_cast<std::int64_t>(responses.size());
    if (largest <= 0) return window;
    window.scale = largest / 65535;
    std::vector<std::uint16_t> steps;
    steps.reserve(pixels.size());
    for (const float value : pixels)
      steps.push_back(static_cast<std::uint16_t>(std::lrint(std::max(value, 0.0F) / window.scale)));
    const auto is_lit = [](std::uint16_t value) { return value > 0; };
    const auto first = std::find_if(steps.begin(), steps.end(), is_lit);
    const auto last = std::find_if(steps.rbegin(), steps.rend(), is_lit).base();
    window.begin = begin + static_cast<int>(first - steps.begin());
    window.count = static_cast<int>(last - first);
    responses.insert(responses.end(), first, last);
    return window;
  }
};

Transport Transport::build(const std::vector<SeenSample>& samples, const ProjectorLight& light,
                           const ScatterTable* table, const Progress& progress) {
  Transport transport;
  transport.table_ = table;
  transport.samples_ = &samples;
  transport.light_ = &light;
  transport.entries_.resize(samples.size());
  const LightLattice& coarse = light.coarse();
  // Decided before the parallel loop: casting light is itself parallel.
  const bool any_fine = table == nullptr &&
                        std::any_of(samples.begin(), samples.end(), [&](const SeenSample& sample) {
                          return needs_fine(sample, light.projector());
                        });
  const LightLattice& fine = any_fine ? light.fine() : coarse;
  const std::size_t chunk_count = (samples.size() + kChunk - 1) / kChunk;
  std::vector<std::vector<std::uint16_t>> chunks(chunk_count);
  std::mutex progress_mutex;
  std::size_t done_count = 0;  // guarded by progress_mutex
  tbb::parallel_for(std::size_t{0}, chunk_count, [&](std::size_t chunk) {
    Worker worker{.surroundings = {.light = light, .table = table}, .coarse = coarse, .fine = fine};
    const std::size_t end = std::min(samples.size(), (chunk + 1) * kChunk);
    for (std::size_t i = chunk * kChunk; i < end; ++i)
      transport.entries_[i] = worker.measure(samples[i]);
    chunks[chunk] = std::move(worker.responses);
    chunks[chunk].shrink_to_fit();
    const std::lock_guard lock(progress_mutex);
    ++done_count;
    if (progress) progress(static_cast<double>(done_count) / static_cast<double>(chunk_count));
  });
  std::size_t total = 0;
  for (const auto& chunk : chunks) total += chunk.size();
  transport.responses_.reserve(total);
  for (std::size_t chunk = 0; chunk < chunk_count; ++chunk) {
    const auto offset = static_cast<std::int64_t>(transport.responses_.size());
    const std::size_t end = std::min(samples.size(), (chunk + 1) * kChunk);
    for (std::size_t i = chunk * kChunk; i < end; ++i)
      for (Window& window : transport.entries_[i].windows) window.offset += offset;
    transport.responses_.insert(transport.responses_.end(), chunks[chunk].begin(),
                                chunks[chunk].end());
    std::vector<std::uint16_t>().swap(chunks[chunk]);
  }
  return transport;
}

void Transport::save(std::ostream& out) const {
  const std::uint64_t sizes[2] = {entries_.size(), responses_.size()};
  out.write(reinterpret_cast<const char*>(sizes), sizeof(sizes));
  out.write(reinterpret_cast<const char*>(entries_.data()),
            static_cast<std::streamsize>(entries_.size() * sizeof(Entry)));
  out.write(reinterpret_cast<const char*>(responses_.data()),
            static_cast<std::streamsize>(responses_.size() * sizeof(std::uint16_t)));
}

bool Transport::load(std::istream& in, const std::vector<SeenSample>& samples,
                     const ProjectorLight& light, const ScatterTable* table) {
  std::uint64_t sizes[2] = {0, 0};
  in.read(reinterpret_cast<char*>(sizes), sizeof(sizes));
  // More than 4096 responses a sample is no transport of ours but a damaged size.
  if (!in || sizes[0] != samples.size() || sizes[1] > 4096 * samples.size()) return false;
  entries_.resize(sizes[0]);
  responses_.resize(sizes[1]);
  in.read(reinterpret_cast<char*>(entries_.data()),
          static_cast<std::streamsize>(entries_.size() * sizeof(Entry)));
  in.read(reinterpret_cast<char*>(responses_.data()),
          static_cast<std::streamsize>(responses_.size() * sizeof(std::uint16_t)));
  samples_ = &samples;
  light_ = &light;
  table_ = table;
  return static_cast<bool>(in);
}

}  // namespace hw_sim
