// The calibration file that a rig file names: the session format's "calibration" object, and beside
// its keys, under "calibrated", when and from what each part was made and how well it fits.
// Readers of the format keep and ignore those.
#pragma once

#include <chrono>
#include <filesystem>
#include <string>
#include <string_view>

#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace estimation {

enum class CalibrationPart { kGeometry, kRadiometry };

// What a part says of itself: a JSON object's text ("date", "sessions", residuals ...).
struct PartRecord {
  CalibrationPart part = CalibrationPart::kGeometry;
  std::string json;
};

// `before` is the older file's text, or empty: the other part and unknown keys are kept from it.
// `calibration` gives the part's own keys. Errors: kInvalid where `before` is no calibration.
Result<std::string> format_calibration(std::string_view before, const Calibration& calibration,
                                       const PartRecord& record);

// Writes `text`, whole or not at all. A file of that name is first kept under a name with its own
// date ("calibration.20260131-142501.json"), never overwritten. Returns that name, or empty.
Result<std::filesystem::path> write_calibration(const std::filesystem::path& path,
                                                const std::string& text);

// A text beside it, whole or not at all; its folder is made if absent.
Result<void> save_text(const std::filesystem::path& path, const std::string& text);

// What the file holds beside the format's keys, as Manifest::other_keys wants it, so that sessions
// carry it along; empty if there is nothing or the text is no JSON object.
std::string extra_calibration_keys(std::string_view text);

// "20260131-142501", UTC, for names; "2026-01-31T14:25:01Z" for people and files.
std::string date_stamp(std::chrono::system_clock::time_point time);
std::string date_text(std::chrono::system_clock::time_point time);

}  // namespace estimation
