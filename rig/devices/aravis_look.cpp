#include "rig/devices/aravis_look.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace rig {
namespace {

// SFNC's names and those of before it; what enables ahead of what it enables.
constexpr std::array<const char*, 8> kShapeNames{
    "BinningHorizontalMode", "BinningVerticalMode",  "BinningVertical", "BinningHorizontal",
    "DecimationVertical",    "DecimationHorizontal", "ReverseX",        "ReverseY"};
// GammaSelector is Basler's, and no selector: it chooses the curve.
constexpr std::array<const char*, 5> kLevelNames{"GammaSelector", "GammaEnable", "Gamma",
                                                 "LUTEnable", "DigitalShift"};
struct SelectedNames {
  const char* selector;
  std::array<const char*, 3> names;
};
constexpr std::array<SelectedNames, 3> kSelectedNames{
    {{"GainSelector", {"Gain", "GainRaw", "GainAbs"}},
     {"BlackLevelSelector", {"BlackLevel", "BlackLevelRaw", "BlackLevelAbs"}},
     {"BalanceRatioSelector", {"BalanceRatio", "BalanceRatioRaw", "BalanceRatioAbs"}}}};

// Of numbers: for the camera's own rounding.
constexpr double kRelativeTolerance = 1e-4;
constexpr double kAbsoluteTolerance = 1e-6;

double tolerance_of(const FeatureValue& value) {
  const double* number = std::get_if<double>(&value);
  return number == nullptr ? 0 : kAbsoluteTolerance + kRelativeTolerance * std::abs(*number);
}

bool is_same(const FeatureValue& a, const FeatureValue& b) {
  const double* number = std::get_if<double>(&a);
  const double* other = std::get_if<double>(&b);
  if (number == nullptr || other == nullptr) return a == b;
  return std::abs(*number - *other) <= tolerance_of(a);
}

bool is_shape(const FeatureState& state) {
  return std::any_of(kShapeNames.begin(), kShapeNames.end(),
                     [&](const char* name) { return state.name == name; });
}

template <typename T>
bool is_lost(const Result<T>& result) {
  return !result && result.error().fault == Fault::kDeviceLost;
}

// Any other error is a feature that cannot be had, which is no reason to refuse the camera.
Result<void> unless_lost(const Result<void>& result) {
  return is_lost(result) ? result : Result<void>{};
}

Result<void> select(const AravisFeatures& features, const std::string& selector,
                    const std::string& entry) {
  const Result<std::string> present = features.text(selector);
  if (!present) return tl::unexpected(present.error());
  return *present == entry ? Result<void>{} : features.set_text(selector, entry);
}

// One call of read_look().
class LookReader {
 public:
  explicit LookReader(const AravisFeatures& features) : features_(features) {}

  Result<CameraLook> run() && {
    for (const char* name : kShapeNames)
      if (auto read = take(name); !read) return tl::unexpected(read.error());
    for (const char* name : kLevelNames)
      if (auto read = take(name); !read) return tl::unexpected(read.error());
    for (const SelectedNames& selected : kSelectedNames)
      if (auto read = take_selected(selected); !read) return tl::unexpected(read.error());
    return std::move(look_);
  }

 private:
  Result<void> take(const char* name, const char* selector = "", const std::string& entry = "");
  Result<void> take_entry(const SelectedNames& selected, const std::string& entry);
  Result<void> take_selected(const SelectedNames& selected);

  const AravisFeatures& features_;
  CameraLook look_;
};

Result<void> LookReader::take(const char* name, const char* selector, const std::string& entry) {
  if (!features_.has(name)) return features_.answered();
  Result<FeatureValue> value = features_.value(name);
  if (is_lost(value)) return tl::unexpected(value.error());
  if (value) look_.push_back({selector, entry, name, std::move(*value)});
  return {};
}

Result<void> LookReader::take_entry(const SelectedNames& selected, const std::string& entry) {
  if (const auto set = select(features_, selected.selector, entry); !set) return unless_lost(set);
  for (const char* name : selected.names)
    if (auto read = take(name, selected.selector, entry); !read) return read;
  return {};
}

// The selector itself comes last, so that it is also restored last.
Result<void> LookReader::take_selected(const SelectedNames& selected) {
  const Result<std::string> present = features_.text(selected.selector);
  if (is_lost(present)) return tl::unexpected(present.error());
  std::vector<std::string> entries;
  if (present) entries = features_.entries(selected.selector);
  if (entries.empty()) {
    for (const char* name : selected.names)
      if (auto read = take(name); !read) return read;
    return features_.answered();
  }
  // "All", "AnalogAll": to write one may change all the others, so it is restored ahead of them.
  std::stable_partition(entries.begin(), entries.end(), [](const std::string& entry) {
    return entry.find("All") != std::string::npos;
  });
  for (const std::string& entry : entries)
    if (auto read = take_entry(selected, entry); !read) return read;
  if (auto back = unless_lost(select(features_, selected.selector, *present)); !back) return back;
  return take(selected.selector);
}

Result<void> restore(const AravisFeatures& features, const FeatureState& was) {
  if (!was.selector.empty())
    if (const auto set = select(features, was.selector, was.entry); !set) return unless_lost(set);
  const Result<FeatureValue> present = features.value(was.name);
  if (is_lost(present)) return tl::unexpected(present.error());
  if (!present || is_same(was.value, *present)) return {};
  const double tolerance = tolerance_of(was.value);
  Result<void> set = features.set_value(was.name, was.value, tolerance);
  // A camera that cuts off what lies between its steps may fall to the one below its own value.
  if (const double* number = std::get_if<double>(&was.value);
      number != nullptr && !set && set.error().fault == Fault::kReadBackMismatch)
    set = features.set_value(was.name, *number + tolerance / 2, tolerance);
  return unless_lost(set);
}

std::string place_of(const FeatureState& state) {
  return state.selector.empty() ? state.name
                                : state.name + " under " + state.selector + " " + state.entry;
}

Result<void> restore_if(const AravisFeatures& features, const CameraLook& was, bool shape) {
  for (const FeatureState& state : was)
    if (is_shape(state) == shape)
      if (auto done = restore(features, state); !done) return done;
  return {};
}

}  // namespace

Result<CameraLook> read_look(const AravisFeatures& features) { return LookReader(features).run(); }

Result<void> restore_shape(const AravisFeatures& features, const CameraLook& was) {
  return restore_if(features, was, true);
}

Result<void> restore_levels(const AravisFeatures& features, const CameraLook& was) {
  return restore_if(features, was, false);
}

std::optional<std::string> look_difference(const CameraLook& was, const CameraLook& is) {
  for (const FeatureState& then : was) {
    const auto now = std::find_if(is.begin(), is.end(), [&](const FeatureState& state) {
      return state.name == then.name && state.selector == then.selector &&
             state.entry == then.entry;
    });
    if (now == is.end()) return place_of(then) + " cannot be read and was " + shown(then.value);
    if (!is_same(then.value, now->value))
      return place_of(then) + " is " + shown(now->value) + " and was " + shown(then.value);
  }
  return std::nullopt;
}

}  // namespace rig
