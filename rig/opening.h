// A device that is closed and opened on a thread of its own: of a dead one either takes seconds,
// in which whoever wants it must hear other things.
#pragma once

#include <chrono>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <thread>
#include <utility>

#include "rig/clock.h"
#include "rig/fault.h"

namespace rig {

// The device belongs to one thread at a time: to the caller until reopen() or close() has it, to
// the thread until take() hands it out. One thread at most. reopen(), close() and take() come from
// one thread, or from several one after the other; the rest is thread-safe.
//
//   Idle ─reopen─► UnderWay ─over─► Over ─take─► Idle
//   Idle ─close──► UnderWay ─over─► Idle
template <typename Device>
class Opening {
 public:
  using Opened = Result<std::unique_ptr<Device>>;

  // `open` is called on the thread, when the old device is gone; `on_over` at the end, or by
  // reopen() where there is nothing to do.
  Opening(std::function<Opened()> open, std::function<void()> on_over)
      : open_(std::move(open)), on_over_(std::move(on_over)) {}
  // Waits for what is under way; a device that nobody took is closed.
  ~Opening() = default;
  Opening(const Opening&) = delete;
  Opening& operator=(const Opening&) = delete;

  // Closes `old`, if there is one, and opens. What is under way goes on; a good device that nobody
  // took is as good as a new one.
  void reopen(std::unique_ptr<Device> old) {
    if (is_under_way()) return;
    if (has_good_one()) return on_over_();
    run([this, old = std::move(old)]() mutable {
      old.reset();
      end_with(open_());
      on_over_();
    });
  }

  // Closes `old` and whatever else is there, and tells nobody. Not while something is under way.
  void close(std::unique_ptr<Device> old) {
    run([this, old = std::move(old), unused = take()]() mutable {
      old.reset();
      unused.reset();
      end_with({});
    });
  }

  // nullopt: nothing came to an end since this was last asked.
  std::optional<Opened> take() {
    const std::lock_guard lock(mutex_);
    return std::exchange(opened_, {});
  }

  bool is_under_way() const {
    const std::lock_guard lock(mutex_);
    return is_under_way_;
  }
  // Until nothing is under way; false: at `deadline` or on stop it still was.
  bool wait(HostTime deadline, const std::stop_token& stop) const {
    std::unique_lock lock(mutex_);
    over_.wait_until(lock, stop, deadline, [this] { return !is_under_way_; });
    return !is_under_way_;
  }

 private:
  bool has_good_one() const {
    const std::lock_guard lock(mutex_);
    return opened_ && opened_->has_value();
  }
  template <typename Work>
  void run(Work work) {
    {
      const std::lock_guard lock(mutex_);
      opened_.reset();  // at most an error
      is_under_way_ = true;
    }
    thread_ = std::jthread(std::move(work));
  }
  void end_with(std::optional<Opened> opened) {
    {
      const std::lock_guard lock(mutex_);
      opened_ = std::move(opened);
      is_under_way_ = false;
    }
    over_.notify_all();
  }

  const std::function<Opened()> open_;
  const std::function<void()> on_over_;
  mutable std::mutex mutex_;
  mutable std::condition_variable_any over_;
  bool is_under_way_ = false;     // guarded by mutex_
  std::optional<Opened> opened_;  // guarded by mutex_
  std::jthread thread_;
};

}  // namespace rig
