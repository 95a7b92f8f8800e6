#include "rig/devices/aravis_features.h"

#include <arv.h>

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <sstream>

namespace rig {
namespace {

Fault fault_of(const GError& error) {
  if (error.domain == ARV_GC_ERROR)
    return error.code == ARV_GC_ERROR_ENUM_ENTRY_NOT_FOUND ? Fault::kUnsupported
                                                           : Fault::kReadBackMismatch;
  switch (error.code) {
    case ARV_DEVICE_ERROR_TIMEOUT:
    case ARV_DEVICE_ERROR_NOT_CONNECTED:
    case ARV_DEVICE_ERROR_TRANSFER_ERROR:
      return Fault::kDeviceLost;
    case ARV_DEVICE_ERROR_NOT_FOUND:
      return Fault::kNotFound;
    case ARV_DEVICE_ERROR_FEATURE_NOT_FOUND:
    case ARV_DEVICE_ERROR_WRONG_FEATURE:
      return Fault::kUnsupported;
    case ARV_DEVICE_ERROR_NOT_CONTROLLER:
    case ARV_DEVICE_ERROR_PROTOCOL_ERROR_ACCESS_DENIED:
      return Fault::kAccessDenied;
    case ARV_DEVICE_ERROR_PROTOCOL_ERROR_INVALID_PARAMETER:
      return Fault::kOutOfRange;
    default:
      return Fault::kProtocol;
  }
}

Result<void> not_taken(const std::string& name, const FeatureValue& wanted,
                       const FeatureValue& got) {
  return failure(Fault::kReadBackMismatch, "camera feature " + name + " was set to " +
                                               shown(wanted) + " but reads " + shown(got) +
                                               "; choose a value that the camera takes");
}

// Of a whole number, exact up to 2^53: more than any feature that is set here.
double as_number(std::int64_t value) { return static_cast<double>(value); }

const char* flag_text(bool value) { return value ? "true" : "false"; }

}  // namespace

std::string shown(const FeatureValue& value) {
  if (const auto* text = std::get_if<std::string>(&value)) return *text;
  constexpr int kDigits = 9;  // a float's own
  std::ostringstream digits;
  digits << std::setprecision(kDigits) << std::get<double>(value);
  return digits.str();
}

Result<void> take_error(GError** error, const std::string& what) {
  if (*error == nullptr) return {};
  Error taken{fault_of(**error), what + ": " + (*error)->message};
  g_clear_error(error);
  return tl::unexpected(std::move(taken));
}

bool AravisFeatures::has(const std::string& name) const {
  ArvDevice* device = arv_camera_get_device(camera_);
  if (arv_device_get_feature(device, name.c_str()) == nullptr) return false;
  GError* error = nullptr;
  const bool is_there = arv_device_is_feature_implemented(device, name.c_str(), &error) != 0 &&
                        error == nullptr &&
                        arv_device_is_feature_available(device, name.c_str(), &error) != 0;
  take_silence(&error, name);
  return is_there;
}

// Any other error is a feature that cannot be had now.
void AravisFeatures::take_silence(GError** error, const std::string& name) const {
  const Result<void> asked = take_error(error, "asking for " + name);
  if (!asked && asked.error().fault == Fault::kDeviceLost && answered_) answered_ = asked;
}

Result<void> AravisFeatures::answered() const { return answered_; }

std::vector<std::string> AravisFeatures::entries(const std::string& name) const {
  if (!has(name)) return {};
  GError* error = nullptr;
  guint count = 0;
  const char** texts =
      arv_camera_dup_available_enumerations_as_strings(camera_, name.c_str(), &count, &error);
  take_silence(&error, name);
  if (texts == nullptr) return {};
  std::vector<std::string> entries(texts, texts + count);
  g_free(texts);
  return entries;
}

bool AravisFeatures::has_entry(const std::string& name, const std::string& entry) const {
  const std::vector<std::string> all = entries(name);
  return std::find(all.begin(), all.end(), entry) != all.end();
}

Result<void> AravisFeatures::require(const std::string& name) const {
  if (has(name)) return {};
  return failure(Fault::kUnsupported, "the camera has no feature " + name);
}

Result<std::string> AravisFeatures::text(const std::string& name) const {
  if (auto found = require(name); !found) return tl::unexpected(found.error());
  GError* error = nullptr;
  const char* value = arv_camera_get_string(camera_, name.c_str(), &error);
  if (auto read = take_error(&error, "reading " + name); !read) return tl::unexpected(read.error());
  return std::string(value == nullptr ? "" : value);
}

Result<std::int64_t> AravisFeatures::integer(const std::string& name) const {
  if (auto found = require(name); !found) return tl::unexpected(found.error());
  GError* error = nullptr;
  const std::int64_t value = arv_camera_get_integer(camera_, name.c_str(), &error);
  if (auto read = take_error(&error, "reading " + name); !read) return tl::unexpected(read.error());
  return value;
}

// Enumerations and flags are integers too, to Aravis.
bool AravisFeatures::is_integer(const std::string& name) const {
  ArvGcNode* const node = arv_device_get_feature(arv_camera_get_device(camera_), name.c_str());
  return ARV_IS_GC_INTEGER(node) && !ARV_IS_GC_FLOAT(node) && !ARV_IS_GC_ENUMERATION(node) &&
         !ARV_IS_GC_BOOLEAN(node);
}

bool AravisFeatures::is_number(const std::string& name) const {
  ArvGcNode* const node = arv_device_get_feature(arv_camera_get_device(camera_), name.c_str());
  return is_integer(name) || ARV_IS_GC_FLOAT(node);
}

Result<double> AravisFeatures::number(const std::string& name) const {
  if (is_integer(name)) return integer(name).map(as_number);
  if (auto found = require(name); !found) return tl::unexpected(found.error());
  GError* error = nullptr;
  const double value = arv_camera_get_float(camera_, name.c_str(), &error);
  if (auto read = take_error(&error, "reading " + name); !read) return tl::unexpected(read.error());
  return value;
}

Result<std::pair<double, double>> AravisFeatures::number_bounds(const std::string& name) const {
  if (is_integer(name))
    return integer_bounds(name).map([](const auto& bounds) {
      return std::pair(as_number(bounds.first), as_number(bounds.second));
    });
  if (auto found = require(name); !found) return tl::unexpected(found.error());
  GError* error = nullptr;
  std::pair<double, double> bounds;
  arv_camera_get_float_bounds(camera_, name.c_str(), &bounds.first, &bounds.second, &error);
  if (auto read = take_error(&error, "reading the bounds of " + name); !read)
    return tl::unexpected(read.error());
  return bounds;
}

Result<std::pair<std::int64_t, std::int64_t>> AravisFeatures::integer_bounds(
    const std::string& name) const {
  if (auto found = require(name); !found) return tl::unexpected(found.error());
  GError* error = nullptr;
  gint64 least = 0;
  gint64 greatest = 0;
  arv_camera_get_integer_bounds(camera_, name.c_str(), &least, &greatest, &error);
  if (auto read = take_error(&error, "reading the bounds of " + name); !read)
    return tl::unexpected(read.error());
  return std::pair<std::int64_t, std::int64_t>(least, greatest);
}

Result<FeatureValue> AravisFeatures::value(const std::string& name) const {
  if (is_number(name)) return number(name).map([](double number) { return FeatureValue(number); });
  if (auto found = require(name); !found) return tl::unexpected(found.error());
  ArvGcNode* const node = arv_device_get_feature(arv_camera_get_device(camera_), name.c_str());
  GError* error = nullptr;
  const char* value = arv_gc_feature_node_get_value_as_string(ARV_GC_FEATURE_NODE(node), &error);
  if (auto read = take_error(&error, "reading " + name); !read) return tl::unexpected(read.error());
  return FeatureValue(value == nullptr ? "" : value);
}

Result<void> AravisFeatures::set_value(const std::string& name, const FeatureValue& value,
                                       double tolerance) const {
  if (const double* number = std::get_if<double>(&value))
    return set_number(name, *number, tolerance);
  if (auto found = require(name); !found) return found;
  const std::string text = std::get<std::string>(value);
  ArvGcNode* const node = arv_device_get_feature(arv_camera_get_device(camera_), name.c_str());
  GError* error = nullptr;
  arv_gc_feature_node_set_value_from_string(ARV_GC_FEATURE_NODE(node), text.c_str(), &error);
  if (auto written = take_error(&error, "setting " + name + " to " + text); !written)
    return written;
  const Result<FeatureValue> got = this->value(name);
  if (!got) return tl::unexpected(got.error());
  return *got == value ? Result<void>{} : not_taken(name, value, *got);
}

Result<void> AravisFeatures::set_text(const std::string& name, const std::string& value) const {
  if (auto found = require(name); !found) return found;
  GError* error = nullptr;
  arv_camera_set_string(camera_, name.c_str(), value.c_str(), &error);
  if (auto written = take_error(&error, "setting " + name + " to " + value); !written)
    return written;
  const Result<std::string> got = text(name);
  if (!got) return tl::unexpected(got.error());
  return *got == value ? Result<void>{} : not_taken(name, value, *got);
}

Result<void> AravisFeatures::set_integer(const std::string& name, std::int64_t value) const {
  if (auto found = require(name); !found) return found;
  GError* error = nullptr;
  arv_camera_set_integer(camera_, name.c_str(), value, &error);
  if (auto written = take_error(&error, "setting " + name + " to " + std::to_string(value));
      !written)
    return written;
  const Result<std::int64_t> got = integer(name);
  if (!got) return tl::unexpected(got.error());
  return *got == value ? Result<void>{} : not_taken(name, as_number(value), as_number(*got));
}

Result<void> AravisFeatures::set_flag(const std::string& name, bool value) const {
  if (auto found = require(name); !found) return found;
  GError* error = nullptr;
  arv_camera_set_boolean(camera_, name.c_str(), value ? TRUE : FALSE, &error);
  if (auto written = take_error(&error, "setting " + name); !written) return written;
  const bool got = arv_camera_get_boolean(camera_, name.c_str(), &error) != FALSE;
  if (auto read = take_error(&error, "reading " + name); !read) return read;
  return got == value ? Result<void>{} : not_taken(name, flag_text(value), flag_text(got));
}

Result<void> AravisFeatures::set_number(const std::string& name, double value,
                                        double tolerance) const {
  if (auto found = require(name); !found) return found;
  GError* error = nullptr;
  if (is_integer(name))
    arv_camera_set_integer(camera_, name.c_str(), std::llround(value), &error);
  else
    arv_camera_set_float(camera_, name.c_str(), value, &error);
  if (auto written = take_error(&error, "setting " + name + " to " + std::to_string(value));
      !written)
    return written;
  const Result<double> got = number(name);
  if (!got) return tl::unexpected(got.error());
  return std::abs(*got - value) <= tolerance ? Result<void>{} : not_taken(name, value, *got);
}

Result<void> AravisFeatures::execute(const std::string& name) const {
  if (auto found = require(name); !found) return found;
  GError* error = nullptr;
  arv_camera_execute_command(camera_, name.c_str(), &error);
  return take_error(&error, "executing " + name);
}

Result<void> AravisFeatures::set_text_if_present(const std::string& name,
                                                 const std::string& value) const {
  return has(name) ? set_text(name, value) : Result<void>{};
}

Result<void> AravisFeatures::keep_text(const std::string& name, const std::string& value) const {
  if (!has_entry(name, value)) return {};
  const Result<std::string> present = text(name);
  if (!present && present.error().fault == Fault::kDeviceLost)
    return tl::unexpected(present.error());
  return !present || *present == value ? Result<void>{} : set_text(name, value);
}

Result<void> AravisFeatures::keep_flag(const std::string& name, bool value) const {
  const Result<FeatureValue> present = this->value(name);
  if (!present) return tl::unexpected(present.error());
  return *present == FeatureValue(flag_text(value)) ? Result<void>{} : set_flag(name, value);
}

bool AravisFeatures::set_entry_if_present(const std::string& name, const std::string& value) const {
  return has_entry(name, value) && set_text(name, value).has_value();
}

Result<void> advising(Result<void> result, const std::string& remedy) {
  if (!result && result.error().fault != Fault::kDeviceLost) result.error().detail += "; " + remedy;
  return result;
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text.empty() ? "none" : text;
}

}  // namespace rig
