#include "estimation/models/scattering_model.h"

#include "estimation/models/dipole.h"

namespace estimation {

Result<std::unique_ptr<ScatteringModel>> make_scattering_model(const std::string& name,
                                                               double eta) {
  if (!(eta >= 1 && eta <= 2))
    return tl::unexpected(InputError{InputFault::kInvalid, "", "eta",
                                     "is " + std::to_string(eta) + "; expected 1 to 2"});
  if (name == "dipole") return std::make_unique<Dipole>(eta);
  return tl::unexpected(
      InputError{InputFault::kInvalid, "", "model", "is '" + name + "'; known is: dipole"});
}

}  // namespace estimation
