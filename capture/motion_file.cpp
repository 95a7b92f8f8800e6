#include "capture/motion_file.h"

#include <cstddef>
#include <cstring>
#include <system_error>
#include <vector>

#include "estimation/session/frame_io.h"
#include "nlohmann/json.hpp"

namespace capture {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

Json describe(const estimation::LocalChange& place) {
  return {{"row_px", place.row_px},           {"col_px", place.col_px},
          {"height_px", place.height_px},     {"width_px", place.width_px},
          {"height_frac", place.height_frac}, {"change_frac", place.change_frac},
          {"sd_frac", place.sd_frac}};
}

Json describe(const estimation::BriefChange& change) {
  Json json{{"patterns", change.patterns},
            {"elapsed_s", change.elapsed_s},
            {"change_frac", change.change_frac},
            {"is_everywhere", change.is_everywhere}};
  if (!change.is_everywhere) {
    json["row_px"] = change.row_px;
    json["col_px"] = change.col_px;
  }
  return json;
}

Json describe(const estimation::WrongPicture& wrong) {
  Json json{
      {"pattern", wrong.pattern}, {"bracket", wrong.bracket}, {"share_frac", wrong.share_frac}};
  if (wrong.seen_pattern) json["seen_pattern"] = *wrong.seen_pattern;
  if (wrong.or_pattern) json["or_pattern"] = *wrong.or_pattern;
  return json;
}

Json describe(const WatchedPictures& pictures) {
  Json json{{"text", pictures.check.text()},
            {"checked", pictures.check.checked_count},
            {"wrong", Json::array()},
            {"retaken", Json::array()},
            {"unchecked", Json::array()}};
  for (const auto& wrong : pictures.check.wrong) json["wrong"].push_back(describe(wrong));
  for (const auto& wrong : pictures.retaken) json["retaken"].push_back(describe(wrong));
  for (const auto& each : pictures.check.unchecked)
    json["unchecked"].push_back(
        {{"pattern", each.pattern}, {"bracket", each.bracket}, {"why", each.why}});
  return json;
}

Json describe(const estimation::Repeat& repeat, const std::optional<estimation::Motion>& motion) {
  Json json{{"elapsed_s", repeat.elapsed_s}};
  if (!repeat.change) {
    json["objection"] = repeat.objection;
    return json;
  }
  const estimation::FrameChange& change = *repeat.change;
  json["shift_px"] = {{"row", change.shift_row_px},
                      {"row_sd", change.shift_row_sd_px},
                      {"col", change.shift_col_px},
                      {"col_sd", change.shift_col_sd_px},
                      {"local_rms", change.local_shift_px}};
  json["stripes_projector_px"] = motion->stripes_px;
  json["stripes_sd_projector_px"] = motion->stripes_sd_px;
  if (motion->mm) json["head_mm"] = *motion->mm;
  if (motion->sd_mm) json["head_sd_mm"] = *motion->sd_mm;
  if (repeat.by_surface) {
    const auto& t = repeat.by_surface->translation_mm;
    const auto& sd = repeat.by_surface->sd_mm;
    json["translation_mm"] = {t[0], t[1], t[2]};
    json["translation_sd_mm"] = {sd[0], sd[1], sd[2]};
  }
  json["light_frac"] = change.light_frac;
  json["light_sd_frac"] = change.light_sd_frac;
  json["ambient_frac"] = change.ambient_frac;
  json["ambient_sd_frac"] = change.ambient_sd_frac;
  json["residual_frac"] = change.residual_frac;
  json["local_changes"] = Json::array();
  for (const estimation::LocalChange& place : change.local_changes)
    json["local_changes"].push_back(describe(place));
  return json;
}

}  // namespace

std::string format_motion(const WatchedMotion& motion) {
  const estimation::MotionReport& report = motion.report;
  Json json{{"verdict", to_string(report.verdict)},
            {"verdict_ms", std::chrono::duration<double, std::milli>(motion.verdict_time).count()},
            {"text", report.text},
            {"reasons", report.reasons},
            {"pattern", motion.pattern},
            {"repeats", Json::array()},
            {"brief_changes", Json::array()},
            {"pictures", describe(motion.pictures)}};
  for (std::size_t i = 0; i < report.repeats.size(); ++i)
    json["repeats"].push_back(describe(report.repeats[i], report.motions[i]));
  for (const estimation::BriefChange& change : report.brief_changes)
    json["brief_changes"].push_back(describe(change));
  return json.dump(2) + "\n";
}

estimation::Result<void> write_motion(const fs::path& session, const WatchedMotion& motion) {
  const fs::path path = session / "report" / "motion.json";
  std::error_code error;
  fs::create_directories(path.parent_path(), error);
  if (error)
    return tl::unexpected(estimation::InputError{estimation::InputFault::kUnwritable, path.string(),
                                                 "", error.message()});
  const std::string json = format_motion(motion);
  std::vector<std::byte> bytes(json.size());
  std::memcpy(bytes.data(), json.data(), json.size());
  return estimation::write_file_atomically(path, bytes);
}

}  // namespace capture
