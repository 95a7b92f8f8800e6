// What a projector makes of the grey levels it is given: its gamma, and the light of a picture that
// varies along one axis under its pixels' shape and its lens's blur.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

namespace hw_sim {

// Light along one axis, by pixel, at blurs of 0, kBlurStep_px, ... px. Its ends continue.
class LitLine {
 public:
  static constexpr float kBlurStep_px = 0.1F;

  explicit LitLine(std::vector<std::vector<float>> levels) : levels_(std::move(levels)) {}
  // sum of weights[i] times the light at pixel first + i - shift_px. Between pixels light is what
  // falls on their square: linear.
  template <typename Weight>
  float dot(const Weight* weights, int first, int count, float shift_px, float blur_px) const {
    const float position = blur_px / kBlurStep_px;
    const auto level = static_cast<std::size_t>(position);
    const float part = position - static_cast<float>(level);
    const float sum = dot_level(weights, first, count, shift_px, level);
    if (!(part > 0)) return sum;
    return (1 - part) * sum + part * dot_level(weights, first, count, shift_px, level + 1);
  }
  float at(float position_px, float blur_px) const {
    const float one = 1;
    return dot(&one, 0, 1, -position_px, blur_px);
  }

 private:
  template <typename Weight>
  float dot_level(const Weight* weights, int first, int count, float shift_px,
                  std::size_t level) const;

  std::vector<std::vector<float>> levels_;
};

// Immutable, so thread-safe.
class LampResponse {
 public:
  // A pixel lights a square of side `pixel_fill_frac` of its pitch; no place has more blur than
  // `greatest_blur_px`.
  LampResponse(double gamma, double pixel_fill_frac, double greatest_blur_px);
  LampResponse() : LampResponse(1, 1, 0) {}

  float light(unsigned char grey) const { return light_of_grey_[grey]; }  // 0..1
  LitLine lit(const std::vector<unsigned char>& line) const;
  // Light is as the pixels say, to the last bit.
  bool is_exact_for(const std::vector<unsigned char>& line) const;

 private:
  bool is_linear_;
  std::array<float, 256> light_of_grey_{};
  std::vector<std::vector<double>> taps_;  // [level], symmetric about their middle
};

template <typename Weight>
float LitLine::dot_level(const Weight* weights, int first, int count, float shift_px,
                         std::size_t level) const {
  const std::vector<float>& line = levels_[level];
  const float below = shift_px >= 0 ? static_cast<float>(static_cast<int>(shift_px))
                                    : -static_cast<float>(static_cast<int>(1 - shift_px));
  const int whole = static_cast<int>(below);
  const float part = shift_px - below;
  const int last = static_cast<int>(line.size()) - 1;
  double sum = 0;
  if (first - whole - 1 >= 0 && first - whole + count - 1 <= last) {  // nothing to clamp
    const float* light = line.data() + (first - whole);
    for (int i = 0; i < count; ++i)
      sum += static_cast<double>(static_cast<float>(weights[i]) *
                                 ((1 - part) * light[i] + part * light[i - 1]));
    return static_cast<float>(sum);
  }
  const auto at = [&](int px) {
    return line[static_cast<std::size_t>(px < 0 ? 0 : px > last ? last : px)];
  };
  for (int i = 0; i < count; ++i) {
    const int px = first + i - whole;
    sum += static_cast<double>(static_cast<float>(weights[i]) *
                               ((1 - part) * at(px) + part * at(px - 1)));
  }
  return static_cast<float>(sum);
}

}  // namespace hw_sim
