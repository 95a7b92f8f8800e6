// Images as plain memory: a view that borrows and an image that owns.
#pragma once

#include <cstddef>
#include <span>
#include <type_traits>
#include <vector>

#include "estimation/base/check.h"

namespace estimation {

// Borrowed pixels, row-major, channels interleaved; pixel (row, col) starts at
// data[row * stride + col * channel_count]. Converts to const, not back. Copying copies the view.
template <typename T>
struct ImageView {
  T* data = nullptr;
  int height_px = 0;
  int width_px = 0;
  int channel_count = 1;
  std::ptrdiff_t stride = 0;  // elements from one row to the next

  T& at(int row, int col, int channel = 0) const {
    return data[row * stride + static_cast<std::ptrdiff_t>(col) * channel_count + channel];
  }
  std::span<T> row(int row) const {
    return {data + row * stride,
            static_cast<std::size_t>(width_px) * static_cast<std::size_t>(channel_count)};
  }
  bool empty() const { return data == nullptr; }
  operator ImageView<const T>() const  // NOLINT(google-explicit-constructor): adding const is safe
      requires(!std::is_const_v<T>) {
    return {data, height_px, width_px, channel_count, stride};
  }
};

// Owned pixels, contiguous. A default-constructed image is empty.
template <typename T>
class Image {
 public:
  Image() = default;
  Image(int height_px, int width_px, int channel_count = 1, T fill = T{})
      : height_px_(height_px),
        width_px_(width_px),
        channel_count_(channel_count),
        samples_(static_cast<std::size_t>(height_px) * static_cast<std::size_t>(width_px) *
                     static_cast<std::size_t>(channel_count),
                 fill) {
    check(height_px >= 0 && width_px >= 0 && channel_count >= 1, "image of negative size");
  }

  int height_px() const { return height_px_; }
  int width_px() const { return width_px_; }
  int channel_count() const { return channel_count_; }
  bool empty() const { return samples_.empty(); }
  T& at(int row, int col, int channel = 0) { return view().at(row, col, channel); }
  const T& at(int row, int col, int channel = 0) const { return view().at(row, col, channel); }
  std::span<T> samples() { return samples_; }
  std::span<const T> samples() const { return samples_; }

  ImageView<T> view() { return {samples_.data(), height_px_, width_px_, channel_count_, stride()}; }
  ImageView<const T> view() const {
    return {samples_.data(), height_px_, width_px_, channel_count_, stride()};
  }

 private:
  std::ptrdiff_t stride() const { return static_cast<std::ptrdiff_t>(width_px_) * channel_count_; }

  int height_px_ = 0;
  int width_px_ = 0;
  int channel_count_ = 1;
  std::vector<T> samples_;
};

}  // namespace estimation
