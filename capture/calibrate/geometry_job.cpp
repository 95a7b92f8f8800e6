#include "capture/calibrate/geometry_job.h"

#include <system_error>
#include <utility>

#include "capture/calibrate/session_signals.h"
#include "estimation/calibration/board_observation.h"
#include "estimation/calibration/calibration_file.h"
#include "estimation/calibration/geometry_pictures.h"
#include "estimation/calibration/report_page.h"
#include "estimation/session/file_reading.h"
#include "nlohmann/json.hpp"

namespace capture {

using estimation::CameraInfo;
using estimation::InputError;
using estimation::InputFault;
using estimation::ProjectorInfo;
using estimation::Result;
namespace fs = std::filesystem;

namespace {

bool is_same_rig(const CameraInfo& a, const CameraInfo& b) {
  return a.width_px == b.width_px && a.height_px == b.height_px && a.roi_x_px == b.roi_x_px &&
         a.roi_y_px == b.roi_y_px;
}

}  // namespace

Result<void> GeometryJob::add_session(const fs::path& session) {
  const auto refuse = [&session](const std::string& expectation) {
    return tl::unexpected(InputError{InputFault::kInsufficient, session.string(), "", expectation});
  };
  const auto read = read_signals(session);
  if (!read) return tl::unexpected(read.error());
  const CameraInfo& camera = read->manifest->camera;
  const ProjectorInfo& projector = read->manifest->projector;
  const bool is_first = !camera_;
  const bool is_ours =
      is_first || (is_same_rig(camera, *camera_) && projector.width_px == projector_->width_px &&
                   projector.height_px == projector_->height_px);
  if (!is_ours) return refuse("its camera or projector has another size than the sessions before");
  estimation::CorrespondenceOptions options;
  options.noise = read->noise;
  const std::string name = fs::weakly_canonical(session).filename().string();
  auto pose =
      estimation::observe_board(name, read->single_channel(), board_, camera, projector, options);
  if (!pose) {
    InputError error = pose.error();
    error.file = session.string();
    return tl::unexpected(error);
  }
  camera_ = camera;
  projector_ = projector;
  poses_.push_back(std::move(*pose));
  sessions_.push_back(session.string());
  return {};
}

void GeometryJob::update() {
  fit_.reset();
  check_ = {};
  refusals_.clear();
  if (camera_) {
    auto fit = estimation::fit_geometry(
        poses_, {camera_->roi_x_px + camera_->width_px, camera_->roi_y_px + camera_->height_px},
        {projector_->width_px, projector_->height_px});
    if (fit) {
      fit_ = std::move(*fit);
      check_ = estimation::check_geometry(*fit_, *camera_, *projector_, {});
      refusals_ = check_.refusals;
    } else {
      refusals_.push_back(fit.error().text());
    }
  } else {
    refusals_.push_back("no session shows the board");
  }
  std::vector<estimation::Vec2> corners_mm;
  for (const estimation::BoardPose& pose : poses_)
    if (pose.corners.size() > corners_mm.size()) {
      corners_mm.clear();
      for (const estimation::BoardCorner& corner : pose.corners)
        corners_mm.push_back(corner.board_mm);
    }
  advice_ =
      estimation::advise_pose(fit_ ? &*fit_ : nullptr, poses_.size(), corners_mm,
                              camera_.value_or(CameraInfo{}), projector_.value_or(ProjectorInfo{}));
}

std::string GeometryJob::report() const {
  std::string text = to_string(board_) + "\n";
  if (fit_) text += estimation::describe_geometry(*fit_, check_);
  for (const std::string& refusal : refusals_) text += "\nnot a calibration: " + refusal + "\n";
  if (!advice_.text.empty()) text += "\nthe next pose would be: " + advice_.text + "\n";
  return text;
}

Result<void> GeometryJob::write_report(const fs::path& folder) const {
  if (const auto saved = estimation::save_text(folder / "report.txt", report()); !saved)
    return saved;
  if (fit_)
    if (const auto drawn = estimation::draw_geometry(folder, *fit_, *camera_, *projector_); !drawn)
      return drawn;
  return estimation::write_report_page(folder, "Geometry of the rig", report());
}

std::string GeometryJob::record_json(std::chrono::system_clock::time_point now) const {
  nlohmann::ordered_json json{{"date", estimation::date_text(now)},
                              {"software", "ssrig"},
                              {"board", to_string(board_)},
                              {"pose_count", fit_->poses.size()},
                              {"camera_rms_px", fit_->camera_rms_px},
                              {"projector_rms_px", fit_->projector_rms_px},
                              {"rotation_sd_deg", fit_->rotation_sd_deg()},
                              {"translation_sd_mm", fit_->translation_sd_mm()},
                              {"depth_sd_mm", check_.depth_sd_mm},
                              {"camera_covered_frac", check_.camera.covered_frac},
                              {"projector_covered_frac", check_.projector.covered_frac}};
  for (std::size_t i = 0; i < estimation::kGeometryParameterCount; ++i)
    json["standard_deviations"][estimation::kGeometryParameterNames[i]] = fit_->sd(i);
  for (std::size_t i = 0; i < fit_->poses.size(); ++i) {
    const estimation::PoseFit& pose = fit_->poses[i];
    json["poses"].push_back({{"session", sessions_[i]},
                             {"corner_count", pose.corner_count},
                             {"camera_rms_px", pose.camera_rms_px},
                             {"projector_rms_px", pose.projector_rms_px}});
  }
  return json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

Result<fs::path> GeometryJob::store(const fs::path& path,
                                    std::chrono::system_clock::time_point now) const {
  const auto before = estimation::read_text(path);
  // What is there and cannot be read may hold a radiometry that is not to be lost.
  if (!before && before.error().fault != estimation::InputFault::kNotFound)
    return tl::unexpected(before.error());
  const auto text =
      estimation::format_calibration(before.value_or(""), fit_->calibration,
                                     {estimation::CalibrationPart::kGeometry, record_json(now)});
  if (!text) {
    InputError error = text.error();
    error.file = path.string();
    return tl::unexpected(error);
  }
  return estimation::write_calibration(path, *text);
}

}  // namespace capture
