// The tables of models/monte_carlo_angular/tables, built in.
#pragma once

#include "estimation/models/monte_carlo/shipped_tables.h"

namespace estimation {

std::span<const ShippedTable> shipped_angular_tables();

}  // namespace estimation
