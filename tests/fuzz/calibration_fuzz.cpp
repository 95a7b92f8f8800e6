// calibration.json, by the reader of a rig and by the writer that keeps what it does not know.
#include "estimation/calibration/calibration_file.h"
#include "estimation/session/manifest.h"
#include "tests/fuzz/fuzz_target.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text = fuzz::text_of(data, size);
  const auto calibration = estimation::parse_calibration(text, "c/calibration.json");
  if (!calibration) fuzz::require_message(calibration.error().text(), "c/calibration.json");
  // The writer reads the text by itself, refused or not.
  if (!calibration && !fuzz::is_in_share(data, size)) return 0;
  static_cast<void>(estimation::extra_calibration_keys(text));
  const auto rewritten = estimation::format_calibration(
      text, calibration.value_or(estimation::Calibration{}),
      {.part = estimation::CalibrationPart::kGeometry, .json = "{\"views\": 12}"});
  if (!rewritten || !calibration) return 0;
  estimation::check(estimation::parse_calibration(*rewritten, "c/calibration.json").has_value(),
                    "what was accepted is accepted when written again");
  return 0;
}
