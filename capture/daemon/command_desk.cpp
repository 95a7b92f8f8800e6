#include "capture/daemon/command_desk.h"

#include <utility>

namespace capture {

std::optional<Answer> CommandDesk::remembered(const std::string& request_id) const {
  const auto found = answers_.find(request_id);
  return found == answers_.end() ? std::nullopt : std::optional(found->second);
}

Answer CommandDesk::remember(const std::string& request_id, Answer answer) {
  // Only what was done is final: a client that was told "busy" may ask again under the same id.
  if (answer != Answer::kAccepted) return answer;
  answers_[request_id] = answer;
  answer_order_.push_back(request_id);
  if (answer_order_.size() > kRememberedIds) {
    answers_.erase(answer_order_.front());
    answer_order_.pop_front();
  }
  return answer;
}

Answer CommandDesk::request_capture(const CaptureRequest& request) {
  const DaemonPhase phase = board_.snapshot().phase;
  {
    const std::lock_guard lock(mutex_);
    if (const auto answer = remembered(request.request_id)) return *answer;
    if (is_capturing_) return Answer::kBusy;
    if (phase != DaemonPhase::kReady) return Answer::kNotReady;
    is_capturing_ = true;
    capture_stop_ = std::stop_source();
    pending_ = request;
    remember(request.request_id, Answer::kAccepted);
  }
  requested_.notify_one();
  return Answer::kAccepted;
}

Answer CommandDesk::request_abort(const std::string& request_id) {
  std::optional<std::stop_source> stop;
  {
    const std::lock_guard lock(mutex_);
    if (const auto answer = remembered(request_id)) return *answer;
    if (!is_capturing_) return Answer::kNothing;
    stop.emplace(capture_stop_);
    remember(request_id, Answer::kAccepted);
  }
  stop->request_stop();  // outside the lock: it may run callbacks
  board_.update([](DaemonSnapshot& snapshot) {
    // The capture may have ended meanwhile, or its device been lost: that stays.
    if (snapshot.phase == DaemonPhase::kCapturing || snapshot.phase == DaemonPhase::kEstimating)
      snapshot.phase = DaemonPhase::kAborting;
  });
  return Answer::kAccepted;
}

std::optional<CaptureRequest> CommandDesk::next_capture(
    std::chrono::steady_clock::time_point deadline, const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  if (!requested_.wait_until(lock, stop, deadline, [this] { return pending_.has_value(); }))
    return std::nullopt;
  return std::exchange(pending_, std::nullopt);
}

std::stop_token CommandDesk::capture_stop() const {
  const std::lock_guard lock(mutex_);
  return capture_stop_.get_token();
}

void CommandDesk::capture_finished() {
  const std::lock_guard lock(mutex_);
  is_capturing_ = false;
}

}  // namespace capture
