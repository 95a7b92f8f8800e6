#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>

#include "estimation/base/linear.h"
#include "estimation/estimator.h"
#include "tests/bench/geometry_bench.h"

namespace bench {
namespace {

using estimation::Image;
using estimation::Maps;
using estimation::Vec3;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInlierPx = 1;

// A set of pixels by their distance to the nearest border, in red's l_d, which is the longest.
struct Zone {
  const char* name;
  double from_l_d, to_l_d;
};
constexpr double kFar = std::numeric_limits<double>::infinity();
constexpr std::array<Zone, 7> kZones{{{"> 2", 2, kFar},
                                      {"0-0.5", 0, 0.5},
                                      {"0.5-1", 0.5, 1},
                                      {"1-2", 1, 2},
                                      {"2-4", 2, 4},
                                      {"> 4", 4, kFar},
                                      {"all", 0, kFar}}};

// Absolute errors of one quantity over a set, in any order.
class Sample {
 public:
  void add(double error) { errors_.push_back(std::abs(error)); }
  double rms() const {
    double sum = 0;
    for (const double error : errors_) sum += error * error;
    return errors_.empty() ? kNaN : std::sqrt(sum / static_cast<double>(errors_.size()));
  }
  double quantile(double share) {
    if (errors_.empty()) return kNaN;
    const auto at = errors_.begin() +
                    static_cast<std::ptrdiff_t>(share * static_cast<double>(errors_.size() - 1));
    std::nth_element(errors_.begin(), at, errors_.end());
    return *at;
  }

 private:
  std::vector<double> errors_;
};

struct ZoneErrors {
  int judged_count = 0, valid_count = 0, outlier_count = 0;
  Sample column_px, column_pull;  // inliers alone
  Sample position_mm, position_pull, normal_deg;

  double outlier_frac() const {
    return valid_count > 0 ? static_cast<double>(outlier_count) / valid_count : kNaN;
  }
};

Vec3 vector_at(const std::array<Image<float>, 3>& image, int row, int col) {
  return {static_cast<double>(image[0].at(row, col)), static_cast<double>(image[1].at(row, col)),
          static_cast<double>(image[2].at(row, col))};
}

double angle_deg(const Vec3& a, const Vec3& b) {
  return std::atan2(cv::norm(a.cross(b)), a.dot(b)) * 180 / std::numbers::pi;
}

void add_pixel(const Maps& maps, const Maps& truth, int row, int col, ZoneErrors& errors) {
  ++errors.judged_count;
  const bool is_valid = (maps.validity[0].at(row, col) & estimation::kValidityErrors &
                         ~(estimation::kOutsideModel | estimation::kNotIdentifiable)) == 0 &&
                        std::isfinite(maps.position_mm[0].at(row, col));
  if (!is_valid) return;
  ++errors.valid_count;
  const auto of = [&](const Image<float>& image) {
    return static_cast<double>(image.at(row, col));
  };
  const double column_px = of(maps.correspondence_px[0]) - of(truth.correspondence_px[0]);
  if (std::abs(column_px) > kInlierPx) {
    ++errors.outlier_count;
  } else {
    errors.column_px.add(column_px);
    errors.column_pull.add(column_px / of(maps.correspondence_sd_px[0]));
  }
  const Vec3 off_mm =
      vector_at(maps.position_mm, row, col) - vector_at(truth.position_mm, row, col);
  errors.position_mm.add(cv::norm(off_mm));
  errors.position_pull.add(cv::norm(off_mm) / of(maps.position_sd_mm));
  errors.normal_deg.add(
      angle_deg(vector_at(maps.normal, row, col), vector_at(truth.normal, row, col)));
}

std::array<ZoneErrors, kZones.size()> judge(const Maps& maps, const GeometryTruth& truth) {
  std::array<ZoneErrors, kZones.size()> zones;
  for (int row = 0; row < maps.height_px; ++row)
    for (int col = 0; col < maps.width_px; ++col) {
      if (!truth.is_judged.at(row, col)) continue;
      double l_d_mm = 0;
      for (int band = 0; band < truth.maps.band_count; ++band)
        l_d_mm = std::max(
            l_d_mm, static_cast<double>(
                        truth.maps.translucency_mm[static_cast<std::size_t>(band)].at(row, col)));
      const double away = static_cast<double>(truth.border_distance_mm.at(row, col)) / l_d_mm;
      for (std::size_t i = 0; i < kZones.size(); ++i)
        if (away >= kZones[i].from_l_d && away < kZones[i].to_l_d)
          add_pixel(maps, truth.maps, row, col, zones[i]);
    }
  return zones;
}

// The pull of a normal variable has median 0.6745.
double pull(Sample& sample) { return sample.quantile(0.5) / 0.6745; }

void add_rows(const std::string& session, const std::string& maps_name,
              std::array<ZoneErrors, kZones.size()> zones, Table& table) {
  for (std::size_t i = 0; i < kZones.size(); ++i) {
    ZoneErrors& zone = zones[i];
    if (zone.judged_count == 0) continue;
    table.rows.push_back({session, maps_name, kZones[i].name, std::to_string(zone.judged_count),
                          percent(static_cast<double>(zone.valid_count) / zone.judged_count),
                          digits(zone.column_px.rms()), percent(zone.outlier_frac()),
                          digits(pull(zone.column_pull)), digits(zone.column_pull.rms()),
                          digits(zone.position_mm.quantile(0.5)), digits(zone.position_mm.rms()),
                          digits(zone.position_mm.quantile(0.95)), digits(pull(zone.position_pull)),
                          digits(zone.normal_deg.quantile(0.5)),
                          digits(zone.normal_deg.quantile(0.95))});
  }
}

}  // namespace

void show_geometry_accuracy(const GeometryOptions& options, Report& report) {
  Table table{"geometry_accuracy",
              "Errors by the distance from a border, in l_d",
              {"session", "maps", "distance, l_d", "pixels", "valid %", "column rms px",
               "beyond 1 px %", "column pull", "pull rms", "position median mm", "position rms mm",
               "p95 mm", "position pull", "normal median deg", "normal p95 deg"}};
  for (const auto& folder : options.sessions) {
    const auto session = read_geometry_session(folder);
    if (!session) {
      report.fail(session.error().text());
      continue;
    }
    const auto geometry = estimation::estimate_session(
        folder, {.thread_count = options.thread_count, .is_geometry_only = true});
    if (!geometry) {
      report.fail(geometry.error().text());
      continue;
    }
    add_rows(session->name, "geometry only", judge(geometry->maps, session->truth), table);
    std::vector<ColumnErrors> panels{{"geometry only", &geometry->maps}};
    const auto maps = estimation::read_maps(folder / "maps");
    if (maps && !maps->correspondence_px[0].empty() &&
        maps->height_px == geometry->maps.height_px) {
      add_rows(session->name, maps->scattering_model, judge(*maps, session->truth), table);
      panels.push_back({maps->scattering_model, &*maps});
    }
    if (!write_error_picture(options.out / ("column_error_" + session->name + ".png"),
                             session->truth, panels))
      report.fail("the picture of " + session->name + " could not be written");
  }
  report.table(table);
}

}  // namespace bench
