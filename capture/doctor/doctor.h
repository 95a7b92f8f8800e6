// What stands between this host and a capture with a rig: one finding a subject, each with the
// command that puts it right. Pure: judges what host_facts.h has read.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "capture/doctor/host_facts.h"
#include "rig/fault.h"
#include "rig/rig_file.h"

namespace capture {

enum class Health { kOk, kWarning, kFailure };
std::string to_string(Health health);  // "ok", "warning", "failure"

struct HostFinding {
  Health health = Health::kOk;
  std::string subject;  // "receive buffer"
  std::string text;     // what was found, and what the rig needs
  std::string remedy;   // a command, or what to do; empty when ok
};

// The projector's monitor as it was found.
struct MonitorFacts {
  std::string name;
  int width_px = 0;
  int height_px = 0;
  int refresh_hz = 0;  // 0 where it does not say
};

// What a capture takes.
struct CaptureNeeds {
  int frame_count = 0;
  std::uint64_t frame_bytes = 0;    // of one frame in memory
  std::uint64_t storage_bytes = 0;  // of a session, maps included
};

// Packets of a frame that come while the receiver is held up wait in the socket's buffer.
HostFinding check_receive_buffer(const HostFacts& host, const CaptureNeeds& needs);
HostFinding check_camera_interface(const HostFacts& host, const rig::CameraSettings& camera);
HostFinding check_trigger_box(const HostFacts& host, const rig::TriggerSettings& trigger);
HostFinding check_monitor(const rig::Result<std::vector<MonitorFacts>>& monitors,
                          const rig::ProjectorSettings& projector);
HostFinding check_storage_space(const HostFacts& host, const CaptureNeeds& needs);
HostFinding check_memory(const HostFacts& host, const CaptureNeeds& needs);
// Whether the thread that fetches packets may go before others.
HostFinding check_priority(const HostFacts& host);

// All of the above.
std::vector<HostFinding> examine(const rig::RigFile& rig_file, const HostFacts& host,
                                 const rig::Result<std::vector<MonitorFacts>>& monitors,
                                 const CaptureNeeds& needs);

// The worst of them.
Health worst_of(const std::vector<HostFinding>& findings);

}  // namespace capture
