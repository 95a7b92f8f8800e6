// What a projector makes of the grey levels it is given: its gamma, and the light of a picture that
// varies along one axis under its pixels' shape and its lens's blur.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <utility>
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
  float dot(const Weight* weights, int first, int count, float shift_px, float blur_px) const;
  float at(float position_px, float blur_px) const {
    const float one = 1;
    return dot(&one, 0, 1, -position_px, blur_px);
  }

 private:
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
float LitLine::dot(const Weight* weights, int first, int count, float shift_px,
                   float blur_px) const {
  const float position = blur_px / kBlurStep_px;
  const auto level = static_cast<std::size_t>(position);
  const float more = position - static_cast<float>(level);
  const std::vector<float>& sharp = levels_[level];
  const std::vector<float>& soft = levels_[more > 0 ? level + 1 : level];
  const int whole = static_cast<int>(std::floor(shift_px));
  const float part = shift_px - static_cast<float>(whole);
  // Of the two blurs, at the pixel and at the one before it.
  const float a = (1 - more) * (1 - part), b = (1 - more) * part;
  const float c = more * (1 - part), d = more * part;
  const int last = static_cast<int>(sharp.size()) - 1, start = first - whole;
  constexpr int kLanes = 8;  // sums side by side: vectors, in an order that never changes
  float lanes[kLanes] = {};
  if (start - 1 >= 0 && start + count - 1 <= last) {
    const float* x = sharp.data() + start;
    const float* y = soft.data() + start;
    const auto term = [&](int i) {
      return static_cast<float>(weights[i]) * (a * x[i] + b * x[i - 1] + c * y[i] + d * y[i - 1]);
    };
    int i = 0;
    for (; i + kLanes <= count; i += kLanes)
      for (int lane = 0; lane < kLanes; ++lane) lanes[lane] += term(i + lane);
    for (; i < count; ++i) lanes[0] += term(i);
  } else {
    const auto inside = [&](int px) { return static_cast<std::size_t>(std::clamp(px, 0, last)); };
    for (int i = 0; i < count; ++i) {
      const std::size_t here = inside(start + i), before = inside(start + i - 1);
      lanes[i % kLanes] += static_cast<float>(weights[i]) * (a * sharp[here] + b * sharp[before] +
                                                             c * soft[here] + d * soft[before]);
    }
  }
  double sum = 0;
  for (const float lane : lanes) sum += static_cast<double>(lane);
  return static_cast<float>(sum);
}

}  // namespace hw_sim
