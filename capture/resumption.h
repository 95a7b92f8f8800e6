// An interrupted take made ready to be finished: what it lacks, and whether rig and subject are
// still as they were.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "capture/plan.h"
#include "capture/take_run.h"
#include "estimation/motion/motion_verdict.h"
#include "estimation/motion/picture_identity.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"
#include "rig/rig_file.h"

namespace capture {

struct Resumption {
  std::filesystem::path session;
  std::uintmax_t journal_byte_count = 0;  // before anything was read
  estimation::Manifest manifest;  // a record a slot; the good ones as their frames were stored
  std::vector<bool> is_good;      // [pattern * brackets + bracket]: on the disk, and checked
  std::vector<std::string> damaged_files;         // under a slot's name, but not good
  std::vector<std::string> wrong_files;           // whole, but they do not show their pattern
  std::vector<estimation::SeenPicture> pictures;  // of the good ones

  int good_count() const;
  std::vector<bool> is_open() const;
  estimation::Manifest lacking() const;  // with the records of the open slots alone
  // The first pattern in the order of projection that has a good frame; none: nothing is there.
  std::optional<int> known_pattern(const Plan& plan) const;
};

// `planned` is plan_manifest() of `plan` as it would be captured now. Errors: no session; one that
// is complete, under way, or older than its journal's first line; one that was taken with other
// settings, naming all that differs.
estimation::Result<Resumption> prepare_resumption(const rig::RigFile& rig_file, const Plan& plan,
                                                  const estimation::Manifest& planned,
                                                  const std::filesystem::path& session);

// From here on the session is being captured, as its manifest says, which names the good frames
// alone. Then room for what comes under the names of the others: they get ".damaged" or
// ".wrong_picture" appended, with a number where that is taken. Errors: kUnwritable.
estimation::Result<void> set_damaged_aside(const Resumption& resumption);

// The frames of `pattern` from the disk, as the watch's first showing.
estimation::Result<void> show_first(const Resumption& resumption, int pattern, MotionWatch& watch);

}  // namespace capture
