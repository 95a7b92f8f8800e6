#include "estimation/models/monte_carlo_angular/angular_table.h"

#include <charconv>
#include <cmath>
#include <cstdio>

namespace estimation {
namespace {

constexpr std::string_view kFirstLine = "ssrig angular table 1";

// Takes words off a text and remembers where it is.
class Words {
 public:
  Words(std::string_view text, std::string name) : rest_(text), name_(std::move(name)) {}

  std::string_view next() {
    while (!rest_.empty() && (rest_.front() == ' ' || rest_.front() == '\n')) skip();
    std::size_t length = 0;
    while (length < rest_.size() && rest_[length] != ' ' && rest_[length] != '\n') ++length;
    const std::string_view word = rest_.substr(0, length);
    rest_.remove_prefix(length);
    return word;
  }
  std::string_view line() {
    const std::size_t length = std::min(rest_.find('\n'), rest_.size());
    const std::string_view line = rest_.substr(0, length);
    rest_.remove_prefix(length);
    return line;
  }
  void expect(std::string_view word) {
    if (next() != word) fail(word);
  }
  template <typename Number>
  Number number() {
    const std::string_view word = next();
    Number value{};
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc() || end != word.data() + word.size() || !is_finite(value))
      fail("a number");
    return value;
  }
  bool ok() const { return expected_.empty(); }
  InputError error() const {
    return {InputFault::kInvalid, name_, "line " + std::to_string(failed_line_),
            "expected " + expected_};
  }
  void fail(std::string_view expected) {
    if (!ok()) return;
    expected_ = expected;
    failed_line_ = line_;
  }

 private:
  static bool is_finite(double value) { return std::isfinite(value); }
  static bool is_finite(float value) { return std::isfinite(value); }
  template <typename Integer>
  static bool is_finite(Integer) {
    return true;
  }
  void skip() {
    if (rest_.front() == '\n') ++line_;
    rest_.remove_prefix(1);
  }

  std::string_view rest_;
  std::string name_, expected_;
  int line_ = 1, failed_line_ = 0;
};

// With so many significant digits.
void append(std::string& text, double value, int digit_count) {
  char digits[40];
  const auto end =
      std::to_chars(digits, digits + sizeof digits, value, std::chars_format::general, digit_count)
          .ptr;
  text.append(digits, end);
}

}  // namespace

std::string to_text(const AngularTable& table) {
  std::string text(kFirstLine);
  text.append("\nprogram ").append(table.program);
  text.append("\neta ");
  append(text, table.eta, 6);
  text.append("\nanisotropy ");
  append(text, table.anisotropy, 6);
  text.append("\nphotons ").append(std::to_string(table.photon_count));
  text.append("\nseed ").append(std::to_string(table.seed));
  text.append("\nnodes ").append(std::to_string(table.coefficients.size()));
  text.append("\nmean +-each/mean others/mean\n");
  for (std::size_t node = 0; node < table.coefficients.size(); ++node) {
    const auto& coefficients = table.coefficients[node];
    const auto mean = static_cast<double>(coefficients.front());
    append(text, mean, 7);
    text.push_back(' ');
    append(text, static_cast<double>(table.coefficient_se[node]) / mean, 2);
    for (std::size_t i = 1; i < coefficients.size(); ++i) {
      text.push_back(' ');
      const double ratio = static_cast<double>(coefficients[i]) / mean;
      append(text, std::round(ratio * 1e5) / 1e5 + 0.0, 6);  // + 0: no "-0"
    }
    text.push_back('\n');
  }
  return text;
}

Result<AngularTable> angular_table_from_text(std::string_view text, const std::string& name) {
  Words words(text, name);
  AngularTable table;
  if (words.line() != kFirstLine) words.fail(kFirstLine);
  words.expect("program");
  table.program = words.line().substr(words.ok() ? 1 : 0);
  words.expect("eta");
  table.eta = words.number<double>();
  words.expect("anisotropy");
  table.anisotropy = words.number<double>();
  words.expect("photons");
  table.photon_count = words.number<std::int64_t>();
  words.expect("seed");
  table.seed = words.number<std::uint64_t>();
  words.expect("nodes");
  if (words.number<std::size_t>() != AngularTable::node_count())
    words.fail(std::to_string(AngularTable::node_count()) + " nodes");
  for (const char* word : {"mean", "+-each/mean", "others/mean"}) words.expect(word);
  for (std::size_t node = 0; words.ok() && node < AngularTable::node_count(); ++node) {
    auto& coefficients = table.coefficients.emplace_back();
    const float mean = coefficients.front() = words.number<float>();
    table.coefficient_se.push_back(words.number<float>() * mean);
    for (std::size_t i = 1; i < coefficients.size(); ++i)
      coefficients[i] = words.number<float>() * mean;
  }
  if (!words.next().empty()) words.fail("the end");
  if (!words.ok()) return tl::unexpected(words.error());
  return table;
}

}  // namespace estimation
