// What a camera would see of a set of patterns at known projector coordinates: each pattern blurred
// by a Gaussian along its axis, Bayer-like gains, photon and read noise. In memory, seeded.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <numbers>
#include <optional>
#include <random>
#include <vector>

#include "estimation/geometry/correspondence.h"
#include "estimation/session/pattern.h"

namespace estimation::testing {

struct SyntheticScene {
  int height_px = 40;
  int width_px = 120;
  int projector_width_px = 1024;
  int projector_height_px = 768;
  std::function<double(int row, int col)> column_px, row_px;  // truth
  double blur_px = 2;
  double black = 0.002, white = 0.4;       // DN/us
  std::array<double, 4> gain{1, 1, 1, 1};  // of the 2 x 2 sites
  double read_sd = 0, shot_dn_per_us = 0;
  std::uint64_t seed = 1;
};

// Crosses the projector obliquely to both axes, through all phases of all periods; a pixel is so
// many columns wide and rows high.
inline SyntheticScene slanted_scene(int height_px, int width_px, double columns_per_px,
                                    double rows_per_px) {
  SyntheticScene scene;
  scene.height_px = height_px;
  scene.width_px = width_px;
  scene.column_px = [=](int row, int col) { return 150.3 + columns_per_px * col + 0.113 * row; };
  scene.row_px = [=](int row, int col) { return 120.7 + rows_per_px * row - 0.092 * col; };
  return scene;
}

// Normal deviates that are the same with every library.
class NormalDeviates {
 public:
  explicit NormalDeviates(std::uint64_t seed) : engine_(seed) {}
  double next() {
    const double u = (static_cast<double>(engine_() >> 11) + 0.5) * 0x1.0p-53;
    const double v = static_cast<double>(engine_() >> 11) * 0x1.0p-53;
    return std::sqrt(-2 * std::log(u)) * std::cos(2 * std::numbers::pi * v);
  }

 private:
  std::mt19937_64 engine_;
};

inline Axis axis_of(const PatternKind& kind) {
  if (const auto* code = std::get_if<GrayCode>(&kind)) return code->axis;
  if (const auto* stripes = std::get_if<Stripes>(&kind)) return stripes->axis;
  if (const auto* fringe = std::get_if<Fringe>(&kind)) return fringe->axis;
  return Axis::kColumn;
}

// A pattern along its axis, its brightness averaged by a Gaussian.
class BlurredPattern {
 public:
  BlurredPattern(const PatternKind& kind, double blur_px, int size_px) : blur_px_(blur_px) {
    if (const auto* fringe = std::get_if<Fringe>(&kind)) {
      fringe_ = *fringe;
      return;
    }
    const auto lit = [&](int i) {
      if (i < 0 || i >= size_px) return 0.0;
      return axis_of(kind) == Axis::kColumn ? brightness(kind, 0, i) : brightness(kind, i, 0);
    };
    for (int i = 0; i <= size_px; ++i) {
      if (lit(i) != lit(i - 1)) edges_.push_back({i - 0.5, lit(i) - lit(i - 1)});
    }
  }

  double at(double position_px) const {
    if (fringe_) {
      const double freq = 2 * std::numbers::pi / fringe_->period_px;
      return (1 + std::exp(-0.5 * std::pow(freq * blur_px_, 2)) *
                      std::cos(freq * (position_px - fringe_->shift_px))) /
             2;
    }
    double sum = 0;
    for (const Edge& edge : edges_) {
      const double past = (position_px - edge.position_px) / blur_px_;
      if (past < -7) break;
      sum += edge.step * (past > 7 ? 1 : 0.5 * std::erfc(-past / std::numbers::sqrt2));
    }
    return sum;
  }

 private:
  struct Edge {
    double position_px = 0, step = 0;
  };
  double blur_px_;
  std::vector<Edge> edges_;
  std::optional<Fringe> fringe_;
};

// The frames own their pixels; signals() borrows from them.
class SyntheticFrames {
 public:
  SyntheticFrames(const SyntheticScene& scene, std::vector<PatternKind> kinds)
      : kinds_(std::move(kinds)) {
    NormalDeviates deviates(scene.seed);
    for (const PatternKind& kind : kinds_) {
      Image<float> frame(scene.height_px, scene.width_px);
      const Axis axis = axis_of(kind);
      const BlurredPattern pattern(
          kind, scene.blur_px,
          axis == Axis::kColumn ? scene.projector_width_px : scene.projector_height_px);
      for (int row = 0; row < scene.height_px; ++row) {
        for (int col = 0; col < scene.width_px; ++col) {
          const double position_px =
              axis == Axis::kColumn ? scene.column_px(row, col) : scene.row_px(row, col);
          const double lit = scene.black + scene.white * pattern.at(position_px);
          const double signal = lit * scene.gain[static_cast<std::size_t>(2 * (row % 2) + col % 2)];
          const double sd =
              std::sqrt(scene.read_sd * scene.read_sd + scene.shot_dn_per_us * signal);
          frame.at(row, col) = static_cast<float>(signal + sd * deviates.next());
        }
      }
      frames_.push_back(std::move(frame));
    }
  }

  std::vector<PatternSignal> signals() const {
    std::vector<PatternSignal> signals;
    for (std::size_t i = 0; i < kinds_.size(); ++i) {
      signals.push_back({&kinds_[i], frames_[i].view()});
    }
    return signals;
  }
  Image<float>& frame(std::size_t i) { return frames_[i]; }

 private:
  std::vector<PatternKind> kinds_;
  std::vector<Image<float>> frames_;
};

inline void add_gray(std::vector<PatternKind>& kinds, Axis axis, int high_bit, int low_bit,
                     bool with_inverses = true) {
  for (int bit = high_bit; bit >= low_bit; --bit) {
    kinds.push_back(GrayCode{axis, bit, false});
    if (with_inverses) kinds.push_back(GrayCode{axis, bit, true});
  }
}

inline void add_stripes(std::vector<PatternKind>& kinds, Axis axis, int period_px, int width_px,
                        int step_px) {
  for (int shift_px = 0; shift_px < period_px; shift_px += step_px) {
    kinds.push_back(Stripes{axis, period_px, width_px, shift_px});
  }
}

inline std::vector<PatternKind> paper_kinds() {
  std::vector<PatternKind> kinds;
  for (const Pattern& pattern : paper_patterns()) kinds.push_back(pattern.kind);
  return kinds;
}

}  // namespace estimation::testing
