#include "tests/bench/report.h"

#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>

namespace bench {
namespace {

std::string joined(const std::vector<std::string>& cells, const std::string& separator) {
  std::string line;
  for (const std::string& cell : cells) {
    if (!line.empty()) line += separator;
    line += cell;
  }
  return line;
}

std::string csv(const Table& table) {
  std::string text = joined(table.columns, ",") + "\n";
  for (const auto& row : table.rows) text += joined(row, ",") + "\n";
  return text;
}

}  // namespace

std::string digits(double value, int significant) {
  if (std::isnan(value)) return "-";
  std::array<char, 48> text{};
  std::snprintf(text.data(), text.size(), "%.*g", significant, value);
  return text.data();
}

std::string percent(double fraction, int decimals) {
  if (std::isnan(fraction)) return "-";
  std::array<char, 48> text{};
  std::snprintf(text.data(), text.size(), "%.*f", decimals, 100 * fraction);
  return text.data();
}

Report::Report(std::filesystem::path folder) : folder_(std::move(folder)) {
  std::error_code error;
  std::filesystem::create_directories(folder_, error);
}

void Report::text(const std::string& paragraph) { std::cout << paragraph << "\n\n" << std::flush; }

void Report::fail(const std::string& sentence) {
  text(std::string("FAILED: ").append(sentence));
  has_failed_ = true;
}

void Report::table(const Table& table, bool is_printed) {
  const std::string contents = csv(table);
  write(table.name + ".csv", contents.data(), contents.size());
  if (!is_printed) return;
  std::cout << "**" << table.title << "**\n\n| " << joined(table.columns, " | ") << " |\n|";
  for (std::size_t i = 0; i < table.columns.size(); ++i) std::cout << "---|";
  std::cout << "\n";
  for (const auto& row : table.rows) std::cout << "| " << joined(row, " | ") << " |\n";
  std::cout << "\n" << std::flush;
}

void Report::picture(const std::string& name, const Scene& scene) {
  const std::string vector_text = svg(scene);
  write(name + ".svg", vector_text.data(), vector_text.size());
  const std::vector<unsigned char> bytes = png(scene);
  write(name + ".png", bytes.data(), bytes.size());
}

void Report::write(const std::string& name, const void* data, std::size_t size) {
  std::ofstream stream(folder_ / name, std::ios::binary);
  stream.write(static_cast<const char*>(data), static_cast<std::streamsize>(size));
  if (stream) return;
  std::cerr << "ssrig-bench: cannot write " << (folder_ / name).string() << "\n";
  has_failed_ = true;
}

}  // namespace bench
