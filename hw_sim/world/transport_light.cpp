// How a transport answers to a picture.
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <opencv2/imgproc.hpp>

#include "hw_sim/world/surroundings.h"
#include "hw_sim/world/transport.h"

namespace hw_sim {
namespace {

constexpr std::size_t kChunk = 512;  // samples a task

std::size_t to_size(int value) { return static_cast<std::size_t>(value); }

using Rect = SplitPicture::Rect;

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
        Surroundings surroundings{.light = *light_, .table = table_};
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
          surroundings.around(sample, [&](const auto& around) {
            for_each_lit(is_fine ? fine : coarse, surroundings.disc_of(sample), both, 2,
                         sample.point_mm, around, [&](int, int, std::size_t index, float weight) {
                           sum += static_cast<double>(weight) * static_cast<double>(lit[index]);
                         });
            for (const SkinAround::Patch& patch : around.near_patches())
              sum += patch.weight *
                     static_cast<double>(rest.at(static_cast<int>(std::lround(patch.row_px)),
                                                 static_cast<int>(std::lround(patch.col_px))));
          });
          reflected[i] += static_cast<float>(sum);
        }
      });
}

}  // namespace hw_sim
