// Sessions in a folder of their own for a test.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/temporary_folder.h"

namespace estimation {

inline std::filesystem::path example_session() { return SSRIG_SESSION_EXAMPLE; }

using test_support::TemporaryFolder;

inline std::string text_of(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

inline void write_text(const std::filesystem::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

inline std::vector<std::byte> bytes_of(const std::string& text) {
  std::vector<std::byte> bytes;
  for (const char c : text) bytes.push_back(static_cast<std::byte>(c));
  return bytes;
}

inline void write_bytes(const std::filesystem::path& path, const std::vector<std::byte>& bytes) {
  std::string text;
  for (const std::byte byte : bytes) text += static_cast<char>(byte);
  write_text(path, text);
}

inline nlohmann::json example_document() {
  return nlohmann::json::parse(text_of(example_session() / "session.json"));
}

// A copy of the example that a test may break.
class BreakableSession {
 public:
  BreakableSession() : document_(example_document()) {
    std::filesystem::copy(example_session() / "frames", path() / "frames");
    save();
  }
  std::filesystem::path path() const { return folder_.path(); }
  nlohmann::json& document() { return document_; }
  void save() const { write_text(path() / "session.json", document_.dump()); }

 private:
  TemporaryFolder folder_;
  nlohmann::json document_;
};

}  // namespace estimation
