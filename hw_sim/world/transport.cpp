#include "hw_sim/world/transport.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <istream>
#include <mutex>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <ostream>
#include <utility>

#include "hw_sim/world/scatter_table.h"
#include "hw_sim/world/skin_around.h"

namespace hw_sim {

namespace {

constexpr double kTailFrac = 1e-4;  // of R_d beyond the radius that is summed
// Lattice spacing, in units of the kernel's depth z_r, from which the finer lattice is used: its
// aliases are exp(-2 pi / 0.8) of the kernel, 4e-4.
constexpr double kCoarseSpacing = 0.8;
constexpr std::size_t kChunk = 512;  // samples a task

std::size_t to_size(int value) { return static_cast<std::size_t>(value); }

using estimation::Vec3;
using Rect = SplitPicture::Rect;

Vec3 point_of(const SeenSample& sample) {
  return {static_cast<double>(sample.point_mm[0]), static_cast<double>(sample.point_mm[1]),
          static_cast<double>(sample.point_mm[2])};
}

bool needs_fine(const SeenSample& sample, const Pinhole& projector) {
  const double distance_mm = cv::norm(point_of(sample) - projector.center_mm());
  const double cosine = std::max(0.05, static_cast<double>(sample.cos_projector));
  const Scattering& s = sample.scattering;
  const double depth_mm = 1 / (s.sigma_a_per_mm + s.sigma_s_prime_per_mm);
  return distance_mm / projector.focal_px() / cosine > kCoarseSpacing * depth_mm;
}

// The paper's dipole, smooth enough for the lattice alone.
struct DipoleAround {
  const KernelTable& kernel;
  float radius2_mm2() const { return kernel.radius2_mm2(); }
  float at(float distance2, float, float, float) const { return kernel.at(distance2); }
  static std::vector<SkinAround::Patch> near_patches() { return {}; }
};

// A sphere around a point as the projector sees it, px.
struct Disc {
  double row_px = 0, col_px = 0, radius_px = 0;
};

// The lattice points of `lattice` within `rect` (projector pixels, grown by `margin` points) and
// within the kernel's radius, which `disc` holds: calls use(lattice row, lattice col, index,
// weight).
template <typename Around, typename Use>
void for_each_lit(const LightLattice& lattice, const Disc& disc, const Rect& rect, int margin,
                  const std::array<float, 3>& point, const Around& kernel, const Use& use) {
  const int n = lattice.per_px;
  const int row_begin = std::max(rect.row_begin * n - margin, 0);
  const int row_end = std::min(rect.row_end * n + margin, lattice.height);
  const int col_begin = std::max(rect.col_begin * n - margin, 0);
  const int col_end = std::min(rect.col_end * n + margin, lattice.width);
  const float radius2 = kernel.radius2_mm2();
  for (int row = row_begin; row < row_end; ++row) {
    const std::size_t base = to_size(row) * to_size(lattice.width);
    const double off_px = (row + 0.5) / n - 0.5 - disc.row_px;
    const double half_px =
        std::sqrt(std::max(0.0, disc.radius_px * disc.radius_px - off_px * off_px));
    const int chord_begin = static_cast<int>((disc.col_px - half_px) * n) - 1;
    const int chord_end = static_cast<int>((disc.col_px + half_px + 1) * n) + 1;
    for (int col = std::max(col_begin, chord_begin); col < std::min(col_end, chord_end); ++col) {
      const std::size_t i = base + to_size(col);
      const float dx = lattice.x_mm[i] - point[0];
      const float dy = lattice.y_mm[i] - point[1];
      const float dz = lattice.z_mm[i] - point[2];
      const float distance2 = dx * dx + dy * dy + dz * dz;
      if (distance2 < radius2)
        use(row, col, i, lattice.flux_mm2[i] * kernel.at(distance2, dx, dy, dz));
    }
  }
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

std::uint64_t dot(const std::uint16_t* responses, const unsigned char* line, int count) {
  std::uint64_t total = 0;
  // 65535 * 255 * 256 fits into 32 bits, which the compiler can vectorise.
  for (int begin = 0; begin < count; begin += 256) {
    std::uint32_t sum = 0;
    const int end = std::min(begin + 256, count);
    for (int i = begin; i < end; ++i) sum += static_cast<std::uint32_t>(responses[i]) * line[i];
    total += sum;
  }
  return total;
}

}  // namespace

SplitPicture split_picture(estimation::ImageView<const unsigned char> brightness) {
  const int height = brightness.height_px, width = brightness.width_px;
  const Rect whole{0, height, 0, width};
  // The middle row and column miss a sync square, which sits in a corner.
  SplitPicture columns{SplitPicture::Kind::kColumns, {}, {height, 0, width, 0}};
  SplitPicture rows{SplitPicture::Kind::kRows, {}, {height, 0, width, 0}};
  for (int col = 0; col < width; ++col) columns.line.push_back(brightness.at(height / 2, col));
  for (int row = 0; row < height; ++row) rows.line.push_back(brightness.at(row, width / 2));
  const auto grow = [](Rect& rect, int row, int col) {
    rect.row_begin = std::min(rect.row_begin, row);
    rect.row_end = std::max(rect.row_end, row + 1);
    rect.col_begin = std::min(rect.col_begin, col);
    rect.col_end = std::max(rect.col_end, col + 1);
  };
  for (int row = 0; row < height; ++row)
    for (int col = 0; col < width; ++col) {
      const unsigned char value = brightness.at(row, col);
      if (value != columns.line[to_size(col)]) grow(columns.rest, row, col);
      if (value != rows.line[to_size(row)]) grow(rows.rest, row, col);
    }
  const auto area = [](const Rect& rect) {
    return rect.empty() ? 0.0
                        : static_cast<double>(rect.row_end - rect.row_begin) *
                              static_cast<double>(rect.col_end - rect.col_begin);
  };
  SplitPicture& best = area(columns.rest) <= area(rows.rest) ? columns : rows;
  // A rest as large as a twentieth of the picture is no sync square.
  if (area(best.rest) > 0.05 * area(whole)) return {SplitPicture::Kind::kGeneral, {}, whole};
  if (best.rest.empty()) best.rest = {};
  return best;
}

// What one task makes for its chunk of samples.
struct Transport::Worker {
  const ProjectorLight& light;
  const ScatterTable* table;
  const LightLattice& coarse;
  const LightLattice& fine;  // `coarse` where no sample needs the finer one
  std::vector<std::uint16_t> responses = {};
  // Neighbours mostly share their material: keep its dipole, or of Monte Carlo the latest few, as
  // the bands of a Bayer pattern take turns.
  Scattering scattering = {};
  KernelTable kernel = {};
  static constexpr std::size_t kMaterials = 4;
  std::vector<SkinMaterial> materials = {};
  std::size_t next_material = 0;
  double radius_mm = 0;

  const SkinMaterial& material_of(const Scattering& wanted) {
    const auto found =
        std::find_if(materials.begin(), materials.end(),
                     [&](const SkinMaterial& each) { return each.scattering() == wanted; });
    if (found != materials.end()) return *found;
    if (materials.size() < kMaterials) return materials.emplace_back(table->material(wanted));
    SkinMaterial& oldest = materials[next_material++ % kMaterials];
    oldest = table->material(wanted);
    return oldest;
  }

  // Calls use(around) with what surrounds the sample; sets radius_mm.
  template <typename Use>
  void around(const SeenSample& sample, const Use& use) {
    if (table != nullptr) {
      const SkinAround skin(material_of(sample.scattering), sample, light);
      radius_mm = skin.radius_mm();
      use(skin);
      return;
    }
    if (!(sample.scattering == scattering)) {
      scattering = sample.scattering;
      const Dipole dipole(scattering);
      radius_mm = dipole.radius_with_tail_mm(kTailFrac);
      kernel = KernelTable(dipole, radius_mm);
    }
    use(DipoleAround{kernel});
  }

  // What the projector sees of the sphere of the kernel's radius; one more pixel for the lens's
  // distortion and perspective. Radius 0: behind the projector.
  Disc disc_of(const SeenSample& sample) const {
    const Vec3 point = point_of(sample);
    const ProjectedPoint center = light.projector().project(point);
    if (!center.is_in_front) return {};
    const double distance_mm = cv::norm(point - light.projector().center_mm());
    const double radius_px =
        light.projector().focal_px() * radius_mm / std::max(distance_mm - radius_mm, 1.0) * 1.02 +
        1;
    return {center.row_px, center.col_px, radius_px};
  }

  Rect reach_of(const Disc& disc) const {
    if (disc.radius_px <= 0) return {};
    const auto clamped = [](double value, int limit) {
      return static_cast<int>(std::clamp(value, 0.0, static_cast<double>(limit)));
    };
    return {clamped(std::floor(disc.row_px - disc.radius_px), light.height_px()),
            clamped(std::ceil(disc.row_px + disc.radius_px) + 1, light.height_px()),
            clamped(std::floor(disc.col_px - disc.radius_px), light.width_px()),
            clamped(std::ceil(disc.col_px + disc.radius_px) + 1, light.width_px())};
  }

  Entry measure(const SeenSample& sample) {
    Entry entry;
    around(sample, [&](const auto& surroundings) { measure(sample, surroundings, entry); });
    return entry;
  }

  template <typename Around>
  void measure(const SeenSample& sample, const Around& surroundings, Entry& entry) {
    const Disc disc = disc_of(sample);
    entry.reach = reach_of(disc);
    if (entry.reach.empty()) return;
    entry.is_fine = table == nullptr && needs_fine(sample, light.projector()) ? 1 : 0;
    const LightLattice& lattice = entry.is_fine != 0 ? fine : coarse;
    constexpr int kMargin = 2;  // for the square filter
    const int n = lattice.per_px;
    const Rect& reach = entry.reach;
    std::vector<float> by_col(to_size((reach.col_end - reach.col_begin) * n + 2 * kMargin), 0.0F);
    std::vector<float> by_row(to_size((reach.row_end - reach.row_begin) * n + 2 * kMargin), 0.0F);
    const int first_col = reach.col_begin * n - kMargin, first_row = reach.row_begin * n - kMargin;
    for_each_lit(lattice, disc, reach, kMargin, sample.point_mm, surroundings,
                 [&](int row, int col, std::size_t, float weight) {
                   by_col[to_size(col - first_col)] += weight;
                   by_row[to_size(row - first_row)] += weight;
                 });
    std::vector<float> cols = to_pixels(by_col, kMargin, n), rows = to_pixels(by_row, kMargin, n);
    for (const SkinAround::Patch& patch : surroundings.near_patches()) {
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
    Worker worker{.light = light, .table = table, .coarse = coarse, .fine = fine};
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

std::vector<float> Transport::reflected(estimation::ImageView<const unsigned char> brightness,
                                        const LineOptics& optics) const {
  std::vector<float> reflected(entries_.size(), 0.0F);
  if (entries_.empty()) return reflected;
  const SplitPicture split = split_picture(brightness);
  if (split.kind != SplitPicture::Kind::kGeneral) {
    const std::size_t axis = split.kind == SplitPicture::Kind::kColumns ? 0 : 1;
    if (optics.lamp.is_exact_for(split.line) && optics.shift_px[axis].empty())
      add_line(axis, split.line, reflected);
    else
      add_blurred_line(axis, split.line, optics, reflected);
  }
  if (!split.rest.empty()) add_rest(brightness, split, optics, reflected);
  return reflected;
}

void Transport::add_line(std::size_t axis, const std::vector<unsigned char>& line,
                         std::vector<float>& reflected) const {
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, entries_.size(), 4096),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t i = range.begin(); i < range.end(); ++i) {
                        const Window& window = entries_[i].windows[axis];
                        const std::uint64_t sum = dot(responses_.data() + window.offset,
                                                      line.data() + window.begin, window.count);
                        reflected[i] += window.scale * static_cast<float>(sum) / 255;
                      }
                    });
}

void Transport::add_blurred_line(std::size_t axis, const std::vector<unsigned char>& line,
                                 const LineOptics& optics, std::vector<float>& reflected) const {
  const LitLine lit = optics.lamp.lit(line);
  const std::vector<float>& shifts = optics.shift_px[axis];
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, entries_.size(), 4096),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t i = range.begin(); i < range.end(); ++i) {
                        const Window& window = entries_[i].windows[axis];
                        const float blur = optics.blur_px.empty() ? 0 : optics.blur_px[i];
                        const float shift = shifts.empty() ? 0 : shifts[i];
                        reflected[i] +=
                            window.scale * lit.dot(responses_.data() + window.offset, window.begin,
                                                   window.count, shift, blur);
                      }
                    });
}

namespace {

// What of a picture its line does not say, as light; blurred as in the mean, and `rect` grown by
// that.
estimation::Image<float> rest_of(estimation::ImageView<const unsigned char> brightness,
                                 const SplitPicture& split, const LineOptics& optics, Rect& rect) {
  estimation::Image<float> rest(brightness.height_px, brightness.width_px);
  for (int row = rect.row_begin; row < rect.row_end; ++row)
    for (int col = rect.col_begin; col < rect.col_end; ++col) {
      float value = optics.lamp.light(brightness.at(row, col));
      if (split.kind == SplitPicture::Kind::kColumns)
        value -= optics.lamp.light(split.line[to_size(col)]);
      if (split.kind == SplitPicture::Kind::kRows)
        value -= optics.lamp.light(split.line[to_size(row)]);
      rest.at(row, col) = value;
    }
  if (optics.blur_px.empty()) return rest;
  double blur_px = 0;
  for (const float each : optics.blur_px) blur_px += static_cast<double>(each);
  blur_px /= static_cast<double>(optics.blur_px.size());
  const int reach = static_cast<int>(std::ceil(4 * blur_px));
  if (reach == 0) return rest;
  cv::Mat pixels(rest.height_px(), rest.width_px(), CV_32F, rest.samples().data());
  cv::GaussianBlur(pixels, pixels, {2 * reach + 1, 2 * reach + 1}, blur_px, blur_px,
                   cv::BORDER_REPLICATE);
  rect = {std::max(0, rect.row_begin - reach), std::min(rest.height_px(), rect.row_end + reach),
          std::max(0, rect.col_begin - reach), std::min(rest.width_px(), rect.col_end + reach)};
  return rest;
}

}  // namespace

void Transport::add_rest(estimation::ImageView<const unsigned char> brightness,
                         const SplitPicture& split, const LineOptics& optics,
                         std::vector<float>& reflected) const {
  Rect rect = split.rest;
  const estimation::Image<float> rest = rest_of(brightness, split, optics, rect);
  // A sync square in a corner mostly misses the subject.
  if (std::none_of(entries_.begin(), entries_.end(),
                   [&](const Entry& entry) { return entry.reach.meets(rect); }))
    return;
  const bool any_fine = std::any_of(entries_.begin(), entries_.end(), [&](const Entry& entry) {
    return entry.is_fine != 0 && entry.reach.meets(rect);
  });
  const LightLattice& coarse = light_->coarse();
  const LightLattice& fine = any_fine ? light_->fine() : coarse;
  const std::vector<float> coarse_light = light_on_lattice(coarse, rest.view());
  const std::vector<float> fine_light =
      any_fine ? light_on_lattice(fine, rest.view()) : std::vector<float>{};
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, entries_.size(), kChunk),
      [&](const tbb::blocked_range<std::size_t>& range) {
        Worker worker{.light = *light_, .table = table_, .coarse = coarse, .fine = fine};
        for (std::size_t i = range.begin(); i < range.end(); ++i) {
          const Entry& entry = entries_[i];
          if (!entry.reach.meets(rect)) continue;
          const SeenSample& sample = (*samples_)[i];
          const bool is_fine = entry.is_fine != 0;
          const std::vector<float>& lit = is_fine ? fine_light : coarse_light;
          const Rect both{std::max(entry.reach.row_begin, rect.row_begin - 2),
                          std::min(entry.reach.row_end, rect.row_end + 2),
                          std::max(entry.reach.col_begin, rect.col_begin - 2),
                          std::min(entry.reach.col_end, rect.col_end + 2)};
          double sum = 0;
          worker.around(sample, [&](const auto& surroundings) {
            for_each_lit(is_fine ? fine : coarse, worker.disc_of(sample), both, 2, sample.point_mm,
                         surroundings, [&](int, int, std::size_t index, float weight) {
                           sum += static_cast<double>(weight) * static_cast<double>(lit[index]);
                         });
            for (const SkinAround::Patch& patch : surroundings.near_patches())
              sum += patch.weight *
                     static_cast<double>(rest.at(static_cast<int>(std::lround(patch.row_px)),
                                                 static_cast<int>(std::lround(patch.col_px))));
          });
          reflected[i] += static_cast<float>(sum);
        }
      });
}

}  // namespace hw_sim
