// The queue between two of our threads. Full-policy: push() blocks, so nothing is ever dropped.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <utility>

#include "estimation/base/check.h"

namespace capture {

// Thread-safe. One side pushes and closes, the other pops until nullopt: closing ends the waiting,
// not the draining.
template <typename T>
class BoundedQueue {
 public:
  explicit BoundedQueue(std::size_t capacity) : capacity_(capacity) {
    estimation::check(capacity > 0, "queue without room");
  }

  // Blocks while full: the popping side must never wait for the pushing one.
  void push(T item) {
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return items_.size() < capacity_; });
      estimation::check(!is_closed_, "push to a closed queue");
      items_.push_back(std::move(item));
    }
    changed_.notify_all();
  }

  // The oldest item; nullopt once the queue is closed and empty.
  std::optional<T> pop() {
    std::optional<T> item;
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return is_closed_ || !items_.empty(); });
      if (items_.empty()) return std::nullopt;
      item = std::move(items_.front());
      items_.pop_front();
    }
    changed_.notify_all();
    return item;
  }

  void close() {
    {
      const std::lock_guard lock(mutex_);
      is_closed_ = true;
    }
    changed_.notify_all();
  }

 private:
  const std::size_t capacity_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<T> items_;     // guarded by mutex_
  bool is_closed_ = false;  // guarded by mutex_
};

}  // namespace capture
