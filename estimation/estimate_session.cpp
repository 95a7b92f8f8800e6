// A stored session through the estimator.
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <utility>

#include "estimation/auxiliary.h"
#include "estimation/estimator.h"
#include "estimation/session/frame_io.h"

namespace estimation {
namespace {

// Frames read ahead of the merge.
constexpr std::size_t kReadAhead = 16;

// Frames `first` to `last` of the manifest, read in parallel; the first failure in their order.
Result<std::vector<Image<std::uint16_t>>> read_batch(const std::filesystem::path& session,
                                                     const Manifest& manifest, std::size_t first,
                                                     std::size_t last) {
  std::vector<Result<Image<std::uint16_t>>> read(last - first);
  tbb::parallel_for(first, last, [&](std::size_t i) {
    read[i - first] = read_frame(session, manifest, manifest.frames[i].file);
  });
  std::vector<Image<std::uint16_t>> frames;
  for (auto& frame : read) {
    if (!frame)
      return tl::unexpected(
          named_by("/frames/" + std::to_string(first + frames.size()) + "/file", frame.error()));
    frames.push_back(std::move(*frame));
  }
  return frames;
}

}  // namespace

Result<SessionEstimate> estimate_session(
    const std::filesystem::path& session, const EstimatorOptions& options,
    const std::function<void(const EstimateProgress&)>& on_progress) {
  const auto manifest = read_manifest(session);
  if (!manifest) return tl::unexpected(manifest.error());
  // What the Estimator finds wrong with the manifest, it does not know the file of.
  const auto failed = [&](InputError error) {
    if (error.file.empty() && error.place.starts_with('/'))
      error.file = (session / "session.json").string();
    return tl::unexpected(std::move(error));
  };
  auto estimator = Estimator::create(*manifest, session, options);
  if (!estimator) return failed(estimator.error());
  tbb::task_arena readers(options.thread_count > 0 ? options.thread_count
                                                   : tbb::task_arena::automatic);
  const std::size_t frame_count = manifest->frames.size();
  for (std::size_t first = 0; first < frame_count; first += kReadAhead) {
    const std::size_t last = std::min(first + kReadAhead, frame_count);
    const auto frames =
        readers.execute([&] { return read_batch(session, *manifest, first, last); });
    if (!frames) return tl::unexpected(frames.error());
    for (std::size_t i = first; i < last; ++i)
      if (const auto added = (*estimator)->add_frame(i, (*frames)[i - first].view()); !added)
        return tl::unexpected(added.error());
    if (on_progress) on_progress({.stage = "frames", .done = last, .total = frame_count});
  }
  if (on_progress) on_progress({.stage = "maps", .done = 0, .total = 1});
  auto maps = (*estimator)->finish();
  if (!maps) return failed(maps.error());
  if (on_progress) on_progress({.stage = "maps", .done = 1, .total = 1});
  std::vector<std::string> notes = (*estimator)->notes();
  if (manifest->state != SessionState::kComplete)
    notes.insert(notes.begin(),
                 "the capture is not complete: its state is " + to_string(manifest->state));
  return SessionEstimate{
      .maps = std::move(*maps), .notes = std::move(notes), .profiles = (*estimator)->profiles()};
}

}  // namespace estimation
