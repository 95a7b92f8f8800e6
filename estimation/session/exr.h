// EXR files with their attributes. Private to this folder's .cpp files.
#pragma once

#include <filesystem>
#include <map>
#include <string>

#include "estimation/base/image.h"
#include "estimation/session/error.h"

namespace estimation {

struct ExrFile {
  std::map<std::string, Image<float>> channels;
  std::map<std::string, std::string> attributes;  // those that are strings
};

// As read_exr, which is this without the attributes.
Result<ExrFile> read_exr_file(const std::filesystem::path& path);

}  // namespace estimation
