// The one place that calls OpenCV's image decoders, and the one that catches what they throw.
#include "estimation/session/image_file.h"

#include <algorithm>
#include <exception>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgcodecs.hpp>

namespace estimation {
namespace {

// OpenCV's decoders report a damaged file on stderr too; our callers get an error and say it once.
void silence_opencv() {
  static const auto kPrevious =
      cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  static_cast<void>(kPrevious);
}

template <typename T>
Image<std::uint16_t> rgb_samples(const cv::Mat& bgr) {
  const int channel_count = bgr.channels();
  Image<std::uint16_t> image(bgr.rows, bgr.cols, channel_count);
  for (int row = 0; row < bgr.rows; ++row) {
    const T* source = bgr.ptr<T>(row);
    const auto target = image.view().row(row);
    if (channel_count == 1) {
      std::copy_n(source, bgr.cols, target.begin());
      continue;
    }
    for (std::size_t i = 0; i < target.size(); i += 3) {
      target[i] = source[i + 2];
      target[i + 1] = source[i + 1];
      target[i + 2] = source[i];
    }
  }
  return image;
}

}  // namespace

Result<Image<std::uint16_t>> decode_image(const std::vector<std::byte>& bytes,
                                          const ImageHeader& header, const std::string& file) {
  const auto damaged = [&](const std::string& why) {
    return tl::unexpected(InputError{InputFault::kUnreadable, file, "",
                                     "its samples cannot be decoded" + why +
                                         "; expected a whole TIFF or PNG file: copy it "
                                         "again from its source"});
  };
  try {
    silence_opencv();
    // A borrowed view: imdecode takes its input by const reference and does not write to it.
    const cv::Mat encoded(1, static_cast<int>(bytes.size()), CV_8UC1,
                          const_cast<std::byte*>(bytes.data()));  // NOLINT
    const cv::Mat decoded = cv::imdecode(encoded, cv::IMREAD_UNCHANGED);
    const int depth = header.bit_depth == 8 ? CV_8U : CV_16U;
    const bool is_as_promised = decoded.rows == header.height_px &&
                                decoded.cols == header.width_px && decoded.depth() == depth &&
                                decoded.channels() == header.channel_count;
    if (!is_as_promised) return damaged("");
    return depth == CV_8U ? rgb_samples<std::uint8_t>(decoded)
                          : rgb_samples<std::uint16_t>(decoded);
  } catch (const std::exception& error) {  // cv::Exception, std::bad_alloc
    return damaged(std::string(" (") + error.what() + ")");
  }
}

}  // namespace estimation
