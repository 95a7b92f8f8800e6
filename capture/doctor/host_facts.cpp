#include "capture/doctor/host_facts.h"

#include <arpa/inet.h>
#include <dirent.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <sys/ioctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstring>
#include <fstream>
#include <iterator>
#include <memory>
#include <string_view>
#include <system_error>
#include <utility>

namespace capture {
namespace {

namespace fs = std::filesystem;

// A file of one value, without the newline; empty where it cannot be read.
std::string value_of(const fs::path& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  while (!line.empty() && (line.back() == ' ' || line.back() == '\n')) line.pop_back();
  return line;
}

template <typename Number>
std::optional<Number> number_in(std::string_view text, int base = 10) {
  Number number{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number, base);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return number;
}

// "KEY:   VALUE ..." of a file of such lines; empty where it has none.
std::string field_of(const fs::path& path, const std::string& key) {
  std::ifstream file(path);
  std::string word, value;
  while (file >> word) {
    if (word == key + ":" && file >> value) return value;
    std::getline(file, value);
  }
  return {};
}

std::optional<in_addr> ipv4(const std::string& text) {
  in_addr address{};
  if (inet_pton(AF_INET, text.c_str(), &address) != 1) return std::nullopt;
  return address;
}

// The address of ours that packets to `camera` would carry. Sends nothing.
std::optional<in_addr> source_address(in_addr camera) {
  const int probe = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (probe < 0) return std::nullopt;
  sockaddr_in name{};
  name.sin_family = AF_INET;
  name.sin_port = htons(3956);  // GVCP
  name.sin_addr = camera;
  socklen_t size = sizeof name;
  sockaddr_in source{};
  const bool is_routed =
      ::connect(probe, reinterpret_cast<const sockaddr*>(&name), sizeof name) == 0 &&
      ::getsockname(probe, reinterpret_cast<sockaddr*>(&source), &size) == 0;
  ::close(probe);
  if (!is_routed) return std::nullopt;
  return source.sin_addr;
}

// 0: unknown.
int mtu_of(const std::string& interface) {
  ifreq request{};
  std::strncpy(request.ifr_name, interface.c_str(), IFNAMSIZ - 1);
  const int probe = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (probe < 0) return 0;
  const bool is_known = ::ioctl(probe, SIOCGIFMTU, &request) == 0;
  ::close(probe);
  return is_known ? request.ifr_mtu : 0;
}

in_addr_t address_in(const sockaddr* name) {
  sockaddr_in copy{};
  std::memcpy(&copy, name, sizeof copy);
  return copy.sin_addr.s_addr;
}

std::optional<CameraInterface> find_interface(const std::string& camera_address,
                                              const fs::path& sys) {
  const auto camera = ipv4(camera_address);
  const auto source = camera ? source_address(*camera) : std::nullopt;
  ifaddrs* list = nullptr;
  if (!source || ::getifaddrs(&list) != 0) return std::nullopt;
  const std::unique_ptr<ifaddrs, void (*)(ifaddrs*)> owner(list, ::freeifaddrs);
  for (const ifaddrs* at = list; at != nullptr; at = at->ifa_next) {
    if (at->ifa_addr == nullptr || at->ifa_addr->sa_family != AF_INET) continue;
    // Loopback answers for all of 127.0.0.0/8.
    const bool is_loopback =
        (at->ifa_flags & IFF_LOOPBACK) != 0 && (ntohl(source->s_addr) >> 24U) == 127;
    if (address_in(at->ifa_addr) != source->s_addr && !is_loopback) continue;
    CameraInterface found{.name = at->ifa_name};
    const in_addr_t mask = at->ifa_netmask == nullptr ? ~in_addr_t{0} : address_in(at->ifa_netmask);
    found.is_on_subnet = (camera->s_addr & mask) == (address_in(at->ifa_addr) & mask);
    found.has_carrier = (at->ifa_flags & IFF_RUNNING) != 0;
    found.mtu_bytes = mtu_of(found.name);
    const std::string speed = value_of(sys / "class/net" / found.name / "speed");
    found.speed_mbit = std::max(0, number_in<int>(speed).value_or(0));
    return found;
  }
  return std::nullopt;
}

std::string three_digits(int number) {
  const std::string digits = std::to_string(number);
  return std::string(digits.size() < 3 ? 3 - digits.size() : 0, '0') + digits;
}

// Empty where there is no such folder. By the calls that libudev makes, so that what simulates
// sysfs for it (umockdev) is seen here too.
std::vector<fs::path> entries_of(const fs::path& folder) {
  std::vector<fs::path> entries;
  const std::unique_ptr<DIR, int (*)(DIR*)> open(::opendir(folder.c_str()), ::closedir);
  while (open) {
    const dirent* entry = ::readdir(open.get());
    if (entry == nullptr) break;
    if (entry->d_name[0] != '.') entries.push_back(folder / entry->d_name);
  }
  return entries;
}

using UsbId = std::pair<unsigned, unsigned>;  // vendor, product

// From the device descriptor, as libusb has it; zeros where there is none.
UsbId usb_id_of(const fs::path& device) {
  constexpr std::size_t kDescriptor_bytes = 18;
  std::array<char, kDescriptor_bytes> bytes{};
  std::ifstream file(device / "descriptors", std::ios::binary);
  if (!file.read(bytes.data(), bytes.size())) return {0, 0};
  const auto word_at = [&](std::size_t at) {
    return static_cast<unsigned char>(bytes[at]) + 256U * static_cast<unsigned char>(bytes[at + 1]);
  };
  return {word_at(8), word_at(10)};
}

std::vector<UsbDevice> find_boxes(const rig::TriggerSettings& trigger, const HostPlaces& places) {
  std::vector<UsbDevice> boxes;
  for (const fs::path& device : entries_of(places.sys / "bus/usb/devices")) {
    if (usb_id_of(device) != UsbId{trigger.vendor_id, trigger.product_id}) continue;
    const auto number = [&](const char* name) {
      return three_digits(number_in<int>(value_of(device / name)).value_or(0));
    };
    UsbDevice box{.serial = value_of(device / "serial"),
                  .node = places.dev / "bus/usb" / number("busnum") / number("devnum")};
    box.is_permitted = ::access(box.node.c_str(), R_OK | W_OK) == 0;
    boxes.push_back(std::move(box));
  }
  std::ranges::sort(boxes, {}, &UsbDevice::node);
  return boxes;
}

void read_storage(const rig::RigFile& rig_file, HostFacts& facts) {
  std::error_code error;
  facts.storage = fs::absolute(rig_file.storage.directory, error);
  while (!fs::exists(facts.storage, error) && facts.storage.has_relative_path())
    facts.storage = facts.storage.parent_path();
  facts.is_storage_writable =
      fs::is_directory(facts.storage, error) && ::access(facts.storage.c_str(), W_OK | X_OK) == 0;
  const auto space = fs::space(facts.storage, error);
  if (!error) facts.storage_free_bytes = space.available;
}

int realtime_priority_limit(const fs::path& proc) {
  constexpr std::uint64_t kSysNice = std::uint64_t{1} << 23U;  // CAP_SYS_NICE
  const auto capabilities =
      number_in<std::uint64_t>(field_of(proc / "self/status", "CapEff"), 16).value_or(0);
  if ((capabilities & kSysNice) != 0) return 99;
  rlimit limit{};
  if (::getrlimit(RLIMIT_RTPRIO, &limit) != 0) return 0;
  return static_cast<int>(std::min<rlim_t>(limit.rlim_cur, 99));
}

}  // namespace

HostFacts read_host(const rig::RigFile& rig_file, const HostPlaces& places) {
  HostFacts facts;
  facts.receive_buffer_limit_bytes =
      number_in<std::uint64_t>(value_of(places.proc / "sys/net/core/rmem_max"));
  facts.camera_interface = find_interface(rig_file.camera.address, places.sys);
  facts.trigger_boxes = find_boxes(rig_file.trigger, places);
  if (const auto available_kib =
          number_in<std::uint64_t>(field_of(places.proc / "meminfo", "MemAvailable")))
    facts.available_memory_bytes = *available_kib * 1024;
  read_storage(rig_file, facts);
  facts.realtime_priority_limit = realtime_priority_limit(places.proc);
  return facts;
}

}  // namespace capture
