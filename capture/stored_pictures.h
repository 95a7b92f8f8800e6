// Whether the frames of a session on the disk show their patterns: capture/picture_watch.h, later.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "estimation/motion/picture_identity.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace capture {

// Of `frames`, each a record of a file that is there. Brackets are numbered by exposure; the order
// of showing is that of the edges, else of the camera's clock, else of the records. Errors: a frame
// that cannot be read.
estimation::Result<std::vector<estimation::SeenPicture>> read_pictures(
    const std::filesystem::path& session, const estimation::Manifest& manifest,
    const std::vector<estimation::FrameRecord>& frames);

// All that the manifest names.
estimation::Result<estimation::PictureCheck> check_stored_pictures(
    const std::filesystem::path& session);

// "patterns 3, 17 and 40": those that are wrong, each once.
std::string name_patterns(const estimation::PictureCheck& check);

}  // namespace capture
