// The scattering tables that come with the program: the files of models/monte_carlo/tables, built
// in (embed_tables.cmake), so that nothing is looked for at run time.
#pragma once

#include <span>
#include <string_view>

namespace estimation {

struct ShippedTable {
  std::string_view file_name, text;
};
std::span<const ShippedTable> shipped_tables();

}  // namespace estimation
