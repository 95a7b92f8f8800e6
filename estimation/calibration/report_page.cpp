#include "estimation/calibration/report_page.h"

#include <algorithm>
#include <cstdarg>
#include <cstdio>
#include <system_error>
#include <vector>

#include "estimation/calibration/calibration_file.h"

namespace estimation {
namespace {

namespace fs = std::filesystem;

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '<')
      out += "&lt;";
    else if (c == '&')
      out += "&amp;";
    else
      out += c;
  }
  return out;
}

std::vector<std::string> pictures_in(const fs::path& folder) {
  std::vector<std::string> names;
  std::error_code unreadable;  // then there are no pictures to show
  for (const auto& entry : fs::directory_iterator(folder, unreadable))
    if (entry.path().extension() == ".png") names.push_back(entry.path().filename().string());
  std::ranges::sort(names);
  return names;
}

}  // namespace

void print(std::string& text, const char* format, ...) {
  char line[256];
  std::va_list arguments;
  va_start(arguments, format);
  std::vsnprintf(line, sizeof line, format, arguments);
  va_end(arguments);
  text += line;
}

Result<void> write_report_page(const fs::path& folder, const std::string& title,
                               const std::string& text) {
  std::string page =
      "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<title>" + escaped(title) +
      "</title>\n<style>\nbody { font-family: sans-serif; margin: 2rem; color: #222; }\n"
      "pre { font-size: 0.85rem; line-height: 1.4; overflow-x: auto; }\n"
      "main { display: flex; flex-wrap: wrap; gap: 1.5rem; align-items: flex-start; }\n"
      "img { max-width: min(100%, 42rem); border: 1px solid #ddd; }\n</style>\n<h1>" +
      escaped(title) + "</h1>\n<pre>" + escaped(text) + "</pre>\n<main>\n";
  for (const std::string& name : pictures_in(folder))
    page.append("<img src=\"").append(name).append("\" alt=\"").append(name).append("\">\n");
  return save_text(folder / "report.html", page.append("</main>\n</html>\n"));
}

}  // namespace estimation
