#include "estimation/profile/fisher.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "estimation/profile/pixel_model.h"
#include "estimation/profile/small_matrix.h"

namespace estimation {
namespace {

// At 0.3, rather, a case of few shifts whose pixels lie about the limit loses its large ones only:
// the rest is less well covered (bounds of 20 to 30%: 86 to 99% within two sd; at 0.5: 89 to 99%).
constexpr double kGreatestLogSd = 0.5;
constexpr double kGreatestCondition = 1e5;
// Harmonics below this reflectance are left out of a bound.
constexpr double kTolerance = 1e-7;

SmallMatrix<kUnknowns> full_matrix(const SymmetricMatrix& lower, IndirectLight indirect) {
  SmallMatrix<kUnknowns> full{};
  for (std::size_t i = 0; i < kUnknowns; ++i)
    for (std::size_t j = 0; j < kUnknowns; ++j) full[i][j] = lower[covariance_index(i, j)];
  if (indirect == IndirectLight::kZero)
    for (std::size_t i = 0; i < kUnknowns; ++i) full[2][i] = full[i][2] = i == 2 ? 1 : 0;
  return full;
}

}  // namespace

std::optional<SymmetricMatrix> inverse_information(const SymmetricMatrix& information,
                                                   IndirectLight indirect) {
  const auto inverse = inverse_of(full_matrix(information, indirect));
  if (!inverse) return std::nullopt;
  SymmetricMatrix covariance{};
  for (std::size_t i = 0; i < kUnknowns; ++i)
    for (std::size_t j = 0; j <= i; ++j) {
      const bool is_fixed = indirect == IndirectLight::kZero && (i == 2 || j == 2);
      covariance[covariance_index(i, j)] = is_fixed ? 0 : (*inverse)[i][j];
    }
  return covariance;
}

bool is_identifiable(const SymmetricMatrix& information, const SymmetricMatrix& covariance,
                     IndirectLight indirect) {
  const double log_variance = covariance[covariance_index(1, 1)];
  if (!(log_variance <= kGreatestLogSd * kGreatestLogSd)) return false;
  // The scaled matrix has trace n: its largest eigenvalue lies between 1 and n, the inverse's
  // largest between trace / n and trace, and mostly that settles it.
  double inverse_trace = 0;
  for (std::size_t i = 0; i < kUnknowns; ++i)
    inverse_trace += information[covariance_index(i, i)] * covariance[covariance_index(i, i)];
  if (inverse_trace * kUnknowns <= kGreatestCondition) return true;
  if (inverse_trace / kUnknowns > kGreatestCondition) return false;
  return condition_of(full_matrix(information, indirect)) <= kGreatestCondition;
}

std::vector<double> expected_reflectance(const FitProblem& problem, const PixelBatch& batch,
                                         std::size_t pixel, const PixelTruth& truth) {
  PixelModel model;
  ModelSamples samples;
  if (model.bind(problem, batch, pixel) != PixelModel::Binding::kReady ||
      !model.evaluate(truth.shape, truth.phase_px, kTolerance, PixelModel::Harmonics::kAll,
                      samples))
    return {};
  const double mean = 1 / (1 + std::exp(-truth.shape.logit_reflectance)) + truth.indirect;
  for (double& value : samples.harmonics) value += model.level() * mean;
  return samples.harmonics;
}

std::optional<SymmetricMatrix> cramer_rao_bound(const FitProblem& problem, const PixelBatch& batch,
                                                std::size_t pixel, const PixelTruth& truth) {
  PixelModel model;
  ModelSamples samples;
  if (model.bind(problem, batch, pixel) != PixelModel::Binding::kReady ||
      !model.evaluate(truth.shape, truth.phase_px, kTolerance, PixelModel::Harmonics::kAll,
                      samples))
    return std::nullopt;
  const double reflectance = 1 / (1 + std::exp(-truth.shape.logit_reflectance));
  const double by_logit = reflectance / (1 + std::exp(truth.shape.logit_reflectance));
  std::vector<double> variances, white[kUnknowns];
  for (const double harmonics : samples.harmonics)
    variances.push_back(model.variance(harmonics + model.level() * (reflectance + truth.indirect)));
  for (double& slope : samples.by_logit) slope += model.level() * by_logit;
  SampleSpace space;
  model.choose_space(space);
  space.set_variances(variances);
  space.whiten(samples.by_logit, white[0]);
  space.whiten(samples.by_log, white[1]);
  space.whiten(std::vector<double>(model.sample_count(), model.level()), white[2]);
  space.whiten(samples.by_phase, white[3]);
  SymmetricMatrix information{};
  for (std::size_t i = 0; i < kUnknowns; ++i)
    for (std::size_t j = 0; j <= i; ++j)
      information[covariance_index(i, j)] =
          std::inner_product(white[i].begin(), white[i].end(), white[j].begin(), 0.0);
  return inverse_information(information, problem.indirect);
}

}  // namespace estimation
