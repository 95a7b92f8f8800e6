// GenICam features as Results: every write is read back. Internal to the Aravis adapter.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "rig/fault.h"

struct _ArvCamera;
// NOLINTNEXTLINE(bugprone-reserved-identifier): the name that GLib gave it
struct _GError;

namespace rig {

// Takes what an Aravis call reported, if anything; `what` names the call.
Result<void> take_error(_GError** error, const std::string& what);

// Numbers as they are, all else as text: Aravis' text of a number has six digits.
using FeatureValue = std::variant<double, std::string>;

// Borrows the camera. Every call is a round trip on the network, 2.5 s when the camera is dead.
// Errors of all: kUnsupported (no such feature, or no such value of it), kReadBackMismatch,
// kAccessDenied, kDeviceLost, kProtocol; each names the feature.
class AravisFeatures {
 public:
  explicit AravisFeatures(_ArvCamera* camera) : camera_(camera) {}

  // False also where the camera did not answer, which answered() then tells.
  bool has(const std::string& name) const;
  // What an enumeration can be set to now; empty where there is none.
  std::vector<std::string> entries(const std::string& name) const;
  bool has_entry(const std::string& name, const std::string& entry) const;
  // Of has(), entries() and has_entry(), so far: whoever left out what is not there asks in the
  // end. Errors: kDeviceLost.
  Result<void> answered() const;

  Result<std::string> text(const std::string& name) const;
  Result<std::int64_t> integer(const std::string& name) const;
  // Numbers are floats or integers, which one it is differs from maker to maker.
  bool is_number(const std::string& name) const;
  Result<double> number(const std::string& name) const;
  // Least and greatest value.
  Result<std::pair<double, double>> number_bounds(const std::string& name) const;
  Result<std::pair<std::int64_t, std::int64_t>> integer_bounds(const std::string& name) const;

  // Of any kind.
  Result<FeatureValue> value(const std::string& name) const;

  Result<void> set_text(const std::string& name, const std::string& value) const;
  Result<void> set_integer(const std::string& name, std::int64_t value) const;
  Result<void> set_flag(const std::string& name, bool value) const;
  // The camera may round to `tolerance`.
  Result<void> set_number(const std::string& name, double value, double tolerance) const;
  // Of any kind; a number may be rounded to `tolerance`.
  Result<void> set_value(const std::string& name, const FeatureValue& value,
                         double tolerance) const;
  Result<void> execute(const std::string& name) const;
  // Nothing where the camera has no such feature.
  Result<void> set_text_if_present(const std::string& name, const std::string& value) const;
  // Written only if it differs: nothing where the camera has no such value, has it, or does not
  // tell.
  Result<void> keep_text(const std::string& name, const std::string& value) const;
  // Written only if it differs.
  Result<void> keep_flag(const std::string& name, bool value) const;
  // False where the camera has no such value, or does not take it.
  bool set_entry_if_present(const std::string& name, const std::string& value) const;

 private:
  Result<void> require(const std::string& name) const;
  bool is_integer(const std::string& name) const;
  void take_silence(_GError** error, const std::string& name) const;
  _ArvCamera* camera_;
  mutable Result<void> answered_;  // the first that was not
};

// "7.398151", "Off".
std::string shown(const FeatureValue& value);

// What to do about an error, unless the device is gone: that says so itself.
Result<void> advising(Result<void> result, const std::string& remedy);

// "a, b, c", or "none".
std::string joined(const std::vector<std::string>& words);

// Runs steps until one fails.
template <typename... Steps>
Result<void> in_order(Steps&&... steps) {
  Result<void> result;
  static_cast<void>(((result = steps(), result.has_value()) && ...));
  return result;
}

}  // namespace rig
