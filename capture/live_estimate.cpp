#include "capture/live_estimate.h"

#include <utility>

namespace capture {

using estimation::Result;

Result<std::unique_ptr<LiveEstimate>> LiveEstimate::start(
    const estimation::Manifest& manifest, const std::filesystem::path& session,
    const estimation::EstimatorOptions& options) {
  auto estimator = estimation::Estimator::create(manifest, session, options);
  if (!estimator) return tl::unexpected(estimator.error());
  return std::unique_ptr<LiveEstimate>(
      new LiveEstimate(std::move(*estimator), manifest.frames.size(),
                       manifest.frames.size() / manifest.patterns.size()));
}

LiveEstimate::LiveEstimate(std::unique_ptr<estimation::Estimator> estimator, std::size_t slot_count,
                           std::size_t bracket_count)
    : estimator_(std::move(estimator)),
      bracket_count_(bracket_count),
      queue_(slot_count),
      thread_([this] { run(); }) {}

LiveEstimate::~LiveEstimate() { queue_.close(); }

void LiveEstimate::add(const CapturedFrame& frame) { queue_.push(frame); }

void LiveEstimate::run() {
  while (const auto frame = queue_.pop()) {
    const std::size_t index = static_cast<std::size_t>(frame->slot.pattern) * bracket_count_ +
                              static_cast<std::size_t>(frame->slot.bracket);
    const FrameSamples samples(*frame->frame);
    const auto added = estimator_->add_frame(index, samples.view());
    if (!added && !fault_) fault_ = added.error();
  }
}

Result<estimation::SessionEstimate> LiveEstimate::finish() {
  queue_.close();
  thread_.join();
  if (fault_) return tl::unexpected(*fault_);
  auto maps = estimator_->finish();
  if (!maps) return tl::unexpected(maps.error());
  return estimation::SessionEstimate{std::move(*maps), estimator_->notes(), estimator_->profiles()};
}

}  // namespace capture
