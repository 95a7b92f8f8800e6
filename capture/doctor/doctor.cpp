#include "capture/doctor/doctor.h"

#include <algorithm>
#include <cstdio>

namespace capture {
namespace {

// What the driver asks for; the kernel grants net.core.rmem_max of it.
constexpr std::uint64_t kWantedBuffer_bytes = std::uint64_t{16} << 20;
constexpr int kJumboFrame_bytes = 9000;
constexpr int kGigabit_mbit = 1000;
constexpr int kReceiverPriority = 10;  // of aravis_camera.cpp
constexpr int kSpareBuffers = 8;       // of aravis_camera.cpp

std::string megabytes(std::uint64_t bytes) { return std::to_string(bytes / 1'000'000) + " MB"; }

std::string size_text(int width_px, int height_px) {
  return std::to_string(width_px) + " x " + std::to_string(height_px) + " px";
}

std::string usb_id(const rig::TriggerSettings& trigger) {
  char text[16];
  std::snprintf(text, sizeof text, "%04x:%04x", trigger.vendor_id, trigger.product_id);
  return text;
}

HostFinding unusable_interface(const CameraInterface& interface,
                               const rig::CameraSettings& camera) {
  HostFinding finding{Health::kFailure, "camera network", "", ""};
  if (!interface.has_carrier) {
    finding.text =
        interface.name + ", which leads to the camera at " + camera.address + ", has no link";
    finding.remedy = "plug in the camera's cable and power; then: sudo ip link set dev " +
                     interface.name + " up";
  } else if (!interface.is_on_subnet) {
    finding.text = "packets to the camera at " + camera.address + " leave by " + interface.name +
                   " through a gateway: no interface is on the camera's network";
    finding.remedy =
        "give the camera's interface an address of that network: sudo ip address add "
        "ADDRESS/24 dev INTERFACE";
  } else {
    finding.text = "packets of " + std::to_string(camera.packet_size_bytes) + " bytes do not fit " +
                   interface.name + " with its MTU of " + std::to_string(interface.mtu_bytes);
    finding.remedy = "sudo ip link set dev " + interface.name + " mtu " +
                     std::to_string(camera.packet_size_bytes) +
                     ", or leave camera.packet_size_bytes out of the rig file";
  }
  return finding;
}

}  // namespace

std::string to_string(Health health) {
  switch (health) {
    case Health::kOk:
      return "ok";
    case Health::kWarning:
      return "warning";
    case Health::kFailure:
      break;
  }
  return "failure";
}

HostFinding check_receive_buffer(const HostFacts& host, const CaptureNeeds& needs) {
  HostFinding finding{Health::kOk, "receive buffer", "", ""};
  const std::uint64_t needed = std::min(needs.frame_bytes, kWantedBuffer_bytes);
  const std::string remedy =
      "sudo sysctl -w net.core.rmem_max=33554432 (for good: echo net.core.rmem_max=33554432 | "
      "sudo tee /etc/sysctl.d/60-ssrig.conf)";
  if (!host.receive_buffer_limit_bytes)
    return {Health::kWarning, finding.subject, "net.core.rmem_max cannot be read", remedy};
  finding.text = "net.core.rmem_max is " + std::to_string(*host.receive_buffer_limit_bytes) +
                 " bytes; a frame has " + std::to_string(needs.frame_bytes);
  if (*host.receive_buffer_limit_bytes >= needed) return finding;
  finding.health = Health::kWarning;
  finding.text +=
      ": packets that come while the receiver is held up are lost and asked for again, and a "
      "camera that sends a frame at once or cannot resend loses frames";
  finding.remedy = remedy;
  return finding;
}

HostFinding check_camera_interface(const HostFacts& host, const rig::CameraSettings& camera) {
  HostFinding finding{Health::kOk, "camera network", "", ""};
  if (!host.camera_interface)
    return {Health::kFailure, finding.subject,
            "there is no way to the camera \"" + camera.address + "\" by its IPv4 address",
            "give the camera's interface an address of the camera's network (sudo ip address add "
            "ADDRESS/24 dev INTERFACE), and correct camera.address in the rig file"};
  const CameraInterface& interface = *host.camera_interface;
  const bool is_mtu_known = interface.mtu_bytes > 0;
  if (!interface.has_carrier || !interface.is_on_subnet ||
      (is_mtu_known && camera.packet_size_bytes > interface.mtu_bytes))
    return unusable_interface(interface, camera);
  finding.text =
      interface.name + " with an MTU of " +
      (is_mtu_known ? std::to_string(interface.mtu_bytes) : "unknown size") +
      (interface.speed_mbit > 0 ? " at " + std::to_string(interface.speed_mbit) + " Mbit/s" : "") +
      " leads to the camera at " + camera.address;
  if (interface.speed_mbit > 0 && interface.speed_mbit < kGigabit_mbit) {
    finding.health = Health::kWarning;
    finding.text += ": slower than Gigabit Ethernet, so each frame takes longer";
    finding.remedy =
        "use a cable of category 5e or better, and look with: sudo ethtool " + interface.name;
  } else if (interface.mtu_bytes < kJumboFrame_bytes) {
    finding.health = Health::kWarning;
    finding.text += ": small packets cost the receiver time";
    finding.remedy = "sudo ip link set dev " + interface.name + " mtu 9000";
  }
  return finding;
}

HostFinding check_trigger_box(const HostFacts& host, const rig::TriggerSettings& trigger) {
  HostFinding finding{Health::kFailure, "trigger box", "", ""};
  std::vector<UsbDevice> boxes = host.trigger_boxes;
  if (!trigger.serial.empty())
    std::erase_if(boxes, [&](const UsbDevice& box) {
      return !box.serial.empty() && box.serial != trigger.serial;
    });
  const std::string name = "trigger box " + usb_id(trigger) +
                           (trigger.serial.empty() ? "" : " with serial " + trigger.serial);
  if (boxes.empty()) {
    finding.text = "no " + name + " on USB";
    finding.remedy = "check its cable and power; then: lsusb -d " + usb_id(trigger);
  } else if (boxes.size() > 1 && trigger.serial.empty()) {
    finding.text = std::to_string(boxes.size()) + " trigger boxes " + usb_id(trigger) + " on USB";
    finding.remedy =
        "say in the rig file which one, as trigger.serial = \"" + boxes.front().serial + "\"";
  } else if (!boxes.front().is_permitted) {
    finding.text = name + " at " + boxes.front().node.string() + " may not be opened by this user";
    finding.remedy =
        "sudo cp config/60-ssrig-trigger-box.rules /etc/udev/rules.d && sudo udevadm control "
        "--reload && sudo adduser $USER plugdev; then plug it in again and log in again";
  } else {
    finding.health = Health::kOk;
    finding.text = name + " at " + boxes.front().node.string();
  }
  return finding;
}

HostFinding check_monitor(const rig::Result<std::vector<MonitorFacts>>& monitors,
                          const rig::ProjectorSettings& projector) {
  HostFinding finding{Health::kFailure, "projector", "", ""};
  if (!monitors)
    return {Health::kFailure, finding.subject, monitors.error().detail,
            "log in at the desktop, or: export DISPLAY=:0"};
  const auto found = std::ranges::find(*monitors, projector.monitor, &MonitorFacts::name);
  if (found == monitors->end()) {
    std::string names;
    for (const MonitorFacts& monitor : *monitors)
      names.append(names.empty() ? "" : ", ").append(monitor.name);
    finding.text = "no monitor is named \"" + projector.monitor +
                   "\"; there are: " + (names.empty() ? "none" : names);
    finding.remedy = "switch the projector on, or correct projector.monitor in the rig file";
    return finding;
  }
  finding.text = found->name + " shows " + size_text(found->width_px, found->height_px) + " at " +
                 (found->refresh_hz > 0 ? std::to_string(found->refresh_hz) + " Hz"
                                        : std::string("an unknown rate"));
  if (found->width_px != projector.width_px || found->height_px != projector.height_px) {
    finding.text += ", the rig file says " + size_text(projector.width_px, projector.height_px);
    finding.remedy = "xrandr --output " + found->name + " --mode " +
                     std::to_string(projector.width_px) + "x" + std::to_string(projector.height_px);
    return finding;
  }
  finding.health = found->refresh_hz > 0 ? Health::kOk : Health::kWarning;
  if (found->refresh_hz == 0)
    finding.remedy = "look at the rate with: xrandr; a capture measures it before it begins";
  return finding;
}

HostFinding check_storage_space(const HostFacts& host, const CaptureNeeds& needs) {
  const std::string folder = host.storage.string();
  HostFinding finding{Health::kFailure, "storage", "",
                      "choose another folder as storage.directory"};
  if (!host.is_storage_writable) {
    finding.text = folder + " cannot be written to by this user";
    finding.remedy =
        "sudo chown $USER " + folder + ", or choose another folder as storage.directory";
    return finding;
  }
  if (!host.storage_free_bytes) {
    finding.text = "the free space of " + folder + " is unknown";
    return finding;
  }
  finding.text = "a capture takes " + megabytes(needs.storage_bytes) + ", " +
                 megabytes(*host.storage_free_bytes) + " are free in " + folder;
  if (*host.storage_free_bytes < needs.storage_bytes) {
    finding.remedy = "make room, or choose another folder as storage.directory";
    return finding;
  }
  constexpr std::uint64_t kFewCaptures = 5;
  const std::uint64_t room =
      needs.storage_bytes == 0 ? 0 : *host.storage_free_bytes / needs.storage_bytes;
  finding.text += ": room for " + std::to_string(room);
  finding.health = room < kFewCaptures ? Health::kWarning : Health::kOk;
  finding.remedy = room < kFewCaptures ? "make room: du -sh " + folder + "/*" : "";
  return finding;
}

HostFinding check_memory(const HostFacts& host, const CaptureNeeds& needs) {
  HostFinding finding{Health::kOk, "memory", "", ""};
  if (!host.available_memory_bytes)
    return {Health::kWarning, finding.subject, "the free memory is unknown", "free -m"};
  const std::uint64_t needed =
      needs.frame_bytes * static_cast<std::uint64_t>(needs.frame_count + kSpareBuffers);
  finding.text = std::to_string(needs.frame_count + kSpareBuffers) + " frame buffers take " +
                 megabytes(needed) + ", " + megabytes(*host.available_memory_bytes) + " are free";
  if (*host.available_memory_bytes >= needed) return finding;
  finding.health = Health::kFailure;
  finding.remedy =
      "close other programs (ps aux --sort=-rss | head), or use a smaller camera.width_px and "
      "height_px";
  return finding;
}

HostFinding check_priority(const HostFacts& host) {
  HostFinding finding{Health::kOk, "priority", "", ""};
  if (host.realtime_priority_limit >= kReceiverPriority) {
    finding.text = "the receiver of the camera's packets may go before other programs";
    return finding;
  }
  finding.health = Health::kWarning;
  finding.text =
      "the receiver of the camera's packets runs as any thread: other programs can hold it up";
  finding.remedy = "sudo setcap cap_sys_nice+ep $(readlink -f $(command -v ssrig))";
  return finding;
}

std::vector<HostFinding> examine(const rig::RigFile& rig_file, const HostFacts& host,
                                 const rig::Result<std::vector<MonitorFacts>>& monitors,
                                 const CaptureNeeds& needs) {
  std::vector<HostFinding> findings{check_camera_interface(host, rig_file.camera),
                                    check_receive_buffer(host, needs), check_priority(host)};
  if (rig_file.sequence.sync == rig::SyncMode::kTriggerBox)
    findings.push_back(check_trigger_box(host, rig_file.trigger));
  findings.push_back(check_monitor(monitors, rig_file.projector));
  findings.push_back(check_memory(host, needs));
  findings.push_back(check_storage_space(host, needs));
  return findings;
}

Health worst_of(const std::vector<HostFinding>& findings) {
  Health worst = Health::kOk;
  for (const HostFinding& finding : findings) worst = std::max(worst, finding.health);
  return worst;
}

}  // namespace capture
