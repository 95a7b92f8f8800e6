// A pixel's search for the greatest likelihood, in double precision, and what is known there.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "estimation/profile/fisher.h"
#include "estimation/profile/pixel_model.h"
#include "estimation/profile/pixel_start.h"
#include "estimation/profile/sample_space.h"
#include "estimation/profile/small_matrix.h"

namespace estimation {

// Keeps its buffers from pixel to pixel. Not thread-safe.
class PixelSearch {
 public:
  // Binds the model to a pixel.
  PixelModel::Binding bind(const FitProblem& problem, const PixelBatch& batch, std::size_t pixel);

  PixelModel& model() { return model_; }
  // How many numbers are compared, once the pixel is known to be worth a search.
  std::size_t choose_space();
  // Harmonics of a sample below this are left out.
  void set_tolerance(double reflectance) { tolerance_ = reflectance; }

  // Gauss-Newton; a step that does not descend is shortened, as R_d and l_d lie in a curved valley,
  // then damped. 0 at the optimum, otherwise the reason not to have found one.
  std::uint32_t run(SearchPoint& point);

  // At the optimum found last:
  double chi_square() const { return chi_square_; }
  // Fisher information in (t, ln l, B, phase), B = mean - R_d.
  SymmetricMatrix information(const SearchPoint& point) const;
  // Where estimates have no bias to second order in the noise (likelihood.h).
  SearchPoint unbiased(const SearchPoint& point);

 private:
  using Step = std::array<double, kUnknowns>;  // of t, ln l, mean, phase

  bool is_free() const { return problem_->indirect == IndirectLight::kFree; }
  bool evaluate(const SearchPoint& point, ModelSamples& samples);
  double expected(const SearchPoint& point, const ModelSamples& samples, std::size_t sample) const;
  void weigh(const SearchPoint& point, const ModelSamples& samples);
  void whiten_residual(const SearchPoint& point, const ModelSamples& samples);
  double chi_square_at(const SearchPoint& point, const ModelSamples& samples);
  void assemble(const SearchPoint& point, const ModelSamples& samples);
  std::optional<Step> step(double damping) const;
  double squared_length(const Step& step) const;
  SearchPoint moved(const SearchPoint& point, const Step& step) const;
  double log_variance() const;
  bool is_in_table(const ShapePoint& shape) const;
  ShapePoint within_table(const ShapePoint& shape) const;
  bool advance(SearchPoint& point, Step change, int attempts);
  bool settle(const SearchPoint& point);

  const FitProblem* problem_ = nullptr;
  PixelModel model_;
  ModelSamples samples_, trial_samples_;
  SampleSpace space_;
  std::vector<double> in_samples_;  // one number a sample, on its way to the space
  std::vector<double> residual_;    // of a trial, whitened
  std::array<std::vector<double>, kUnknowns> slopes_;  // whitened, at the current point
  double tolerance_ = 0;
  // Normal equations in (t, ln l, mean, phase) at the current point.
  SmallMatrix<kUnknowns> normal_{};
  Step gradient_{};
  double chi_square_ = 0;
  // What a search is allowed once it is known to be worth its cost, and those after it, too.
  bool may_leave_table_ = false;
  PixelModel::Harmonics harmonics_ = PixelModel::Harmonics::kOfTable;
};

}  // namespace estimation
