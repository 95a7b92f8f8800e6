// Where measured tables and pictures go: Markdown on standard output, CSV, SVG and PNG in a folder.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "tests/bench/scene.h"

namespace bench {

struct Table {
  std::string name;   // of the CSV file, without ending
  std::string title;  // above the Markdown table
  std::vector<std::string> columns;
  std::vector<std::vector<std::string>> rows = {};
};

// With that many significant digits; "-" for NaN.
std::string digits(double value, int significant = 3);
std::string percent(double fraction, int decimals = 2);  // without the sign

// Not thread-safe.
class Report {
 public:
  explicit Report(std::filesystem::path folder);  // made if it is not there

  void text(const std::string& paragraph);
  // `is_printed`: also as Markdown; long tables go to their CSV alone.
  void table(const Table& table, bool is_printed = true);
  void picture(const std::string& name, const Scene& scene);
  // A result that must not be; the program then ends with an error.
  void fail(const std::string& sentence);
  const std::filesystem::path& folder() const { return folder_; }
  bool has_failed() const { return has_failed_; }  // or a file could not be written

 private:
  void write(const std::string& name, const void* data, std::size_t size);

  std::filesystem::path folder_;
  bool has_failed_ = false;
};

}  // namespace bench
