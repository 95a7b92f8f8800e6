// Geometry from sessions of a board, one a pose: observe, fit, judge, advise, store.
#pragma once

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "estimation/calibration/board.h"
#include "estimation/calibration/geometry_check.h"
#include "estimation/calibration/geometry_fit.h"
#include "estimation/calibration/pose_advice.h"
#include "estimation/session/error.h"
#include "estimation/session/manifest.h"

namespace capture {

// Feed it poses, ask it after each. Not thread-safe.
class GeometryJob {
 public:
  explicit GeometryJob(estimation::Board board) : board_(board) {}

  // A session as one more pose. Errors: why it is none (no board seen, another rig, files); the
  // poses so far are as they were.
  estimation::Result<void> add_session(const std::filesystem::path& session);

  // Fits all poses so far. Fewer than can be fitted leave fit() empty, with the reason in
  // refusals().
  void update();

  std::size_t pose_count() const { return poses_.size(); }
  const std::optional<estimation::GeometryFit>& fit() const { return fit_; }
  const estimation::GeometryCheck& check() const { return check_; }
  const estimation::PoseAdvice& advice() const { return advice_; }
  const std::vector<std::string>& refusals() const { return refusals_; }
  // Tables for people: poses, parameters, coverage, what is missing.
  std::string report() const;
  // The pictures of the report as PNG files into `folder`, report.txt, and both as report.html.
  estimation::Result<void> write_report(const std::filesystem::path& folder) const;

  // Puts the fit into the calibration file `path`; the older one is kept beside it. Returns that,
  // or empty. Only after an update() without refusals.
  estimation::Result<std::filesystem::path> store(const std::filesystem::path& path,
                                                  std::chrono::system_clock::time_point now) const;

 private:
  std::string record_json(std::chrono::system_clock::time_point now) const;

  estimation::Board board_;
  std::optional<estimation::CameraInfo> camera_;
  std::optional<estimation::ProjectorInfo> projector_;
  std::vector<estimation::BoardPose> poses_;
  std::vector<std::string> sessions_;
  std::optional<estimation::GeometryFit> fit_;
  estimation::GeometryCheck check_;
  estimation::PoseAdvice advice_;
  std::vector<std::string> refusals_;
};

}  // namespace capture
