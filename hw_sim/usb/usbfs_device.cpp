#include "hw_sim/usb/usbfs_device.h"

#include <fcntl.h>
#include <linux/usbdevice_fs.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <umockdev.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <deque>
#include <list>
#include <map>
#include <mutex>
#include <optional>
#include <span>
#include <utility>

#include "estimation/base/check.h"

namespace hw_sim {
namespace {

using estimation::check;
using Bytes = std::vector<std::uint8_t>;

constexpr std::size_t kSetupBytes = 8;
constexpr std::uint8_t kGetDescriptor = 6;
constexpr std::uint8_t kStringDescriptor = 3;

struct GObjectUnref {
  void operator()(gpointer object) const { g_object_unref(object); }
};
using IoctlData = std::unique_ptr<UMockdevIoctlData, GObjectUnref>;

// The host's memory at that place; nullptr: the host's process has been killed meanwhile.
IoctlData resolve(UMockdevIoctlData* data, std::size_t offset, std::size_t size) {
  return IoctlData(umockdev_ioctl_data_resolve(data, offset, size, nullptr));
}

template <typename... Numbers>
std::string format(const char* pattern, Numbers... numbers) {
  std::array<char, 128> text{};
  // The patterns are literals of this file.
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wformat-nonliteral"
  std::snprintf(text.data(), text.size(), pattern, numbers...);
#pragma GCC diagnostic pop
  return text.data();
}

std::string node_of(UsbAddress address) {
  return format("/dev/bus/usb/%03d/%03d", address.bus, address.device);
}

std::string sysfs_of(UsbAddress address) {
  return format("/devices/sim/usb%d/%d-%d", address.bus, address.bus, address.device);
}

std::uint8_t low(std::size_t number) { return static_cast<std::uint8_t>(number & 0xFF); }
std::uint8_t high(std::size_t number) { return static_cast<std::uint8_t>(number >> 8); }

// Device, configuration, interface and endpoint descriptors, as in USB 2.0 chapter 9.6.
Bytes descriptors_of(const UsbDescription& usb) {
  return {18, 1, 0x00, 0x02, 0xFF, 0, 0, 64, low(usb.vendor_id), high(usb.vendor_id),
          low(usb.product_id), high(usb.product_id), 0x00, 0x01, 1, 2, 3, 1,
          // configuration 1, bus-powered, 100 mA
          9, 2, 25, 0, 1, 1, 0, 0x80, 50,
          // interface 0, vendor class
          9, 4, 0, 0, 1, 0xFF, 0, 0, 0,
          // bulk IN
          7, 5, usb.endpoint_in, 2, low(usb.packet_bytes), high(usb.packet_bytes), 0};
}

std::string sysfs_record(UsbAddress address, const UsbDescription& usb) {
  std::string record =
      "P: " + sysfs_of(address) + "\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\nE: DRIVER=usb\n" +
      format("E: BUSNUM=%03d\nE: DEVNUM=%03d\n", address.bus, address.device) +
      // No N: line, with which umockdev would put a plain file over our FIFO.
      "E: DEVNAME=" + node_of(address) +
      format("\nE: MAJOR=189\nE: MINOR=%d\n", address.device - 1) +
      "A: bConfigurationValue=1\\n\n" +
      format("A: busnum=%d\\n\nA: devnum=%d\\n\nA: speed=12\\n\n", address.bus, address.device) +
      "H: descriptors=";
  for (const std::uint8_t byte : descriptors_of(usb)) {
    record += format("%02X", static_cast<unsigned>(byte));
  }
  return record + "\n\n";
}

UsbReply string_descriptor(const UsbDescription& usb, std::uint8_t index) {
  constexpr std::uint8_t kEnglishUs[] = {4, kStringDescriptor, 0x09, 0x04};
  const std::array<const std::string*, 3> strings = {&usb.manufacturer, &usb.product, &usb.serial};
  if (index == 0) return Bytes(std::begin(kEnglishUs), std::end(kEnglishUs));
  if (index > strings.size()) return UsbStall{};
  Bytes bytes = {0, kStringDescriptor};
  for (const char letter : *strings[index - 1u]) {  // ASCII to UTF-16LE
    bytes.push_back(static_cast<std::uint8_t>(letter));
    bytes.push_back(0);
  }
  bytes[0] = low(bytes.size());
  return bytes;
}

// The device node: a FIFO that polls writable exactly when it was told to.
class Node {
 public:
  explicit Node(const std::string& path) {
    const std::string folder = path.substr(0, path.rfind('/'));
    check(g_mkdir_with_parents(folder.c_str(), 0755) == 0, "no folder for a usbfs node");
    ::unlink(path.c_str());
    check(::mkfifo(path.c_str(), 0666) == 0, "no FIFO for a usbfs node");
    fd_ = ::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
    check(fd_ >= 0, "no usbfs node");
    check(::fcntl(fd_, F_SETPIPE_SZ, 4096) > 0, "usbfs node of the wrong size");
    fill();
  }
  ~Node() { ::close(fd_); }
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  void set_ready(bool is_ready) {
    if (is_ready == is_ready_) return;
    is_ready_ = is_ready;
    if (is_ready) {
      drain();
    } else {
      fill();
    }
  }

 private:
  void drain() const {
    std::array<char, 4096> bytes{};
    while (::read(fd_, bytes.data(), bytes.size()) > 0) {
    }
  }
  void fill() const {
    const std::array<char, 4096> bytes{};
    while (::write(fd_, bytes.data(), bytes.size()) > 0) {
    }
  }

  int fd_ = -1;
  bool is_ready_ = false;
};

// A transfer that the host has asked for. `wire` is touched by umockdev's thread only: it is sent
// back asynchronously, so results are kept beside it until the host reaps them.
struct Urb {
  IoctlData wire;
  gulong host_address = 0;
  bool is_control = false;
  std::uint8_t endpoint = 0;
  std::size_t capacity_bytes = 0;
  Bytes in;
  std::size_t actual_bytes = 0;
  int status = 0;
};

// One open file: never write an URB of one through the socket of another.
struct Client {
  std::list<Urb> pending;
  std::deque<Urb> done;
};

usbdevfs_urb& urb_of(const IoctlData& wire) {
  return *static_cast<usbdevfs_urb*>(static_cast<void*>(wire->data));
}

}  // namespace

class UsbfsDevice::Core {
 public:
  Core(UsbTestbed& testbed, UsbAddress address, UsbDescription description, Control control);
  ~Core();
  Core(const Core&) = delete;
  Core& operator=(const Core&) = delete;

  void send(Bytes packet);
  std::size_t waiting_packet_count() const;
  void discard_packets();
  void unplug();
  void stall_in();
  void refuse_claims(bool is_refusing);

 private:
  struct Answer {
    glong result = 0;
    int error = 0;
  };
  static constexpr Answer kNoHost{-1, EFAULT};
  static gboolean on_ioctl(UMockdevIoctlBase*, UMockdevIoctlClient* client, gpointer self);
  Answer answer(UMockdevIoctlClient* client);
  Answer get_capabilities(UMockdevIoctlData* argument) const;
  Answer submit(UMockdevIoctlClient* client, UMockdevIoctlData* argument);
  Answer discard(UMockdevIoctlClient* client, UMockdevIoctlData* argument);
  Answer reap(UMockdevIoctlClient* client, UMockdevIoctlData* argument);
  // What became of a control transfer; true: it is over.
  bool run_control(Urb& urb);
  UsbReply reply_to(const UsbSetup& setup, const Bytes& data) const;

  // With mutex_ held:
  Client& client_of(UMockdevIoctlClient* client);
  void forget_closed_clients();
  void finish(Client& client, std::list<Urb>::iterator urb, int status);
  void pump();
  void update_node();

  const UsbAddress address_;
  const UsbDescription description_;
  const Control control_;
  UMockdevTestbed* const testbed_;
  UMockdevIoctlBase* const handler_;

  mutable std::mutex mutex_;
  std::unique_ptr<Node> node_;                      // guarded by mutex_, like all below
  std::map<UMockdevIoctlClient*, Client> clients_;  // each with a reference
  std::deque<Bytes> packets_;
  bool is_gone_ = false;
  bool is_refusing_claims_ = false;
  bool owes_stall_ = false;
};

UsbfsDevice::Core::Core(UsbTestbed& testbed, UsbAddress address, UsbDescription description,
                        Control control)
    : address_(address),
      description_(std::move(description)),
      control_(std::move(control)),
      testbed_(testbed.get()),
      handler_(umockdev_ioctl_base_new()) {
  g_signal_connect_data(handler_, "handle-ioctl", reinterpret_cast<GCallback>(&Core::on_ioctl),
                        this, nullptr, GConnectFlags{});
  // In this order: the add event of sysfs comes when the node is ready to be opened.
  check(umockdev_testbed_attach_ioctl(testbed_, node_of(address_).c_str(), handler_, nullptr),
        "umockdev takes no ioctl handler");
  node_ = std::make_unique<Node>(testbed.root() + node_of(address_));
  check(umockdev_testbed_add_from_string(testbed_, sysfs_record(address_, description_).c_str(),
                                         nullptr),
        "umockdev takes no device");
}

UsbfsDevice::Core::~Core() {
  unplug();
  umockdev_testbed_detach_ioctl(testbed_, node_of(address_).c_str(), nullptr);
  g_object_unref(handler_);
  for (const auto& [client, queues] : clients_) g_object_unref(client);
}

void UsbfsDevice::Core::unplug() {
  {
    const std::lock_guard lock(mutex_);
    if (std::exchange(is_gone_, true)) return;
    packets_.clear();
    for (auto& [key, client] : clients_) {
      while (!client.pending.empty()) finish(client, client.pending.begin(), -ESHUTDOWN);
    }
    update_node();
  }
  const std::string path = "/sys" + sysfs_of(address_);
  umockdev_testbed_uevent(testbed_, path.c_str(), "remove");
  umockdev_testbed_remove_device(testbed_, path.c_str());
}

void UsbfsDevice::Core::send(Bytes packet) {
  const std::lock_guard lock(mutex_);
  if (is_gone_) return;
  packets_.push_back(std::move(packet));
  pump();
}

std::size_t UsbfsDevice::Core::waiting_packet_count() const {
  const std::lock_guard lock(mutex_);
  return packets_.size();
}

void UsbfsDevice::Core::discard_packets() {
  const std::lock_guard lock(mutex_);
  packets_.clear();
  for (auto& [key, client] : clients_) {
    for (Urb& urb : client.pending) urb.in.clear();
  }
}

void UsbfsDevice::Core::stall_in() {
  const std::lock_guard lock(mutex_);
  owes_stall_ = true;
  pump();
}

void UsbfsDevice::Core::refuse_claims(bool is_refusing) {
  const std::lock_guard lock(mutex_);
  is_refusing_claims_ = is_refusing;
}

Client& UsbfsDevice::Core::client_of(UMockdevIoctlClient* client) {
  const auto [found, is_new] = clients_.try_emplace(client);
  if (is_new) g_object_ref(client);
  return found->second;
}

// A closed file must not swallow data.
void UsbfsDevice::Core::forget_closed_clients() {
  std::erase_if(clients_, [](const auto& entry) {
    if (umockdev_ioctl_client_get_connected(entry.first)) return false;
    g_object_unref(entry.first);
    return true;
  });
}

void UsbfsDevice::Core::finish(Client& client, std::list<Urb>::iterator urb, int status) {
  urb->status = status;
  if (!urb->is_control) urb->actual_bytes = urb->in.size();
  client.done.push_back(std::move(*urb));
  client.pending.erase(urb);
  update_node();
}

void UsbfsDevice::Core::update_node() {
  const bool has_done = std::any_of(clients_.begin(), clients_.end(),
                                    [](const auto& entry) { return !entry.second.done.empty(); });
  node_->set_ready(is_gone_ || has_done);
}

// Packets meet transfers, both in the order of their coming.
void UsbfsDevice::Core::pump() {
  if (packets_.empty() && !owes_stall_) return;
  forget_closed_clients();
  for (auto& [key, client] : clients_) {
    for (auto urb = client.pending.begin(); urb != client.pending.end();) {
      const auto current = urb++;
      if (current->is_control || current->endpoint != description_.endpoint_in) continue;
      if (std::exchange(owes_stall_, false)) {
        finish(client, current, -EPIPE);
        continue;
      }
      while (!packets_.empty()) {
        const Bytes packet = std::move(packets_.front());
        packets_.pop_front();
        const std::size_t room_bytes = current->capacity_bytes - current->in.size();
        const std::size_t taken_bytes = std::min(room_bytes, packet.size());
        current->in.insert(current->in.end(), packet.begin(),
                           packet.begin() + static_cast<std::ptrdiff_t>(taken_bytes));
        const bool is_full = current->in.size() == current->capacity_bytes;
        if (packet.size() < description_.packet_bytes || is_full) {
          finish(client, current, packet.size() > room_bytes ? -EOVERFLOW : 0);
          break;
        }
      }
      if (packets_.empty()) return;
    }
  }
}

gboolean UsbfsDevice::Core::on_ioctl(UMockdevIoctlBase*, UMockdevIoctlClient* client,
                                     gpointer self) {
  const Answer answer = static_cast<Core*>(self)->answer(client);
  umockdev_ioctl_client_complete(client, answer.result, answer.error);
  return TRUE;
}

UsbfsDevice::Core::Answer UsbfsDevice::Core::answer(UMockdevIoctlClient* client) {
  UMockdevIoctlData* const argument = umockdev_ioctl_client_get_arg(client);
  const auto request = static_cast<unsigned long>(umockdev_ioctl_client_get_request(client));
  {
    const std::lock_guard lock(mutex_);
    const bool is_reap = request == USBDEVFS_REAPURB || request == USBDEVFS_REAPURBNDELAY;
    if (is_gone_ && !is_reap) return {-1, ENODEV};
  }
  switch (request) {
    case USBDEVFS_GET_CAPABILITIES:
      return get_capabilities(argument);
    case USBDEVFS_DISCONNECT_CLAIM:
    case USBDEVFS_CLAIMINTERFACE: {
      const std::lock_guard lock(mutex_);
      if (is_refusing_claims_) return {-1, EBUSY};
      // It has one user. umockdev does not always notice that a killed one has gone, whose
      // transfers would swallow this one's data.
      for (auto& [key, other] : clients_)
        if (key != client) other = Client{};
      update_node();
      return {};
    }
    case USBDEVFS_RELEASEINTERFACE:
    case USBDEVFS_SETINTERFACE:
    case USBDEVFS_SETCONFIGURATION:
    case USBDEVFS_CLEAR_HALT:
    case USBDEVFS_RESET:
    case USBDEVFS_RESETEP:
      return {};
    case USBDEVFS_GETDRIVER:
    case USBDEVFS_IOCTL:  // detaching a kernel driver: there is none
      return {-1, ENODATA};
    case USBDEVFS_SUBMITURB:
      return submit(client, argument);
    case USBDEVFS_DISCARDURB:
      return discard(client, argument);
    case USBDEVFS_REAPURB:
    case USBDEVFS_REAPURBNDELAY:
      return reap(client, argument);
    default:
      return {-1, ENOTTY};
  }
}

UsbfsDevice::Core::Answer UsbfsDevice::Core::get_capabilities(UMockdevIoctlData* argument) const {
  constexpr std::uint32_t kCapabilities =
      USBDEVFS_CAP_ZERO_PACKET | USBDEVFS_CAP_BULK_CONTINUATION | USBDEVFS_CAP_NO_PACKET_SIZE_LIM |
      USBDEVFS_CAP_BULK_SCATTER_GATHER | USBDEVFS_CAP_REAP_AFTER_DISCONNECT;
  const IoctlData data = resolve(argument, 0, sizeof kCapabilities);
  if (!data) return kNoHost;
  std::memcpy(data->data, &kCapabilities, sizeof kCapabilities);
  return {};
}

UsbfsDevice::Core::Answer UsbfsDevice::Core::submit(UMockdevIoctlClient* client,
                                                    UMockdevIoctlData* argument) {
  Urb urb;
  urb.wire = resolve(argument, 0, sizeof(usbdevfs_urb));
  if (!urb.wire) return kNoHost;
  const usbdevfs_urb& wire = urb_of(urb.wire);
  urb.host_address = urb.wire->client_addr;
  urb.is_control = wire.type == USBDEVFS_URB_TYPE_CONTROL;
  urb.endpoint = wire.endpoint;
  urb.capacity_bytes = static_cast<std::size_t>(std::max(wire.buffer_length, 0));
  if (urb.capacity_bytes > 0) {
    // Makes `buffer` a pointer to our own copy of the host's.
    if (!resolve(urb.wire.get(), offsetof(usbdevfs_urb, buffer), urb.capacity_bytes))
      return kNoHost;
  }
  const bool is_over = urb.is_control && run_control(urb);
  if (!urb.is_control && urb.endpoint != description_.endpoint_in) return {-1, ENOENT};

  const std::lock_guard lock(mutex_);
  Client& queues = client_of(client);
  queues.pending.push_back(std::move(urb));
  const auto submitted = std::prev(queues.pending.end());
  if (is_gone_) {
    finish(queues, submitted, -ESHUTDOWN);
  } else if (is_over) {
    finish(queues, submitted, submitted->status);
  } else {
    pump();
  }
  return {};
}

bool UsbfsDevice::Core::run_control(Urb& urb) {
  if (urb.capacity_bytes < kSetupBytes) {
    urb.status = -EPIPE;
    return true;
  }
  const std::span<const std::uint8_t> buffer(
      static_cast<const std::uint8_t*>(urb_of(urb.wire).buffer), urb.capacity_bytes);
  const auto u16_at = [&buffer](std::size_t at) {
    return static_cast<std::uint16_t>(buffer[at] | buffer[at + 1] << 8);
  };
  const UsbSetup setup = {buffer[0], buffer[1], u16_at(2), u16_at(4), u16_at(6)};
  const std::span<const std::uint8_t> payload = buffer.subspan(kSetupBytes);
  UsbReply reply = reply_to(setup, setup.is_in() ? Bytes{} : Bytes(payload.begin(), payload.end()));
  if (std::holds_alternative<UsbNoAnswer>(reply)) return false;
  if (std::holds_alternative<UsbStall>(reply)) {
    urb.status = -EPIPE;
    return true;
  }
  urb.in = std::get<Bytes>(std::move(reply));
  urb.in.resize(std::min(urb.in.size(), payload.size()));
  urb.actual_bytes = setup.is_in() ? urb.in.size() : payload.size();
  return true;
}

UsbReply UsbfsDevice::Core::reply_to(const UsbSetup& setup, const Bytes& data) const {
  if (setup.request_type == 0x80 && setup.request == kGetDescriptor &&
      high(setup.value) == kStringDescriptor) {
    return string_descriptor(description_, low(setup.value));
  }
  constexpr std::uint8_t kTypeMask = 0x60;
  constexpr std::uint8_t kVendorType = 0x40;
  if ((setup.request_type & kTypeMask) != kVendorType) return UsbStall{};
  return control_(setup, data);
}

UsbfsDevice::Core::Answer UsbfsDevice::Core::discard(UMockdevIoctlClient* client,
                                                     UMockdevIoctlData* argument) {
  gulong host_address = 0;
  std::memcpy(&host_address, argument->data, sizeof host_address);
  const std::lock_guard lock(mutex_);
  std::list<Urb>& pending = client_of(client).pending;
  const auto urb = std::find_if(pending.begin(), pending.end(), [host_address](const Urb& each) {
    return each.host_address == host_address;
  });
  if (urb == pending.end()) return {-1, EINVAL};
  finish(client_of(client), urb, -ENOENT);
  return {};
}

UsbfsDevice::Core::Answer UsbfsDevice::Core::reap(UMockdevIoctlClient* client,
                                                  UMockdevIoctlData* argument) {
  std::optional<Urb> urb;
  {
    const std::lock_guard lock(mutex_);
    std::deque<Urb>& done = client_of(client).done;
    if (!done.empty()) {
      urb = std::move(done.front());
      done.pop_front();
    }
    update_node();
    if (!urb) return {-1, is_gone_ ? ENODEV : EAGAIN};
  }
  usbdevfs_urb& wire = urb_of(urb->wire);
  wire.status = urb->status;
  wire.actual_length = static_cast<int>(urb->actual_bytes);
  if (!urb->in.empty()) {
    std::memcpy(static_cast<std::uint8_t*>(wire.buffer) + (urb->is_control ? kSetupBytes : 0),
                urb->in.data(), urb->in.size());
  }
  const IoctlData pointer = resolve(argument, 0, sizeof(void*));
  if (!pointer) return kNoHost;
  umockdev_ioctl_data_set_ptr(pointer.get(), 0, urb->wire.get());
  return {};
}

UsbfsDevice::UsbfsDevice(UsbTestbed& testbed, UsbAddress address, UsbDescription description,
                         Control control)
    : core_(std::make_unique<Core>(testbed, address, std::move(description), std::move(control))) {}

UsbfsDevice::~UsbfsDevice() = default;

void UsbfsDevice::send(std::vector<std::uint8_t> packet) { core_->send(std::move(packet)); }
std::size_t UsbfsDevice::waiting_packet_count() const { return core_->waiting_packet_count(); }
void UsbfsDevice::discard_packets() { core_->discard_packets(); }
void UsbfsDevice::unplug() { core_->unplug(); }
void UsbfsDevice::stall_in() { core_->stall_in(); }
void UsbfsDevice::refuse_claims(bool is_refusing) { core_->refuse_claims(is_refusing); }

}  // namespace hw_sim
