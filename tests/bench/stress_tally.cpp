#include "tests/bench/stress_tally.h"

#include <oneapi/tbb/combinable.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>

#include "estimation/session/maps.h"

namespace bench {
namespace {

using estimation::BatchFit;
using estimation::covariance_index;
using estimation::kUnknowns;

constexpr std::uint64_t kBatchesBetweenReports = 4400;  // 4.5 million pixels

// FNV-1a over words.
std::uint64_t mixed(std::uint64_t hash, std::uint32_t word) {
  return (hash ^ word) * 0x100000001b3U;
}

void count_pixel(const BatchFit& fit, std::size_t i, bool is_indirect_free, std::uint64_t& hash,
                 StressTally& tally) {
  ++tally.pixels;
  hash = mixed(hash, fit.validity[i]);
  if (const std::uint32_t reason = fit.validity[i] & estimation::kValidityErrors) {
    tally.saturated += (reason & estimation::kSaturated) != 0;
    tally.too_dark += (reason & estimation::kTooDark) != 0;
    tally.outside += (reason & estimation::kOutsideModel) != 0;
    tally.not_identifiable += (reason & estimation::kNotIdentifiable) != 0;
    return;
  }
  ++tally.valid;
  bool is_finite = true;
  for (const float value : {fit.logit_reflectance[i], fit.log_translucency_px[i], fit.indirect[i],
                            fit.phase_px[i], fit.reduced_chi_square[i]}) {
    is_finite = is_finite && std::isfinite(value);
    hash = mixed(hash, std::bit_cast<std::uint32_t>(value));
  }
  for (std::size_t k = 0; k < kUnknowns * (kUnknowns + 1) / 2; ++k) {
    const float value = fit.covariance[k * fit.stride + i];
    is_finite = is_finite && std::isfinite(value);
    hash = mixed(hash, std::bit_cast<std::uint32_t>(value));
  }
  tally.not_finite += !is_finite;
  bool is_positive = true;
  for (std::size_t unknown = 0; unknown < kUnknowns; ++unknown) {
    const float variance = fit.covariance[covariance_index(unknown, unknown) * fit.stride + i];
    is_positive = is_positive && (variance > 0 || (unknown == 2 && !is_indirect_free));
  }
  tally.negative_sigma += !is_positive;
}

// Whole or not at all: the old file stays until the new one is complete.
void write(const StressCount& count, const std::filesystem::path& file) {
  const std::filesystem::path fresh = std::filesystem::path(file).concat(".new");
  const StressTally& t = count.tally;
  {
    std::ofstream stream(fresh);
    stream << count.batch_count << ' ' << count.seconds;
    for (const std::uint64_t number :
         {t.pixels, t.valid, t.not_finite, t.negative_sigma, t.saturated, t.too_dark, t.outside,
          t.not_identifiable, t.bits})
      stream << ' ' << number;
    stream << '\n';
    if (!stream.flush()) return;
  }
  std::error_code ignored;  // the next one is four million pixels away
  std::filesystem::rename(fresh, file, ignored);
}

StressCount read(const std::filesystem::path& file) {
  std::ifstream stream(file);
  StressCount count;
  StressTally& t = count.tally;
  stream >> count.batch_count >> count.seconds;
  for (std::uint64_t* number : {&t.pixels, &t.valid, &t.not_finite, &t.negative_sigma, &t.saturated,
                                &t.too_dark, &t.outside, &t.not_identifiable, &t.bits})
    stream >> *number;
  return stream ? count : StressCount{};
}

void print(const StressCount& count, std::uint64_t batch_count) {
  const double done = static_cast<double>(count.batch_count) / static_cast<double>(batch_count);
  std::fprintf(stderr,
               "stress: %.1f of %.1f million pixels, %.0f s, some %.0f s to go; %llu valid, not "
               "finite %llu, sigma not positive %llu\n",
               1e-6 * static_cast<double>(count.tally.pixels),
               1e-6 * static_cast<double>(batch_count * StressPixels::kCount), count.seconds,
               count.seconds * (1 / done - 1), static_cast<unsigned long long>(count.tally.valid),
               static_cast<unsigned long long>(count.tally.not_finite),
               static_cast<unsigned long long>(count.tally.negative_sigma));
}

}  // namespace

StressTally StressTally::operator+(const StressTally& other) const {
  return {.pixels = pixels + other.pixels,
          .valid = valid + other.valid,
          .not_finite = not_finite + other.not_finite,
          .negative_sigma = negative_sigma + other.negative_sigma,
          .saturated = saturated + other.saturated,
          .too_dark = too_dark + other.too_dark,
          .outside = outside + other.outside,
          .not_identifiable = not_identifiable + other.not_identifiable,
          .bits = bits + other.bits};
}

StressTally stress(const StressPixels& pixels, std::uint64_t first, std::uint64_t last) {
  struct Local {
    StressPixels::Buffers buffers;
    BatchFit fit;
    StressTally tally;
  };
  tbb::combinable<Local> locals;
  tbb::parallel_for(first, last, [&](std::uint64_t batch) {
    Local& local = locals.local();
    pixels.fitter(batch).fit(pixels.make(batch, local.buffers), local.fit);
    const bool is_free = pixels.sweep(batch).indirect == estimation::IndirectLight::kFree;
    std::uint64_t hash = 0xcbf29ce484222325U ^ batch;
    for (std::size_t i = 0; i < StressPixels::kCount; ++i)
      count_pixel(local.fit, i, is_free, hash, local.tally);
    local.tally.bits += hash;
  });
  StressTally total;
  locals.combine_each([&](const Local& local) { total = total + local.tally; });
  return total;
}

StressCount stress_with_progress(const StressPixels& pixels, std::uint64_t batch_count,
                                 const std::filesystem::path& file) {
  StressCount count = read(file);
  if (count.batch_count > batch_count) count = {};
  while (count.batch_count < batch_count) {
    const auto start = std::chrono::steady_clock::now();
    const std::uint64_t last = std::min(batch_count, count.batch_count + kBatchesBetweenReports);
    count.tally = count.tally + stress(pixels, count.batch_count, last);
    count.batch_count = last;
    count.seconds +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    write(count, file);
    print(count, batch_count);
  }
  std::error_code ignored;  // then the next run starts with this count, and says so
  std::filesystem::remove(file, ignored);
  return count;
}

}  // namespace bench
