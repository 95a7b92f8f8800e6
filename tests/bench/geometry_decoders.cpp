#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <limits>
#include <opencv2/core.hpp>
#include <opencv2/structured_light/graycodepattern.hpp>
#include <optional>
#include <variant>

#include "tests/bench/geometry_bench.h"

namespace bench {
namespace {

using estimation::Axis;
using estimation::GrayCode;
using estimation::Image;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// The frames of one exposure in the order OpenCV's decoder wants them, as it wants them: 8 bits.
class OpenCvDecoder {
 public:
  OpenCvDecoder(const GeometrySession& session, double exposure_us)
      : session_(session),
        decoder_(cv::structured_light::GrayCodePattern::create(
            session.manifest.projector.width_px, session.manifest.projector.height_px)) {
    for (const Axis axis : {Axis::kColumn, Axis::kRow}) {
      const int size_px = axis == Axis::kColumn ? session.manifest.projector.width_px
                                                : session.manifest.projector.height_px;
      const int bit_count = static_cast<int>(std::ceil(std::log2(size_px)));
      for (int bit = bit_count - 1; bit >= 0; --bit)
        for (const bool is_inverted : {false, true}) add({axis, bit, is_inverted}, exposure_us);
    }
    images_.resize(frames_.size());
  }

  bool is_complete() const { return frames_.size() == decoder_->getNumberOfPatternImages(); }

  // The upper eight bits of the sensor's.
  void convert() {
    const double scale = 255.0 / ((1 << session_.manifest.camera.pixel_format.bit_depth) - 1);
    tbb::parallel_for(std::size_t{0}, frames_.size(), [&](std::size_t i) {
      const Image<std::uint16_t>& frame = *frames_[i];
      const cv::Mat words(frame.height_px(), frame.width_px(), CV_16U,
                          const_cast<std::uint16_t*>(frame.samples().data()));
      words.convertTo(images_[i], CV_8U, scale);
    });
  }

  // Column of every pixel that it decodes.
  void decode(std::size_t threshold_dn8, Image<float>& column_px) const {
    decoder_->setWhiteThreshold(threshold_dn8);
    tbb::parallel_for(0, column_px.height_px(), [&](int row) {
      cv::Point found;
      for (int col = 0; col < column_px.width_px(); ++col) {
        const bool is_error = decoder_->getProjPixel(images_, col, row, found);
        column_px.at(row, col) = is_error ? kNaN : static_cast<float>(found.x);
      }
    });
  }

 private:
  void add(const GrayCode& code, double exposure_us) {
    for (std::size_t i = 0; i < session_.frames.size(); ++i) {
      const auto& record = session_.manifest.frames[i];
      const auto* kind =
          std::get_if<GrayCode>(&session_.manifest.find_pattern(record.pattern)->kind);
      if (record.exposure_us == exposure_us && kind != nullptr && *kind == code) {
        frames_.push_back(&session_.frames[i]);
        return;
      }
    }
  }

  const GeometrySession& session_;
  cv::Ptr<cv::structured_light::GrayCodePattern> decoder_;
  std::vector<const Image<std::uint16_t>*> frames_;
  std::vector<cv::Mat> images_;
};

struct Score {
  int judged_count = 0, decoded_count = 0, outlier_count = 0;
  double rms_px = 0;  // of the inliers

  double decoded_frac() const { return static_cast<double>(decoded_count) / judged_count; }
  double outlier_frac() const { return static_cast<double>(outlier_count) / decoded_count; }
};

Score score_of(const Image<float>& column_px, const GeometryTruth& truth) {
  Score score;
  double squares = 0;
  for (int row = 0; row < column_px.height_px(); ++row)
    for (int col = 0; col < column_px.width_px(); ++col) {
      if (!truth.is_judged.at(row, col)) continue;
      ++score.judged_count;
      if (std::isnan(column_px.at(row, col))) continue;
      ++score.decoded_count;
      const double error_px = static_cast<double>(column_px.at(row, col) -
                                                  truth.maps.correspondence_px[0].at(row, col));
      if (std::abs(error_px) > 1) {
        ++score.outlier_count;
      } else {
        squares += error_px * error_px;
      }
    }
  score.rms_px = std::sqrt(squares / (score.decoded_count - score.outlier_count));
  return score;
}

std::vector<double> exposures_of(const estimation::Manifest& manifest) {
  std::vector<double> exposures_us;
  for (const auto& frame : manifest.frames) exposures_us.push_back(frame.exposure_us);
  std::sort(exposures_us.begin(), exposures_us.end());
  exposures_us.erase(std::unique(exposures_us.begin(), exposures_us.end()), exposures_us.end());
  return exposures_us;
}

void compare(const GeometrySession& session, const GeometryOptions& options, int thread_count,
             Table& table) {
  const auto& camera = session.manifest.camera;
  const auto add = [&](const std::string& decoder, const Image<float>& column_px, double prepare_ms,
                       double decode_ms) {
    const Score score = score_of(column_px, session.truth);
    table.rows.push_back({session.name, decoder, std::to_string(thread_count), digits(score.rms_px),
                          percent(score.outlier_frac()), percent(score.decoded_frac()),
                          digits(prepare_ms), digits(decode_ms)});
  };
  tbb::task_arena(thread_count).execute([&] {
    Image<float> column_px(camera.height_px, camera.width_px);
    for (const double exposure_us : exposures_of(session.manifest)) {
      OpenCvDecoder opencv(session, exposure_us);
      if (!opencv.is_complete()) continue;
      const double convert_ms = least_ms(options.repeats, [&] { opencv.convert(); });
      for (const std::size_t threshold : {std::size_t{0}, std::size_t{5}}) {
        const double decode_ms =
            least_ms(options.repeats, [&] { opencv.decode(threshold, column_px); });
        add("OpenCV, " + digits(exposure_us / 1000) + " ms, threshold " + std::to_string(threshold),
            column_px, convert_ms, decode_ms);
      }
    }
    // The same memory as OpenCV's: the recorded frames, nothing prepared.
    const auto decode_frames = [&](const std::string& name, const auto& is_used) {
      const PatternFrames frames = frames_by_pattern(session, is_used);
      const auto views = frames.views();
      const auto correspondence_options = frames.correspondence_options();
      estimation::Correspondence found;
      const double decode_ms = least_ms(options.repeats, [&] {
        found = estimation::decode_correspondence(views, session.manifest.projector,
                                                  correspondence_options);
      });
      add(name, found.column_px, 0, decode_ms);
    };
    const auto is_gray = [](const auto& kind) { return std::holds_alternative<GrayCode>(kind); };
    for (const double only_us : exposures_of(session.manifest)) {
      const std::string time = digits(only_us / 1000) + " ms, ";
      decode_frames("ssrig, " + time + "Gray code", [&](const auto& kind, double exposure_us) {
        return exposure_us == only_us && is_gray(kind);
      });
      decode_frames("ssrig, " + time + "all patterns",
                    [&](const auto&, double exposure_us) { return exposure_us == only_us; });
    }
    decode_frames("ssrig, Gray code", [&](const auto& kind, double) { return is_gray(kind); });
    decode_frames("ssrig, all patterns", [](const auto&, double) { return true; });
    GeometrySignals signals;
    const double merge_ms = least_ms(options.repeats, [&] { signals = merge_signals(session); });
    const auto views = signals.views();
    estimation::Correspondence found;
    const double decode_ms = least_ms(options.repeats, [&] {
      found = estimation::decode_correspondence(views, session.manifest.projector, signals.options);
    });
    add("ssrig, all patterns, merged before", found.column_px, merge_ms, decode_ms);
  });
}

}  // namespace

void show_gray_decoders(const GeometryOptions& options, Report& report) {
  Table table{"geometry_decoders",
              "OpenCV's Gray-code decoder and ours on the same frames",
              {"session", "decoder", "threads", "column rms px", "beyond 1 px %", "of the face %",
               "convert or merge ms", "decode ms"}};
  for (const auto& folder : options.sessions) {
    const auto session = read_geometry_session(folder);
    if (!session) {
      report.fail(session.error().text());
      continue;
    }
    compare(*session, options, options.thread_count, table);
    if (options.thread_count > 1) compare(*session, options, 1, table);
  }
  report.table(table);
}

}  // namespace bench
