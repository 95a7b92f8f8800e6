#include "capture/daemon/http_request.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/daemon/state_board.h"

namespace {

using capture::is_own_origin;
using capture::parse_command;
using testing::HasSubstr;

constexpr const char* kJson = "application/json";

TEST(HttpRequest, ACommandIsRead) {
  const auto command =
      parse_command("application/json; charset=utf-8",
                    R"({"request_id": "a-1", "subject": "anna", "directory": "/data/sessions"})");
  ASSERT_TRUE(command) << command.error().text;
  EXPECT_EQ(command->request_id, "a-1");
  EXPECT_EQ(command->subject, "anna");
  EXPECT_EQ(command->directory, "/data/sessions");
}

TEST(HttpRequest, WhatIsNoCommandIsRefusedWithItsReason) {
  const std::string long_text(201, 'x');
  const std::pair<std::string, const char*> bodies[] = {
      {"", "request_id"},
      {"[]", "request_id"},
      {R"({"request_id": 5})", "request_id"},
      {R"({"request_id": ""})", "request_id"},
      {R"({"request_id": "a", "subjekt": "b"})", "unknown key \"subjekt\""},
      {R"({"request_id": "a", "subject": ")" + long_text + "\"}", "at most 200 bytes"},
      {R"({"request_id": "a", "directory": "sessions"})", "absolute"},
      {R"({"request_id": "a", "directory": "/tmp/a\u0000b"})", "zero byte"},
      {"{\"request_id\": \"\xff\"}", "request_id"},
      {std::string(16000, '['), "request_id"}};
  for (const auto& [body, reason] : bodies) {
    SCOPED_TRACE(body);
    const auto command = parse_command(kJson, body);
    ASSERT_FALSE(command);
    EXPECT_EQ(command.error().status, 400);
    EXPECT_THAT(command.error().text, HasSubstr(reason));
  }
  const auto form = parse_command("application/x-www-form-urlencoded", "request_id=a");
  ASSERT_FALSE(form);
  EXPECT_EQ(form.error().status, 415);
}

TEST(HttpRequest, OnlyPagesOfThisDaemonAreServed) {
  const std::string own = "http://localhost:8640", foreign = "http://evil.example:8640", empty = "",
                    secure = "https://localhost:8640";
  EXPECT_TRUE(is_own_origin("127.0.0.1:8640", nullptr, 8640));
  EXPECT_TRUE(is_own_origin("[::1]:8640", &own, 8640));
  EXPECT_FALSE(is_own_origin("127.0.0.1:8641", nullptr, 8640));
  EXPECT_FALSE(is_own_origin("evil.example:8640", nullptr, 8640));
  for (const std::string* origin : {&foreign, &empty, &secure})
    EXPECT_FALSE(is_own_origin("127.0.0.1:8640", origin, 8640)) << *origin;
}

TEST(DaemonAnswer, ASnapshotComesBackAsItWasSent) {
  capture::DaemonSnapshot sent{.revision = 1ULL << 40U,
                               .phase = capture::DaemonPhase::kEstimating,
                               .rig_file = "/rigs/a.toml",
                               .rig_name = "a",
                               .message = "estimating",
                               .request_id = "r",
                               .slots_filled = 3,
                               .slots_total = 176,
                               .retake_count = 1,
                               .notes = {"one", "two"},
                               .last = capture::CaptureOutcome{.request_id = "q",
                                                               .session = "/s",
                                                               .state = "complete",
                                                               .exit_code = 4,
                                                               .message = "m",
                                                               .pictures = {"a.png"},
                                                               .notes = {}}};
  const auto received = capture::parse_snapshot(to_json(sent));
  ASSERT_TRUE(received);
  EXPECT_EQ(received->revision, sent.revision);
  EXPECT_EQ(to_json(*received), to_json(sent));
}

TEST(DaemonAnswer, WhateverElseAnswersOnThePortIsNoSnapshot) {
  for (const char* body : {"", "<html>", "[]", "{}", "null", R"({"phaze": "ready"})"})
    EXPECT_FALSE(capture::parse_snapshot(body)) << body;
  const auto odd = capture::parse_snapshot(
      R"({"phase": 7, "slots_total": 1e300, "revision": -5, "notes": [1, "a"], "last": []})");
  ASSERT_TRUE(odd);
  EXPECT_EQ(odd->phase, capture::DaemonPhase::kFault);
  EXPECT_EQ(odd->slots_total, 0);
  EXPECT_EQ(odd->revision, 0U);
  EXPECT_EQ(odd->notes, std::vector<std::string>{"a"});
  EXPECT_FALSE(odd->last);
}

}  // namespace
