// The journal's lines: how a take was begun, and one for each step of the sequence.
#pragma once

#include <chrono>
#include <map>
#include <string>

#include "capture/runner.h"
#include "capture/take.h"
#include "estimation/motion/picture_identity.h"
#include "rig/rig_file.h"

namespace capture {

// What shapes a frame, or the order of frames, and is not in the manifest; by the rig file's names.
std::map<std::string, std::string> journalled_settings(const rig::RigFile& rig_file);

// The first line: the slots and the order of projection of the session's patterns, the settings,
// and which positions of the run are repeats. capture/stored_take.h reads it.
std::string begin_line(const rig::RigFile& rig_file, const Plan& session_plan, const Take& take);

// A take that was interrupted goes on.
std::string resume_line(int good_count, const Take& take);

// It does not, and why.
std::string refusal_line(const std::string& text);

// Sync mode software: how long after the swap the camera is triggered, as measured.
std::string latency_line(std::chrono::nanoseconds latency);

// What the repeats said of the subject, and how long after the last frame.
std::string motion_line(const std::string& verdict, std::chrono::nanoseconds verdict_time);

// Whether the frames show their patterns.
std::string picture_line(const estimation::PictureCheck& check);
// Slots are taken again because theirs do not.
std::string retake_line(const Take& take);

// One JSON object: time since `start`, event, phases, pattern, and what was found and done.
std::string journal_line(const Transition& transition, rig::HostTime start);

}  // namespace capture
