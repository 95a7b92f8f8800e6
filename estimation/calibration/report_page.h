// A calibration's report: its text, and one page for a browser.
#pragma once

#include <filesystem>
#include <string>

#include "estimation/session/error.h"

namespace estimation {

// Appends what printf would print, up to 255 characters.
[[gnu::format(printf, 2, 3)]] void print(std::string& text, const char* format, ...);

// Writes report.html into `folder`: the text, and under it every PNG that is there, by name.
Result<void> write_report_page(const std::filesystem::path& folder, const std::string& title,
                               const std::string& text);

}  // namespace estimation
