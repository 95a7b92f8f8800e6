// Reading JSON with errors a person can act on. Private to this folder's .cpp files.
#pragma once

#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "estimation/base/linear.h"
#include "estimation/session/error.h"

namespace estimation {

// Ordered, so that a rewritten file keeps the order of the keys it had.
using Json = nlohmann::ordered_json;

// Errors: syntax (with line and column), a number no double holds, invalid UTF-8, a key given
// twice, nesting deeper than 64, more than 1000 keys in one object. Throws nothing.
Result<Json> parse_json(std::string_view text, const std::string& file);

// Collects the first failure of a document; readers go on with defaults and the caller asks once,
// at the end, so that reading code is a plain list of keys.
class JsonErrors {
 public:
  explicit JsonErrors(std::string file) : file_(std::move(file)) {}
  void add(const std::string& pointer, const std::string& expectation);
  const std::optional<InputError>& first() const { return first_; }

 private:
  std::string file_;
  std::optional<InputError> first_;
};

// A value of a document and its JSON pointer, or the place where a required one is missing. Every
// read takes `what`: what the value is, with its unit, for the message. A read that fails adds to
// the errors and returns a default. Borrows document and errors.
class JsonValue {
 public:
  JsonValue(const Json& root, JsonErrors& errors) : value_(&root), errors_(&errors) {}

  JsonValue at(const std::string& key) const;                   // required: reads fail if missing
  std::optional<JsonValue> find(const std::string& key) const;  // optional

  std::int64_t integer(std::int64_t lowest, std::int64_t highest, const std::string& what) const;
  int whole(int lowest, int highest, const std::string& what) const;
  std::uint64_t counter(const std::string& what) const;
  double number(const std::string& what) const;
  double number_in(double lowest, double highest, const std::string& what) const;
  double positive(const std::string& what) const;
  double non_negative(const std::string& what) const;
  bool boolean(const std::string& what) const;
  std::string text(const std::string& what) const;
  std::string as_text() const;                           // a text as it is, anything else as JSON
  std::string file_name(const std::string& what) const;  // relative, without ".."
  std::vector<JsonValue> elements(const std::string& what) const;
  std::vector<JsonValue> exactly(std::size_t count, const std::string& what) const;
  Mat3 matrix(const std::string& what) const;

  bool is_array() const { return value_ != nullptr && value_->is_array(); }
  bool is_object() const { return value_ != nullptr && value_->is_object(); }
  bool is_text() const { return value_ != nullptr && value_->is_string(); }
  const std::string& pointer() const { return pointer_; }

  // Adds "<what was found>; expected <expected>".
  void fail(const std::string& expected) const;

 private:
  JsonValue(const Json* value, std::string pointer, JsonErrors* errors)
      : value_(value), pointer_(std::move(pointer)), errors_(errors) {}
  std::optional<double> finite_number() const;

  const Json* value_ = nullptr;  // null: missing
  std::string pointer_;
  JsonErrors* errors_;
};

}  // namespace estimation
