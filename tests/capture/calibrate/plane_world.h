// A flat thing in front of the virtual rig's devices: any picture the projector shows, through both
// lenses, with the projector's blur and the sensor's noise. Its truth is known.
#pragma once

#include <random>

#include "hw_sim/world.h"
#include "tests/capture/calibrate/rendered_session.h"

namespace capture::testing {

class PlaneWorld final : public hw_sim::World {
 public:
  // `signal_per_us` of a reflectance of 1 in the middle of a target at 1000 mm; see
  // lit_by_projector() for cosine and distance.
  PlaneWorld(const estimation::testing::SyntheticRig& rig,
             const estimation::testing::RigidPlace& place,
             const estimation::testing::Albedo& albedo, double blur_px, double signal_per_us)
      : pose_(rig, place, albedo, {}), blur_px_(blur_px), signal_per_us_(signal_per_us) {}

  int width_px() const override { return pose_.albedo().cols; }
  int height_px() const override { return pose_.albedo().rows; }
  int channel_count() const override { return 1; }

  void expose(const hw_sim::Exposure& exposure,
              estimation::ImageView<std::uint16_t> frame_dn) const override {
    cv::Mat1f signal(height_px(), width_px(), 0.0F);
    for (const hw_sim::LightSegment& segment : exposure.light)
      if (segment.picture)
        add(segment.picture->brightness,
            std::chrono::duration<double, std::micro>(segment.duration).count(), signal);
    std::mt19937_64 random(exposure.trigger_number);
    for (int row = 0; row < height_px(); ++row)
      for (int col = 0; col < width_px(); ++col) {
        const auto dn = static_cast<double>(signal(row, col));
        const double sd = std::sqrt(dn / kGain + kReadNoise * kReadNoise / kGain / kGain);
        const std::uint64_t bits = random();
        double deviate = 0;
        for (int i = 0; i < 4; ++i)
          deviate += static_cast<double>(bits >> (16 * i) & 0xffff) / 65536 - 0.5;
        frame_dn.at(row, col) = static_cast<std::uint16_t>(
            std::clamp(std::lround(kBlackDn + dn + sd * std::sqrt(3.0) * deviate), 0L, 4095L));
      }
  }

 private:
  // A projector pixel is a square: the picture, twice as fine, blurred, and read where the
  // surface point lies.
  void add(const estimation::Image<unsigned char>& picture, double duration_us,
           cv::Mat1f& signal) const {
    constexpr int kFine = 2;
    cv::Mat1f light(picture.height_px(), picture.width_px());
    for (int row = 0; row < light.rows; ++row)
      for (int col = 0; col < light.cols; ++col)
        light(row, col) = static_cast<float>(picture.at(row, col)) / 255;
    cv::resize(light, light, {}, kFine, kFine, cv::INTER_NEAREST);
    cv::GaussianBlur(light, light, {}, kFine * blur_px_);
    cv::Mat columns, rows;
    pose_.column_px().convertTo(columns, CV_32F, kFine, 0.5 * kFine - 0.5);
    pose_.row_px().convertTo(rows, CV_32F, kFine, 0.5 * kFine - 0.5);
    cv::Mat1f seen;
    cv::remap(light, seen, columns, rows, cv::INTER_LINEAR, cv::BORDER_CONSTANT, cv::Scalar(0));
    const auto scale = static_cast<float>(signal_per_us_ * duration_us);
    for (int row = 0; row < seen.rows; ++row)
      for (int col = 0; col < seen.cols; ++col)
        signal(row, col) += scale * pose_.albedo()(row, col) * seen(row, col);
  }

  estimation::testing::RenderedPose pose_;
  double blur_px_;
  double signal_per_us_;
};

}  // namespace capture::testing
