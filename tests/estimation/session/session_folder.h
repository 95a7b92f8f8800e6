// A folder of its own for a test, and sessions in it.
#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>

#include <cstddef>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace estimation {

inline std::filesystem::path example_session() { return SSRIG_SESSION_EXAMPLE; }

// Made empty, removed with everything in it.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "ssrig_session_XXXXXX").string();
    if (::mkdtemp(name.data()) != nullptr) path_ = name;
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  ~TemporaryFolder() {
    std::error_code error;
    std::filesystem::remove_all(path_, error);
  }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

inline std::string read_text(const std::filesystem::path& path) {
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
  return nlohmann::json::parse(read_text(example_session() / "session.json"));
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
