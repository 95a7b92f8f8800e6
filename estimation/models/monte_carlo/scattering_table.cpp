#include "estimation/models/monte_carlo/scattering_table.h"

#include <algorithm>
#include <charconv>
#include <sstream>

namespace estimation {
namespace {

constexpr double kLogUnit = 1e-6, kErrorUnit = 1e-5;
constexpr std::string_view kTitle = "ssrig scattering table 1";

// The same in any locale.
std::string fixed(double value, int digits) {
  char buffer[64];
  const auto [end, error] =
      std::to_chars(buffer, buffer + sizeof buffer, value, std::chars_format::fixed, digits);
  return std::string(buffer, end);
}
std::string shortest(double value) {
  char buffer[64];
  const auto [end, error] = std::to_chars(buffer, buffer + sizeof buffer, value);
  return std::string(buffer, end);
}
std::string significant(double value, int digits) {
  char buffer[64];
  const auto [end, error] =
      std::to_chars(buffer, buffer + sizeof buffer, value, std::chars_format::general, digits);
  return std::string(buffer, end);
}

void append_rows(std::string& text, const std::vector<double>& values, int columns, double unit,
                 double round_up) {
  int column = 0;
  for (double value : values) {
    text += fixed(std::floor(value / unit + 0.5 + round_up) + 0.0, 0);
    text += ++column % columns == 0 ? '\n' : ' ';
  }
}

// Words of a text, one after the other; remembers the first that was not what it should be.
class Reader {
 public:
  Reader(std::string_view text, std::string name) : text_(text), name_(std::move(name)) {}

  void expect(std::string_view words) {
    std::istringstream each{std::string(words)};
    for (std::string word; each >> word;)
      if (next() != word) fail("expected '" + word + "'");
  }
  template <typename Number>
  Number number() {
    const std::string_view word = next();
    Number value{};
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc{} || end != word.data() + word.size()) fail("expected a number");
    return value;
  }
  std::string line() {
    while (place_ < text_.size() && text_[place_] == ' ') ++place_;
    const std::size_t end = std::min(text_.find('\n', place_), text_.size());
    const std::string_view found = text_.substr(place_, end - place_);
    place_ = end;
    return std::string(found);
  }
  void fail(const std::string& expectation) {
    if (!error_.expectation.empty()) return;
    std::size_t line = 1;
    for (char c : text_.substr(0, place_)) line += c == '\n';
    error_ = {InputFault::kInvalid, name_, "line " + std::to_string(line), expectation};
  }
  bool failed() const { return !error_.expectation.empty(); }
  const InputError& error() const { return error_; }

 private:
  std::string_view next() {
    constexpr std::string_view kSpace = " \n";
    place_ = std::min(text_.find_first_not_of(kSpace, place_), text_.size());
    const std::size_t end = std::min(text_.find_first_of(kSpace, place_), text_.size());
    const std::string_view word = text_.substr(place_, end - place_);
    place_ = end;
    return word;
  }

  std::string_view text_;
  std::string name_;
  std::size_t place_ = 0;
  InputError error_;
};

void read_head(Reader& reader, ScatteringTable& table) {
  reader.expect(kTitle);
  reader.expect("program");
  table.program = reader.line();
  reader.expect("eta");
  table.eta = reader.number<double>();
  reader.expect("anisotropy");
  table.anisotropy = reader.number<double>();
  reader.expect("photons");
  table.photon_count = reader.number<std::int64_t>();
  reader.expect("seed");
  table.seed = reader.number<std::uint64_t>();
  reader.expect("energy_residual");
  table.energy_residual = reader.number<double>();
  reader.expect("+-");
  table.energy_residual_se = reader.number<double>();
  reader.expect("slope");
  table.slope = reader.number<double>();
  reader.expect("grid_scale");
  table.grid.scale = reader.number<double>();
  reader.expect("grid_step");
  table.grid.step = reader.number<double>();
  reader.expect("grid_nodes");
  table.grid.node_count = reader.number<int>();
  if (!(table.eta >= 1 && std::abs(table.anisotropy) < 1 && table.slope > 0 &&
        table.grid.scale > 0 && table.grid.step > 0 && table.grid.node_count >= 4 &&
        table.grid.node_count <= 1000))
    reader.fail("the medium or the grid is out of range");
}

}  // namespace

std::string to_text(const ScatteringTable& table) {
  std::string text(kTitle);
  text.append("\nprogram ").append(table.program);
  text.append("\neta ").append(shortest(table.eta));
  text.append("\nanisotropy ").append(shortest(table.anisotropy));
  text.append("\nphotons ").append(std::to_string(table.photon_count));
  text.append("\nseed ").append(std::to_string(table.seed));
  text.append("\nenergy_residual ").append(significant(table.energy_residual, 3));
  text.append(" +- ").append(significant(table.energy_residual_se, 2));
  text.append("\nslope ").append(significant(table.slope, 9));
  text.append("\ngrid_scale ").append(shortest(table.grid.scale));
  text.append("\ngrid_step ").append(shortest(table.grid.step));
  text.append("\ngrid_nodes ").append(std::to_string(table.grid.node_count));
  text += "\nexit_radiance b0 b1 b2 b3 +-h(1)\n";
  for (std::size_t i = 0; i < table.exit_radiance.size(); ++i) {
    for (double coefficient : table.exit_radiance[i])
      text.append(fixed(coefficient, 5)).append(" ");
    text.append(significant(table.exit_radiance_se[i], 2)).append("\n");
  }
  text += "log_transform_1e-6\n";
  append_rows(text, table.log_transform, table.grid.node_count, kLogUnit, 0);
  text += "standard_error_1e-5\n";
  append_rows(text, table.log_transform_se, table.grid.node_count, kErrorUnit, 0.5);
  return text;
}

Result<ScatteringTable> scattering_table_head(std::string_view text, const std::string& name) {
  Reader reader(text, name);
  ScatteringTable table;
  read_head(reader, table);
  if (reader.failed()) return tl::unexpected(reader.error());
  return table;
}

Result<ScatteringTable> scattering_table_from_text(std::string_view text, const std::string& name) {
  Reader reader(text, name);
  ScatteringTable table;
  read_head(reader, table);
  if (reader.failed()) return tl::unexpected(reader.error());
  reader.expect("exit_radiance b0 b1 b2 b3 +-h(1)");
  for (int i = 0; i < table.grid.node_count; ++i) {
    ExitRadiance radiance{};
    for (double& coefficient : radiance) coefficient = reader.number<double>();
    table.exit_radiance.push_back(radiance);
    table.exit_radiance_se.push_back(reader.number<double>());
  }
  const int nodes = table.grid.node_count * table.grid.node_count;
  reader.expect("log_transform_1e-6");
  for (int i = 0; i < nodes && !reader.failed(); ++i)
    table.log_transform.push_back(kLogUnit * reader.number<int>());
  reader.expect("standard_error_1e-5");
  for (int i = 0; i < nodes && !reader.failed(); ++i)
    table.log_transform_se.push_back(kErrorUnit * reader.number<int>());
  if (reader.failed()) return tl::unexpected(reader.error());
  return table;
}

}  // namespace estimation
