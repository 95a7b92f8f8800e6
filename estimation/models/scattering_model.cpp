#include "estimation/models/scattering_model.h"

#include <algorithm>

#include "estimation/models/burley.h"
#include "estimation/models/dipole.h"
#include "estimation/models/gaussians.h"
#include "estimation/models/monte_carlo.h"
#include "estimation/models/monte_carlo_angular.h"

namespace estimation {

void ScatteringModel::direction_factors(double, std::span<const double>, const Directions&,
                                        std::span<std::complex<double>> out) const {
  std::fill(out.begin(), out.end(), std::complex<double>(1, 0));
}

Result<std::unique_ptr<ScatteringModel>> make_scattering_model(const std::string& name,
                                                               const MediumOptions& medium) {
  if (!(medium.eta >= 1 && medium.eta <= 2))
    return tl::unexpected(InputError{InputFault::kInvalid, "", "eta",
                                     "is " + std::to_string(medium.eta) + "; expected 1 to 2"});
  if (name == "monte_carlo") return make_monte_carlo(medium);
  if (name == "monte_carlo_angular") return make_monte_carlo_angular(medium);
  if (name == "dipole") return std::make_unique<Dipole>(medium.eta);
  if (name == "burley") return std::make_unique<Burley>(medium.eta);
  if (name == "gaussians") return std::make_unique<Gaussians>(medium.eta);
  return tl::unexpected(InputError{InputFault::kInvalid, "", "model",
                                   "is '" + name +
                                       "'; known are: dipole, burley, gaussians, monte_carlo, "
                                       "monte_carlo_angular"});
}

}  // namespace estimation
