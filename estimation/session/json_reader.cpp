#include "estimation/session/json_reader.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "estimation/session/files.h"

namespace estimation {
namespace {

constexpr std::size_t kDeepestNesting = 64;
// An ordered object searches its keys one by one: this bounds the time a hostile file costs.
constexpr std::size_t kMostKeys = 1000;

std::string escaped(std::string_view key) {
  std::string token;
  for (const char c : key) {
    if (c == '~') {
      token += "~0";
    } else if (c == '/') {
      token += "~1";
    } else {
      token += c;
    }
  }
  return token;
}

std::string line_and_column(std::string_view text, std::size_t end) {
  const std::string_view before = text.substr(0, std::min(end, text.size()));
  const auto line = 1 + std::ranges::count(before, '\n');
  const std::size_t newline = before.rfind('\n');
  const std::size_t column =
      newline == std::string_view::npos ? before.size() : before.size() - newline - 1;
  return "line " + std::to_string(line) + ", column " +
         std::to_string(std::max<std::size_t>(column, 1));
}

// The library's message without its "[json.exception...] parse error at ...: " prefix.
std::string reason(const std::string& message) {
  std::size_t start = message.find("] ");
  start = start == std::string::npos ? 0 : start + 2;
  const std::size_t column = message.find("column ", start);
  if (column != std::string::npos) {
    const std::size_t colon = message.find(": ", column);
    if (colon != std::string::npos) start = colon + 2;
  }
  return message.substr(start);
}

// Builds the document from the parser's events; returning false ends the parsing without a throw.
class DocumentBuilder final : public nlohmann::json_sax<Json> {
 public:
  DocumentBuilder(std::string_view text, std::string file) : text_(text), file_(std::move(file)) {}

  bool null() override { return add(nullptr); }
  bool boolean(bool value) override { return add(value); }
  bool number_integer(number_integer_t value) override { return add(value); }
  bool number_unsigned(number_unsigned_t value) override { return add(value); }
  bool number_float(number_float_t value, const string_t&) override { return add(value); }
  bool string(string_t& value) override { return add(std::move(value)); }
  bool binary(binary_t&) override { return fail("", "JSON text holds no binary values"); }
  bool start_object(std::size_t) override { return open(Json::object()); }
  bool start_array(std::size_t) override { return open(Json::array()); }
  bool end_object() override { return close(); }
  bool end_array() override { return close(); }

  bool key(string_t& key) override {
    const Json& object = *open_.back();
    if (object.contains(key)) return fail("", "the key \"" + key + "\" is given twice");
    if (object.size() >= kMostKeys) {
      return fail("", "an object has more than " + std::to_string(kMostKeys) + " keys");
    }
    key_ = std::move(key);
    return true;
  }

  bool parse_error(std::size_t position, const std::string&,
                   const nlohmann::detail::exception& error) override {
    return fail(line_and_column(text_, position),
                reason(error.what()) + "; expected a valid JSON document in UTF-8");
  }

  Result<Json> take() {
    if (error_) return tl::unexpected(*error_);
    return std::move(root_);
  }

 private:
  bool fail(const std::string& place, const std::string& expectation) {
    error_ = InputError{InputFault::kInvalid, file_, place, expectation};
    return false;
  }

  // Puts a value where the parser stands. Pointers in open_ stay valid: a container grows only
  // while it is the innermost open one.
  Json* place(Json value) {
    if (open_.empty()) {
      root_ = std::move(value);
      return &root_;
    }
    Json& parent = *open_.back();
    if (parent.is_array()) {
      parent.push_back(std::move(value));
      return &parent.back();
    }
    Json& child = parent[key_];
    child = std::move(value);
    return &child;
  }

  template <typename T>
  bool add(T&& value) {
    place(Json(std::forward<T>(value)));
    return true;
  }

  bool open(Json container) {
    if (open_.size() >= kDeepestNesting) {
      return fail("", "values are nested deeper than " + std::to_string(kDeepestNesting));
    }
    open_.push_back(place(std::move(container)));
    return true;
  }

  bool close() {
    open_.pop_back();
    return true;
  }

  std::string_view text_;
  std::string file_;
  Json root_;
  std::vector<Json*> open_;
  std::string key_;
  std::optional<InputError> error_;
};

std::string found(const Json& value) {
  if (value.is_object()) return "is an object";
  if (value.is_array()) return "is a list of " + std::to_string(value.size());
  constexpr std::size_t kLongest = 60;
  std::string text = value.dump(-1, ' ', false, Json::error_handler_t::replace);
  if (text.size() > kLongest) text = text.substr(0, kLongest) + "...";
  return "is " + text;
}

// 1.0 is a whole number for JSON; beyond 2^53 a double is no longer sure of it.
std::optional<std::int64_t> exact_whole(double value) {
  if (value != std::floor(value) || std::abs(value) > 9007199254740992.0) return std::nullopt;
  return static_cast<std::int64_t>(value);
}

std::string display(double value) {
  std::ostringstream text;
  text << value;
  return text.str();
}

}  // namespace

Result<Json> parse_json(std::string_view text, const std::string& file) {
  DocumentBuilder builder(text, file);
  Json::sax_parse(text, &builder);
  return builder.take();
}

void JsonErrors::add(const std::string& pointer, const std::string& expectation) {
  if (!first_) first_ = InputError{InputFault::kInvalid, file_, pointer, expectation};
}

JsonValue JsonValue::at(const std::string& key) const {
  if (std::optional<JsonValue> value = find(key)) return *value;
  return {nullptr, pointer_ + "/" + escaped(key), errors_};
}

std::optional<JsonValue> JsonValue::find(const std::string& key) const {
  if (!is_object()) {
    fail("an object with the key \"" + key + "\"");
    return std::nullopt;
  }
  const auto it = value_->find(key);
  if (it == value_->end()) return std::nullopt;
  return JsonValue{&*it, pointer_ + "/" + escaped(key), errors_};
}

void JsonValue::fail(const std::string& expected) const {
  const std::string state = value_ == nullptr ? "is missing" : found(*value_);
  errors_->add(pointer_.empty() ? "/" : pointer_, state + "; expected " + expected);
}

std::int64_t JsonValue::integer(std::int64_t lowest, std::int64_t highest,
                                const std::string& what) const {
  const auto refuse = [&] {
    fail("a whole number from " + std::to_string(lowest) + " to " + std::to_string(highest) + ": " +
         what);
    return lowest;
  };
  if (value_ == nullptr || !value_->is_number()) return refuse();
  if (value_->is_number_unsigned()) {
    const auto value = value_->get<std::uint64_t>();
    if (value > static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max())) {
      return refuse();
    }
  } else if (value_->is_number_float() && !exact_whole(value_->get<double>())) {
    return refuse();
  }
  const auto value = value_->get<std::int64_t>();
  return value < lowest || value > highest ? refuse() : value;
}

int JsonValue::whole(int lowest, int highest, const std::string& what) const {
  return static_cast<int>(integer(lowest, highest, what));
}

std::uint64_t JsonValue::counter(const std::string& what) const {
  if (value_ != nullptr && value_->is_number_unsigned()) return value_->get<std::uint64_t>();
  if (value_ != nullptr && value_->is_number_float()) {
    if (const auto whole = exact_whole(value_->get<double>()); whole && *whole >= 0)
      return static_cast<std::uint64_t>(*whole);
  }
  fail("a whole number of at least 0: " + what);
  return 0;
}

std::optional<double> JsonValue::finite_number() const {
  if (value_ == nullptr || !value_->is_number()) return std::nullopt;
  const auto value = value_->get<double>();
  return std::isfinite(value) ? std::optional(value) : std::nullopt;
}

double JsonValue::number(const std::string& what) const {
  const std::optional<double> value = finite_number();
  if (!value) fail("a finite number: " + what);
  return value.value_or(0);
}

double JsonValue::number_in(double lowest, double highest, const std::string& what) const {
  const std::optional<double> value = finite_number();
  if (value && *value >= lowest && *value <= highest) return *value;
  fail("a number from " + display(lowest) + " to " + display(highest) + ": " + what);
  return lowest;
}

double JsonValue::positive(const std::string& what) const {
  const std::optional<double> value = finite_number();
  if (value && *value > 0) return *value;
  fail("a number above 0: " + what);
  return 1;
}

double JsonValue::non_negative(const std::string& what) const {
  const std::optional<double> value = finite_number();
  if (value && *value >= 0) return *value;
  fail("a number of at least 0: " + what);
  return 0;
}

bool JsonValue::boolean(const std::string& what) const {
  if (value_ != nullptr && value_->is_boolean()) return value_->get<bool>();
  fail("true or false: " + what);
  return false;
}

std::string JsonValue::text(const std::string& what) const {
  if (is_text()) return value_->get<std::string>();
  fail("a text: " + what);
  return {};
}

std::string JsonValue::as_text() const {
  if (value_ == nullptr) return {};
  return is_text() ? value_->get<std::string>()
                   : value_->dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string JsonValue::file_name(const std::string& what) const {
  if (!is_text()) {
    fail("a file name: " + what);
    return {};
  }
  auto name = value_->get<std::string>();
  if (const std::string objection = objection_to_name(name); !objection.empty()) {
    fail("a file name relative to the session folder, without \"..\": " + what + " (" + objection +
         ")");
  }
  return name;
}

std::vector<JsonValue> JsonValue::elements(const std::string& what) const {
  std::vector<JsonValue> values;
  if (!is_array()) {
    fail("a list: " + what);
    return values;
  }
  for (std::size_t i = 0; i < value_->size(); ++i) {
    values.push_back(JsonValue{&(*value_)[i], pointer_ + "/" + std::to_string(i), errors_});
  }
  return values;
}

std::vector<JsonValue> JsonValue::exactly(std::size_t count, const std::string& what) const {
  if (!is_array() || value_->size() != count) {
    fail("a list of " + std::to_string(count) + ": " + what);
    return std::vector<JsonValue>(count, *this);
  }
  return elements(what);
}

Mat3 JsonValue::matrix(const std::string& what) const {
  Mat3 matrix = Mat3::eye();
  if (!is_array() || value_->size() != 3) {
    fail("3 rows of 3 numbers: " + what);
    return matrix;
  }
  const std::vector<JsonValue> rows = elements(what);
  for (int row = 0; row < 3; ++row) {
    const std::vector<JsonValue> row_values = rows[static_cast<std::size_t>(row)].exactly(3, what);
    for (int col = 0; col < 3; ++col) {
      matrix(row, col) = row_values[static_cast<std::size_t>(col)].number(what);
    }
  }
  return matrix;
}

}  // namespace estimation
