// EXR files with their attributes. Private to this folder's .cpp files.
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "estimation/session/error.h"

namespace estimation {

struct ExrFile {
  std::map<std::string, Image<float>> channels;
  std::map<std::string, std::string> attributes;  // those that are strings
};

// From memory; `file` is the name for messages. Errors: kUnreadable.
Result<ExrFile> decode_exr(const std::vector<std::byte>& bytes, const std::string& file);

// As read_exr, which is this without the attributes.
Result<ExrFile> read_exr_file(const std::filesystem::path& path);

}  // namespace estimation
