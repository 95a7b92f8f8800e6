#include <algorithm>
#include <cmath>
#include <optional>

#include "estimation/profile/fisher.h"
#include "estimation/profile/likelihood.h"
#include "estimation/profile/pixel_search.h"
#include "estimation/profile/pixel_start.h"
#include "estimation/session/maps.h"

namespace estimation {
namespace {

// A first harmonic whose square is below so many times its variance is noise (by chance once in
// 400 pixels).
constexpr double kLeastContrast = 12;
// Samples whose mean is below so many of their standard deviations are dark, not flat.
constexpr double kDarkSnr = 5;
// Harmonics this share of a sample's noise are left out.
constexpr double kToleranceOfNoise = 3e-4;

PixelFit refused(std::uint32_t reason) { return {.validity = reason}; }

std::uint32_t reason_for_too_few(const PixelModel& model) {
  return model.lost_count() > 0 ? kSaturated : kNotIdentifiable;
}

std::uint32_t check_contrast(const PixelModel& model, const Demodulated& data) {
  const double variance = model.variance(data.mean);
  if (std::norm(data.first) >= kLeastContrast * data.first_variance * variance) return 0;
  return data.mean < kDarkSnr * std::sqrt(variance) ? kTooDark : kNotIdentifiable;
}

double least_sd(const PixelModel& model, const Demodulated& data) {
  double least = model.variance(data.mean);
  for (const double reflectance : model.reflectance())
    least = std::min(least, model.variance(reflectance));
  return std::sqrt(least);
}

// From the harmonics, or else from the middle of what can be told apart.
std::uint32_t search_from(const PixelStart& start, const Demodulated& data, PixelSearch& search,
                          SearchPoint& point) {
  point = start.from_harmonics(data);
  const std::uint32_t reason = search.run(point);
  if (reason == 0) return 0;
  point = start.from_middle(data);
  return search.run(point) == 0 ? 0 : reason;
}

PixelFit result(const FitProblem& problem, PixelSearch& search, std::size_t compared_count,
                const SearchPoint& point) {
  const SymmetricMatrix known = search.information(point);
  const auto covariance = inverse_information(known, problem.indirect);
  if (!covariance || !is_identifiable(known, *covariance, problem.indirect))
    return refused(kNotIdentifiable);
  const bool is_free = problem.indirect == IndirectLight::kFree;
  const SearchPoint best = search.unbiased(point);
  const double logit = best.shape.logit_reflectance;
  return {.logit_reflectance = logit,
          .log_translucency_px = best.shape.log_translucency_px,
          .indirect = is_free ? best.mean - 1 / (1 + std::exp(-logit)) : 0,
          .phase_px = best.phase_px,
          .covariance = *covariance,
          .chi_square = search.chi_square(),
          .degrees_of_freedom = static_cast<int>(compared_count) - (is_free ? 4 : 3)};
}

}  // namespace

PixelFit fit_pixel(const FitProblem& problem, const PixelBatch& batch, std::size_t pixel) {
  // As long-lived as their thread: of a thousand pixels only the first allocates.
  thread_local PixelSearch search;
  switch (search.bind(problem, batch, pixel)) {
    case PixelModel::Binding::kNoLight:
      return refused(kTooDark);
    case PixelModel::Binding::kAbsurd:
      return refused(kOutsideModel);
    case PixelModel::Binding::kReady:
      break;
  }
  PixelModel& model = search.model();
  const std::size_t unknown_count = problem.indirect == IndirectLight::kFree ? 4 : 3;
  if (model.sample_count() < unknown_count) return refused(reason_for_too_few(model));
  if (!(model.level() > 0) || std::norm(model.twice_factor(1)) == 0)
    return refused(kNotIdentifiable);
  const PixelStart start(problem, model);
  const auto data = start.demodulate();
  if (!data) return refused(reason_for_too_few(model));
  if (const std::uint32_t reason = check_contrast(model, *data)) return refused(reason);
  search.set_tolerance(kToleranceOfNoise * least_sd(model, *data));
  const std::size_t compared_count = search.choose_space();
  if (compared_count < unknown_count) return refused(kNotIdentifiable);
  SearchPoint point;
  if (const std::uint32_t reason = search_from(start, *data, search, point)) return refused(reason);
  return result(problem, search, compared_count, point);
}

}  // namespace estimation
