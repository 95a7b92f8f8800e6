// Ctrl-C while a device is being opened, which takes Aravis seconds when nobody answers: it is
// heard before that has come to an end, and what was taken is kept.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <regex>
#include <string>
#include <thread>

#include "rig/clock.h"
#include "tests/wire/rig/wire_capture.h"

namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr int kAborted = 130;

std::string read_text(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void wait_until(const std::function<bool()>& is_so) {
  const auto patience = rig::HostClock::now() + std::chrono::seconds(120);
  while (!is_so() && rig::HostClock::now() < patience)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  ASSERT_TRUE(is_so());
}

// From then on ssrig hears signals by itself.
bool has_blocked_sigint(pid_t pid) {
  const std::string status = read_text("/proc/" + std::to_string(pid) + "/status");
  std::smatch found;
  if (!std::regex_search(status, found, std::regex("SigBlk:\\s*([0-9a-f]+)"))) return false;
  return (std::stoull(found[1], nullptr, 16) >> (SIGINT - 1) & 1) != 0;
}

TEST(WireAborts, AreHeardWhileTheFirstDeviceIsBeingOpened) {
  const WireCapture wire;
  auto child = wire.start_without_rig();
  ASSERT_TRUE(child);
  wait_until([&] { return has_blocked_sigint(child->pid()); });
  child->send(SIGINT);
  EXPECT_EQ(WireCapture::ended(*child), kAborted);
  EXPECT_THAT(wire.output(), HasSubstr("aborted before the first pattern"));
  EXPECT_THAT(wire.output(), Not(HasSubstr("no camera answers"))) << "it was waited for";
  EXPECT_THAT(wire.sessions(), IsEmpty());
}

// A dead camera is closed for 5 s, and then nobody answers for 2.5 s.
TEST(WireAborts, AreHeardWhileALostDeviceIsOpenedAnewAndKeepTheFrames) {
  const WireCapture wire;
  auto child = wire.start("faults = [{fault = \"cable_pulled\", slot = 20, duration_ms = 0}]\n");
  ASSERT_TRUE(child);
  const auto journal = [&] {
    const auto sessions = wire.sessions();
    return sessions.empty() ? std::string() : read_text(sessions.front() / "journal.jsonl");
  };
  wait_until([&] { return journal().find("\"to\":\"reopening\"") != std::string::npos; });
  child->send(SIGINT);
  EXPECT_EQ(WireCapture::ended(*child), kAborted) << wire.output();
  EXPECT_THAT(journal(), HasSubstr("abort requested"));
  EXPECT_THAT(journal(), Not(HasSubstr("reopen refused"))) << "it was waited for";
  const LedgerSession session = wire.judge(wire.sessions().front());
  EXPECT_EQ(session.state, "aborted");
  EXPECT_GT(session.frame_count, 10);
  EXPECT_THAT(session.wrong_frames, IsEmpty());
}

}  // namespace
