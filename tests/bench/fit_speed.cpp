#include "tests/bench/fit_speed.h"

#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_reduce.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <functional>
#include <memory>
#include <optional>

#include "estimation/profile/gather_samples.h"
#include "estimation/profile/likelihood.h"
#include "estimation/radiometry/merge.h"
#include "estimation/radiometry/noise.h"
#include "tests/bench/fit_speed_scene.h"

namespace bench {
namespace {

using namespace estimation;

constexpr std::size_t kTile = 1024;
// As the estimator has them: rows a power of two apart would share a few places of the cache.
constexpr std::size_t kStride = kTile + 16;

double seconds_of(const std::function<void()>& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// All frames once, added up as words of eight bytes: no computation that memory would wait for.
std::uint64_t bare_read(const SpeedScene& scene) {
  constexpr std::size_t kParts = 8;
  const std::size_t part_count = scene.frames.size() * kParts;
  return tbb::parallel_reduce(
      tbb::blocked_range<std::size_t>(0, part_count), std::uint64_t{0},
      [&](const auto& parts, std::uint64_t sum) {
        for (std::size_t part = parts.begin(); part < parts.end(); ++part) {
          const auto samples = scene.frames[part / kParts].samples();
          const std::size_t words = samples.size() / 4 / kParts;
          const auto* word =
              reinterpret_cast<const std::uint64_t*>(samples.data()) + (part % kParts) * words;
          for (std::size_t i = 0; i < words; ++i) sum += word[i];
        }
        return sum;
      },
      std::plus<>());
}

void merge_all(const SpeedScene& scene, std::vector<Image<float>>& merged) {
  const CameraBlack black(kSpeedBlackDn);
  for (std::size_t i = 0; i < merged.size(); ++i) {
    const std::array<ExposedFrame, 2> bracket = {
        {{kSpeedExposuresUs[0], scene.frames[2 * i].view()},
         {kSpeedExposuresUs[1], scene.frames[2 * i + 1].view()}}};
    merge_brackets_into(bracket, black, kSpeedSaturationDn, {}, merged[i].view());
  }
}

// What becomes of a band's pixels: estimates with their standard deviations.
struct BandResult {
  std::vector<std::array<float, kUnknowns>> estimate, sd;  // t, ln l_d, B, phase
  std::vector<float> reduced_chi_square;
  std::vector<std::uint32_t> validity;

  explicit BandResult(std::size_t count)
      : estimate(count), sd(count), reduced_chi_square(count), validity(count) {}
};

// One thread's tile.
struct Tile {
  std::vector<float> samples, position_px, full_signal;
  BatchFit fit;
  double gather_s = 0, fit_s = 0;

  explicit Tile(std::size_t shift_count)
      : samples(shift_count * kStride), position_px(kStride), full_signal(kStride) {
    fit.resize(kStride);
  }
};

void keep(const BatchFit& fit, std::size_t count, std::size_t first, BandResult& result) {
  for (std::size_t i = 0; i < count; ++i) {
    result.estimate[first + i] = {fit.logit_reflectance[i], fit.log_translucency_px[i],
                                  fit.indirect[i], fit.phase_px[i]};
    for (std::size_t k = 0; k < kUnknowns; ++k)
      result.sd[first + i][k] = std::sqrt(fit.covariance[covariance_index(k, k) * fit.stride + i]);
    result.reduced_chi_square[first + i] = fit.reduced_chi_square[i];
    result.validity[first + i] = fit.validity[i];
  }
}

class BandWork {
 public:
  BandWork(const SpeedScene& scene, const SpeedOptions& options, int band)
      : scene_(scene),
        band_(scene.bands[static_cast<std::size_t>(band)]),
        result_(band_.elements.size()) {
    const int count = scene.harmonic_count(band_, options.is_table_wide, options.harmonic_count);
    table_.emplace(*scene.model, scene.shape, scene.range(band_, options.is_table_wide), count);
    problem_ = {.shape = scene.shape,
                .shifts_px = scene.shifts_px,
                .noise = scene.noise,
                .projector_black_frac = kSpeedProjectorBlack,
                .model = scene.model.get(),
                .table = &*table_,
                .harmonic_count = options.harmonic_count,
                .indirect = options.is_indirect_free ? IndirectLight::kFree : IndirectLight::kZero};
    for (int n = 0; n <= count; ++n) {
      factor_re_.push_back(static_cast<float>(scene.contrast(n)));
      factor_im_.push_back(0.0F);
    }
    factor_count_ = count + 1;
    fitter_.emplace(problem_);
  }

  std::size_t tile_count() const { return (band_.elements.size() + kTile - 1) / kTile; }

  void fit_tile(std::span<const ImageView<const float>> merged, std::size_t index, Tile& tile) {
    const std::size_t first = index * kTile;
    const std::size_t count = std::min(kTile, band_.elements.size() - first);
    const auto elements = std::span(band_.elements).subspan(first, count);
    tile.gather_s += seconds_of([&] {
      gather_samples(merged, elements, kStride, tile.samples);
      for (std::size_t i = 0; i < count; ++i) {
        tile.position_px[i] = scene_.position_px(elements[i]);
        tile.full_signal[i] = scene_.full_signal(elements[i]);
      }
    });
    tile.fit_s += seconds_of([&] {
      const PixelBatch batch{.count = count,
                             .stride = kStride,
                             .samples = tile.samples,
                             .position_px = tile.position_px,
                             .full_signal = tile.full_signal,
                             .factor_re = factor_re_,
                             .factor_im = factor_im_,
                             .factor_count = factor_count_,
                             .offset_px = {}};
      fitter_->fit(batch, tile.fit);
      keep(tile.fit, count, first, result_);
    });
  }

  const SpeedBand& band() const { return band_; }
  const BandResult& result() const { return result_; }

 private:
  const SpeedScene& scene_;
  const SpeedBand& band_;
  std::optional<HarmonicTable> table_;
  FitProblem problem_;
  std::vector<float> factor_re_, factor_im_;
  int factor_count_ = 0;
  std::optional<BatchFitter> fitter_;
  BandResult result_;
};

struct TileTimes {
  double gather_s = 0, fit_s = 0;  // of all threads together
};

TileTimes fit_all(std::span<const Image<float>> merged,
                  std::span<const std::unique_ptr<BandWork>> bands) {
  std::vector<ImageView<const float>> views;
  for (const Image<float>& image : merged) views.push_back(image.view());
  tbb::enumerable_thread_specific<Tile> tiles([&] { return Tile(views.size()); });
  for (const auto& band : bands)
    tbb::parallel_for(std::size_t{0}, band->tile_count(),
                      [&](std::size_t index) { band->fit_tile(views, index, tiles.local()); });
  TileTimes times;
  for (const Tile& tile : tiles) times.gather_s += tile.gather_s, times.fit_s += tile.fit_s;
  return times;
}

std::size_t memory_kib(const std::string& entry) {
  std::ifstream stream("/proc/self/status");
  for (std::string line; std::getline(stream, line);)
    if (line.starts_with(entry)) return std::stoul(line.substr(entry.size() + 1));
  return 0;
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

struct Times {
  std::vector<double> read_s, merge_s, gather_s, fit_s;

  SpeedStage stage(const std::string& name, const std::function<double(std::size_t)>& at) const {
    std::vector<double> milliseconds, reads;
    for (std::size_t i = 0; i < read_s.size(); ++i) {
      milliseconds.push_back(1e3 * at(i));
      reads.push_back(at(i) / read_s[i]);
    }
    return {name, median(milliseconds), median(reads)};
  }
};

void judge(const SpeedScene& scene, std::span<const std::unique_ptr<BandWork>> bands,
           SpeedReport& report) {
  double squares = 0;
  std::size_t valid = 0;
  for (const auto& owned : bands) {
    const BandWork& work = *owned;
    report.pixel_count += work.band().elements.size();
    for (std::size_t i = 0; i < work.band().elements.size(); ++i) {
      if (work.result().validity[i] != 0) continue;
      ++valid;
      const double error = static_cast<double>(work.result().estimate[i][1]) -
                           scene.truth(work.band(), work.band().elements[i]).log_translucency_px;
      squares += std::pow(error / static_cast<double>(work.result().sd[i][1]), 2);
    }
  }
  report.invalid_frac = 1 - static_cast<double>(valid) / static_cast<double>(report.pixel_count);
  report.log_translucency_pull = std::sqrt(squares / static_cast<double>(valid));
}

}  // namespace

SpeedReport speed_report(const SpeedOptions& options) {
  const SpeedScene scene(options);
  SpeedReport report;
  for (const auto& frame : scene.frames) report.frame_bytes += frame.samples().size_bytes();
  std::ofstream("/proc/self/clear_refs") << "5";  // the peak counts from here
  std::vector<Image<float>> merged;
  for (std::size_t i = 0; i < scene.frames.size() / 2; ++i)
    merged.emplace_back(options.height_px, options.width_px);
  std::vector<std::unique_ptr<BandWork>> bands;
  double prepare_s = 0;
  for (int band = 0; band < 3; ++band)
    prepare_s +=
        seconds_of([&] { bands.push_back(std::make_unique<BandWork>(scene, options, band)); });

  Times times;
  std::uint64_t sum = 0;
  const double threads = static_cast<double>(
      tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism));
  for (int repetition = 0; repetition <= options.repetitions; ++repetition) {
    const double read_s = seconds_of([&] { sum += bare_read(scene); });
    const double merge_s = seconds_of([&] { merge_all(scene, merged); });
    TileTimes tile_times;
    const double tiles_s = seconds_of([&] { tile_times = fit_all(merged, bands); });
    if (repetition == 0) continue;  // warms up
    times.read_s.push_back(read_s);
    times.merge_s.push_back(merge_s);
    const double gather_share = tile_times.gather_s / (tile_times.gather_s + tile_times.fit_s);
    times.gather_s.push_back(tiles_s * gather_share);
    times.fit_s.push_back(tiles_s * (1 - gather_share));
  }
  report.peak_beyond_frames_bytes =
      1024 * memory_kib("VmHWM:") - std::min(1024 * memory_kib("VmHWM:"), report.frame_bytes);
  report.stages = {
      times.stage("bare read", [&](std::size_t i) { return times.read_s[i]; }),
      times.stage("merge", [&](std::size_t i) { return times.merge_s[i]; }),
      times.stage("gather", [&](std::size_t i) { return times.gather_s[i]; }),
      times.stage("fit and uncertainty", [&](std::size_t i) { return times.fit_s[i]; }),
      times.stage("all but the read", [&](std::size_t i) {
        return times.merge_s[i] + times.gather_s[i] + times.fit_s[i];
      })};
  report.prepare_ms = 1e3 * prepare_s;
  report.thread_count = static_cast<int>(threads);
  judge(scene, bands, report);
  if (sum == 0) report.frame_bytes = 0;  // the read must not be optimised away
  return report;
}

std::string to_text(const SpeedReport& report) {
  std::string text = "| stage | ms | bare reads | ns a pixel and thread |\n|---|---|---|---|\n";
  std::array<char, 200> line{};
  for (const SpeedStage& stage : report.stages) {
    std::snprintf(
        line.data(), line.size(), "| %s | %.1f | %.2f | %.0f |\n", stage.name.c_str(),
        stage.milliseconds, stage.bare_reads,
        stage.milliseconds * 1e6 * report.thread_count / static_cast<double>(report.pixel_count));
    text.append(line.data());
  }
  std::snprintf(
      line.data(), line.size(),
      "\n%zu pixels, %.2f%% of them invalid, pull of ln l_d %.3f; tables %.0f ms beforehand; "
      "frames %.0f MB, peak beyond them %.0f MB\n",
      report.pixel_count, 100 * report.invalid_frac, report.log_translucency_pull,
      report.prepare_ms, static_cast<double>(report.frame_bytes) / 1e6,
      static_cast<double>(report.peak_beyond_frames_bytes) / 1e6);
  return text.append(line.data());
}

}  // namespace bench
