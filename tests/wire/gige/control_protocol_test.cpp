// The simulated camera's control channel, spoken to byte by byte: what a client that is not Aravis
// may send.
#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "hw_sim/gige/socket.h"
#include "tests/wire/gige/wire_bench.h"

namespace {

using Bytes = std::vector<std::uint8_t>;

struct Answer {
  std::uint16_t status = 0;
  std::uint16_t command = 0;
  std::uint16_t id = 0;
  Bytes payload;
  std::uint32_t word(std::size_t at) const {
    return static_cast<std::uint32_t>(payload[at]) << 24 |
           static_cast<std::uint32_t>(payload[at + 1]) << 16 |
           static_cast<std::uint32_t>(payload[at + 2]) << 8 | payload[at + 3];
  }
};

void append(Bytes& bytes, std::uint32_t value, int byte_count) {
  for (int shift = 8 * (byte_count - 1); shift >= 0; shift -= 8)
    bytes.push_back(static_cast<std::uint8_t>(value >> shift));
}

// Codes and addresses written out, not taken from the device's headers.
constexpr std::uint32_t kPrivilege = 0x0A00;
constexpr std::uint32_t kHeartbeat = 0x0938;
constexpr std::uint32_t kResolvedVersion = 0x0000;
constexpr std::uint16_t kOk = 0x0000;
constexpr std::uint16_t kAnswerMs = 5000;

class Client {
 public:
  explicit Client(const std::string& address)
      : socket_(hw_sim::Socket::bind_udp("127.0.0.1", 0, false).value()) {
    device_.sin_family = AF_INET;
    device_.sin_port = htons(3956);
    inet_pton(AF_INET, address.c_str(), &device_.sin_addr);
  }
  std::optional<Answer> ask(std::uint16_t command, const Bytes& payload) {
    return ask_as(static_cast<std::uint16_t>(++id_), command, payload);
  }
  std::optional<Answer> ask_as(std::uint16_t id, std::uint16_t command, const Bytes& payload) {
    Bytes request{0x42, 0x01};
    append(request, command, 2);
    append(request, static_cast<std::uint32_t>(payload.size()), 2);
    append(request, id, 2);
    request.insert(request.end(), payload.begin(), payload.end());
    send(request);
    return receive();
  }
  void send(const Bytes& datagram) {
    sendto(socket_.fd(), datagram.data(), datagram.size(), 0,
           reinterpret_cast<const sockaddr*>(&device_), sizeof device_);
  }
  std::optional<Answer> receive() {
    pollfd waited{socket_.fd(), POLLIN, 0};
    if (poll(&waited, 1, kAnswerMs) <= 0) return std::nullopt;
    Bytes bytes(2048);
    const ssize_t got = recv(socket_.fd(), bytes.data(), bytes.size(), 0);
    if (got < 8) return std::nullopt;
    const auto word = [&](std::size_t at) {
      return static_cast<std::uint16_t>(bytes[at] << 8 | bytes[at + 1]);
    };
    return Answer{word(0), word(2), word(6), Bytes(bytes.begin() + 8, bytes.begin() + got)};
  }
  std::optional<Answer> read(std::uint32_t address) {
    Bytes payload;
    append(payload, address, 4);
    return ask(0x80, payload);
  }
  std::optional<Answer> write(std::uint32_t address, std::uint32_t value) {
    Bytes payload;
    append(payload, address, 4);
    append(payload, value, 4);
    return ask(0x82, payload);
  }

 private:
  hw_sim::Socket socket_;
  sockaddr_in device_{};
  int id_ = 0;
};

class ControlProtocol : public testing::Test {
 protected:
  void SetUp() override {
    const auto started = bench_.start();
    ASSERT_TRUE(started.has_value()) << started.error().detail;
  }
  WireBench bench_;
  Client client_{bench_.options.address};
};

TEST_F(ControlProtocol, DiscoveryTellsWhoItIs) {
  const auto answer = client_.ask(0x02, {});
  ASSERT_TRUE(answer.has_value());
  EXPECT_EQ(answer->status, kOk);
  EXPECT_EQ(answer->command, 0x03);
  ASSERT_EQ(answer->payload.size(), 0xF8U);
  EXPECT_STREQ(reinterpret_cast<const char*>(&answer->payload[0x48]), "ssrig");
  EXPECT_STREQ(reinterpret_cast<const char*>(&answer->payload[0xD8]), "SIM0001");
}

TEST_F(ControlProtocol, AnybodyReadsButOnlyTheControllerWrites) {
  EXPECT_EQ(client_.read(kResolvedVersion)->status, kOk);
  EXPECT_EQ(client_.write(kHeartbeat, 1000)->status, 0x8006);
  ASSERT_EQ(client_.write(kPrivilege, 2)->status, kOk);
  EXPECT_EQ(client_.write(kHeartbeat, 1000)->status, kOk);
  EXPECT_EQ(client_.read(kHeartbeat)->word(0), 1000U);
  Client other(bench_.options.address);
  EXPECT_EQ(other.read(kHeartbeat)->word(0), 1000U);
  EXPECT_EQ(other.write(kPrivilege, 2)->status, 0x8006);
  ASSERT_EQ(client_.write(kPrivilege, 0)->status, kOk);
  EXPECT_EQ(other.write(kPrivilege, 2)->status, kOk);
}

TEST_F(ControlProtocol, ExclusiveAccessShutsReadersOut) {
  ASSERT_EQ(client_.write(kPrivilege, 1)->status, kOk);
  Client other(bench_.options.address);
  EXPECT_EQ(other.read(kHeartbeat)->status, 0x8006);
}

TEST_F(ControlProtocol, BadRequestsGetTheirOwnErrors) {
  ASSERT_EQ(client_.write(kPrivilege, 2)->status, kOk);
  EXPECT_EQ(client_.read(0xBFFC)->status, 0x8003);                // no register there
  EXPECT_EQ(client_.read(0x0002)->status, 0x8005);                // not on a word
  EXPECT_EQ(client_.write(kResolvedVersion, 1)->status, 0x8004);  // read only
  EXPECT_EQ(client_.write(kHeartbeat, 1)->status, 0x8002);        // below its minimum
  EXPECT_EQ(client_.ask(0x90, {})->status, 0x8001);               // no such command
}

TEST_F(ControlProtocol, GarbageIsIgnored) {
  client_.send({});
  client_.send({0x42});
  client_.send(Bytes(8, 0xFF));
  client_.send({0x42, 0x01, 0x00, 0x80, 0x00, 0xFF, 0x00, 0x01});  // longer than it is
  client_.send({0x42, 0x01, 0x00, 0x40, 0x00, 0x00, 0x00, 0x01});  // resend of nothing
  client_.send({0x42, 0x01, 0x00, 0x84, 0x00, 0x00, 0x00, 0x02});  // READMEM of nothing
  ASSERT_EQ(client_.receive()->status, 0x8002);  // the one that deserves an answer
  EXPECT_EQ(client_.read(kResolvedVersion)->status, kOk);
}

// A client that missed the answer asks again under the same id; the command is not done twice.
TEST_F(ControlProtocol, RepeatedRequestGetsTheFirstAnswerAgain) {
  ASSERT_EQ(client_.write(kPrivilege, 2)->status, kOk);
  Bytes to_2000;
  append(to_2000, kHeartbeat, 4);
  append(to_2000, 2000, 4);
  Bytes to_4000;
  append(to_4000, kHeartbeat, 4);
  append(to_4000, 4000, 4);
  ASSERT_EQ(client_.ask_as(900, 0x82, to_2000)->status, kOk);
  ASSERT_EQ(client_.ask_as(900, 0x82, to_4000)->status, kOk);
  EXPECT_EQ(client_.read(kHeartbeat)->word(0), 2000U);
}

TEST_F(ControlProtocol, SilentControllerLosesControl) {
  ASSERT_EQ(client_.write(kPrivilege, 2)->status, kOk);
  ASSERT_EQ(client_.write(kHeartbeat, 500)->status, kOk);
  Client other(bench_.options.address);
  std::uint16_t status = 0x8006;
  const rig::HostTime deadline = rig::HostClock::now() + std::chrono::seconds(10);
  while (status != kOk && rig::HostClock::now() < deadline)
    status = other.write(kPrivilege, 2)->status;
  EXPECT_EQ(status, kOk);
}

}  // namespace
