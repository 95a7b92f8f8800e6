// What a capture with a rig takes from its host.
#pragma once

#include <string>
#include <vector>

#include "capture/doctor/doctor.h"
#include "rig/rig_file.h"

namespace capture {

// Of the plan that a capture takes if no other is named. Errors: kConfiguration.
rig::Result<CaptureNeeds> needs_of(const rig::RigFile& rig_file);

// What a capture says before it begins: the doctor's warnings about this host that no device will
// report, each with its remedy.
std::vector<std::string> host_warnings(const rig::RigFile& rig_file, const HostPlaces& places = {});

}  // namespace capture
