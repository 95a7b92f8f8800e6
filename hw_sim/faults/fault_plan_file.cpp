#include <toml++/toml.h>

#include <map>
#include <string>

#include "hw_sim/faults/fault_plan.h"
#include "rig/toml_text.h"

namespace hw_sim {
namespace {

constexpr double kDurationLimit_ms = 600'000;

// One plan being read: every error names the place.
class Reader {
 public:
  explicit Reader(const std::filesystem::path& file) : file_(file) {}

  rig::Result<FaultPlan> read(const toml::table& document) {
    FaultPlan plan;
    for (const auto& [key, node] : document) {
      if (key.str() == "seed") {
        const auto seed = node.value_exact<std::int64_t>();
        if (!seed || *seed < 0) return error(node, "seed is no whole number from 0");
        plan.seed = static_cast<std::uint64_t>(*seed);
      } else if (key.str() == "faults") {
        const toml::array* entries = node.as_array();
        if (entries == nullptr)
          return error(node, "faults is no list; write faults = [{fault = \"frame_lost\", ...}]");
        for (const toml::node& entry : *entries) {
          auto fault = read_fault(entry);
          if (!fault) return tl::unexpected(fault.error());
          plan.faults.push_back(*fault);
        }
      } else {
        return error(node,
                     "unknown key " + std::string(key.str()) + "; a plan has seed and faults");
      }
    }
    return plan;
  }

 private:
  tl::unexpected<rig::Error> error(const toml::node& node, const std::string& text) const {
    return rig::failure(
        rig::Fault::kConfiguration,
        file_.string() + ":" + std::to_string(node.source().begin.line) + ": " + text);
  }

  rig::Result<PlannedFault> read_fault(const toml::node& node) const {
    const toml::table* entry = node.as_table();
    const auto name = entry != nullptr ? (*entry)["fault"].value<std::string>() : std::nullopt;
    if (!name) return error(node, "an entry without a name; write {fault = \"frame_lost\", ...}");
    const auto kind = parse_fault_kind(*name);
    if (!kind) return error(node, "\"" + *name + "\" is no fault; there are " + all_names());
    PlannedFault fault = default_fault(*kind);
    for (const auto& [key, value] : *entry) {
      if (key.str() == "fault") continue;
      if (auto read = read_key(std::string(key.str()), value, fault); !read)
        return tl::unexpected(read.error());
    }
    return check(*entry, fault);
  }

  rig::Result<void> read_key(const std::string& key, const toml::node& node,
                             PlannedFault& fault) const {
    FaultPlace place = fault.place.value_or(FaultPlace{});
    if (key == "slot") return read_slot(node, fault);
    if (key == "at") return read_at(node, fault);
    if (key == "bracket") {
      const auto bracket = whole_number(node, 0, 7);
      if (!bracket || site_of(fault.kind) != FaultSite::kShot)
        return error(node, bracket ? std::string(to_string(fault.kind)) +
                                         " concerns a whole pattern; leave bracket out"
                                   : "bracket is no whole number from 0 to 7");
      place.bracket = *bracket;
      fault.place = place;
      return {};
    }
    if (key == "count") {
      const auto count = whole_number(node, 1, 1'000'000);
      if (!count) return error(node, "count is no whole number from 1 to 1000000");
      fault.count = *count;
      return {};
    }
    return read_amount(key, node, fault);
  }

  rig::Result<void> read_slot(const toml::node& node, PlannedFault& fault) const {
    const auto slot = whole_number(node, 0, 9999);
    if (!slot) return error(node, "slot is no whole number from 0 to 9999");
    set_showing(showing_of_slot(*slot), fault);
    return {};
  }

  rig::Result<void> read_at(const toml::node& node, PlannedFault& fault) const {
    const std::string at = node.value<std::string>().value_or("");
    if (at != "idle" && at != "priming") return error(node, "at is \"idle\" or \"priming\"");
    if (at == "idle" && !is_possible_idle(fault.kind))
      return error(
          node, std::string(to_string(fault.kind)) + " cannot happen while idle; give it a slot");
    set_showing(at == "idle" ? kIdle : kPrimingShowing, fault);
    return {};
  }

  static void set_showing(int showing, PlannedFault& fault) {
    FaultPlace place = fault.place.value_or(FaultPlace{});
    place.showing = showing;
    fault.place = place;
  }

  rig::Result<void> read_amount(const std::string& key, const toml::node& node,
                                PlannedFault& fault) const {
    struct Amount {
      double least, greatest;
      bool is_its;  // of this kind of fault
    };
    const FaultKind kind = fault.kind;
    const bool has_duration = default_fault(kind).duration.count() > 0;
    const std::map<std::string, Amount, std::less<>> amounts = {
        {"rate_frac", {0, 1, true}},
        {"duration_ms", {0, kDurationLimit_ms, has_duration}},
        {"loss_frac", {0, 1, kind == FaultKind::kPacketLoss}},
        {"level_frac", {0, 1, kind == FaultKind::kPhotodiodeDim}},
        {"gamma_exponent", {0.1, 10, kind == FaultKind::kGammaWrong}}};
    const auto amount = amounts.find(key);
    if (amount == amounts.end() || !amount->second.is_its) {
      std::string known = "slot, at, bracket, count";
      for (const auto& [name, each] : amounts)
        if (each.is_its) known.append(", ").append(name);
      return error(node, std::string(to_string(kind)) + " has no " + key + "; it has " + known);
    }
    const auto value = node.value<double>();
    const auto& [least, greatest, unused] = amount->second;
    if (!value || !(*value >= least && *value <= greatest))
      return error(node, key + " is no number from " + number(least) + " to " + number(greatest));
    if (key == "rate_frac") fault.rate_frac = *value;
    if (key == "duration_ms")
      fault.duration = std::chrono::milliseconds(static_cast<std::int64_t>(*value));
    if (key == "loss_frac") fault.loss_frac = *value;
    if (key == "level_frac") fault.level_frac = *value;
    if (key == "gamma_exponent") fault.gamma_exponent = *value;
    return {};
  }

  rig::Result<PlannedFault> check(const toml::table& entry, PlannedFault fault) const {
    const bool has_slot = entry.contains("slot"), has_at = entry.contains("at"),
               has_rate = entry.contains("rate_frac");
    if (int{has_slot} + int{has_at} + int{has_rate} != 1)
      return error(entry, std::string(to_string(fault.kind)) +
                              " needs one of slot = 17, at = \"priming\" and rate_frac = 0.01");
    if (has_rate) {
      if (entry.contains("bracket"))
        return error(entry, "bracket goes with slot; a rate concerns all brackets");
      fault.place.reset();
      if (!entry.contains("count")) fault.count = 1'000'000;
    }
    return fault;
  }

  static std::optional<int> whole_number(const toml::node& node, int least, int greatest) {
    const auto value = node.value_exact<std::int64_t>();
    if (!value || *value < least || *value > greatest) return std::nullopt;
    return static_cast<int>(*value);
  }

  static std::string number(double value) {
    std::string text = std::to_string(value);
    text.erase(text.find_last_not_of('0') + 1);
    if (text.back() == '.') text.pop_back();
    return text;
  }

  static std::string all_names() {
    std::string names;
    for (int kind = 0; kind < kFaultKindCount; ++kind)
      names.append(kind == 0 ? "" : ", ").append(to_string(static_cast<FaultKind>(kind)));
    return names;
  }

  const std::filesystem::path& file_;
};

}  // namespace

rig::Result<FaultPlan> parse_fault_plan(std::string_view toml, const std::filesystem::path& file) {
  const rig::Result<toml::table> document = rig::parse_toml(toml, file);
  if (!document) return tl::unexpected(document.error());
  return Reader(file).read(*document);
}

rig::Result<FaultPlan> read_fault_plan(const std::filesystem::path& file) {
  const rig::Result<std::string> text = rig::read_text(file, "name an existing plan of faults");
  if (!text) return tl::unexpected(text.error());
  return parse_fault_plan(*text, file);
}

}  // namespace hw_sim
