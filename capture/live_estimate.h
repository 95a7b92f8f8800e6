// The estimator on a thread of its own, fed while the capture goes on.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "capture/bounded_queue.h"
#include "capture/captured_frame.h"
#include "estimation/estimator.h"

namespace capture {

// Calls come from the session thread. The queue has room for every slot: add() does not block.
class LiveEstimate {
 public:
  // As Estimator::create(): `session` holds the auxiliary files, `manifest.frames` has a record for
  // every slot.
  static estimation::Result<std::unique_ptr<LiveEstimate>> start(
      const estimation::Manifest& manifest, const std::filesystem::path& session,
      const estimation::EstimatorOptions& options);
  ~LiveEstimate();
  LiveEstimate(const LiveEstimate&) = delete;
  LiveEstimate& operator=(const LiveEstimate&) = delete;

  void add(const CapturedFrame& frame);
  // Waits for the frames on their way, then estimates on this thread. Once.
  estimation::Result<estimation::SessionEstimate> finish();

 private:
  LiveEstimate(std::unique_ptr<estimation::Estimator> estimator, std::size_t slot_count,
               std::size_t bracket_count);
  void run();

  const std::unique_ptr<estimation::Estimator> estimator_;
  const std::size_t bracket_count_;
  std::optional<estimation::InputError> fault_;  // the estimate thread's until it has ended
  BoundedQueue<CapturedFrame> queue_;
  std::jthread thread_;
};

}  // namespace capture
