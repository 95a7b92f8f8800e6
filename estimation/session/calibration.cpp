// Reading the object under "calibration".
#include <algorithm>
#include <cmath>
#include <opencv2/core/matx.hpp>

#include "estimation/session/manifest_parts.h"
#include "estimation/session/transfer_file.h"

namespace estimation {
namespace {

constexpr double kRotationTolerance = 1e-3;

Mat3 read_intrinsics(const JsonValue& value) {
  const std::string what = "intrinsics [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], px";
  const Mat3 K = value.matrix(what);
  const bool is_bottom_row_unit = K(2, 0) == 0 && K(2, 1) == 0 && K(2, 2) == 1;
  // OpenCV's pinhole knows no skew and would ignore it in silence.
  const bool has_skew = K(0, 1) != 0 || K(1, 0) != 0;
  if (!(K(0, 0) > 0 && K(1, 1) > 0) || !is_bottom_row_unit || has_skew) {
    value.fail(what + ", with fx and fy above 0");
  }
  return K;
}

Lens read_lens(const JsonValue& object) {
  Lens lens;
  lens.K = read_intrinsics(object.at("K"));
  if (const auto distortion = object.find("distortion")) {
    const std::string what = "[k1, k2, p1, p2, k3] of OpenCV's model";
    const std::vector<JsonValue> values = distortion->exactly(5, what);
    for (std::size_t i = 0; i < 5; ++i) lens.distortion[i] = values[i].number(what);
  }
  return lens;
}

Mat3 read_rotation(const JsonValue& value) {
  const std::string what = "the rotation from camera to projector";
  const Mat3 R = value.matrix(what);
  const Mat3 residual = R * R.t() - Mat3::eye();
  const double largest_error = cv::norm(residual, cv::NORM_INF);
  if (!(largest_error <= kRotationTolerance) || !(cv::determinant(R) > 0)) {
    value.fail(what + ": rows of length 1, at right angles to 1e-3, determinant +1");
  }
  return R;
}

Vec3 read_translation(const JsonValue& value) {
  const std::string what = "the translation from camera to projector, mm";
  Vec3 t;
  const std::vector<JsonValue> values = value.exactly(3, what);
  for (int i = 0; i < 3; ++i) t[i] = values[static_cast<std::size_t>(i)].number(what);
  constexpr double kLeastBaselineMm = 1e-3;
  if (cv::norm(t) < kLeastBaselineMm)
    value.fail(what +
               ", not zero: camera and projector cannot be in one place; calibrate the geometry");
  return t;
}

enum class Sign { kPositive, kNonNegative };

// One element, or three: whether one is enough is known where the camera is.
std::vector<double> read_bands(const JsonValue& value, Sign sign, const std::string& what) {
  const std::vector<JsonValue> values = value.elements(what);
  if (value.is_array() && values.size() != 1 && values.size() != 3) {
    value.fail("a list of 3 (or 1 for a mono camera): " + what);
  }
  std::vector<double> bands;
  bands.reserve(values.size());
  for (const JsonValue& band : values) {
    bands.push_back(sign == Sign::kPositive ? band.positive(what) : band.non_negative(what));
  }
  return bands;
}

// Without its signal the rest of the object serves nothing: geometry alone is estimated.
std::optional<Irradiance> read_irradiance(const JsonValue& object) {
  const auto signal = object.find("signal_per_us");
  Irradiance irradiance;
  if (const auto distance = object.find("reference_distance_mm")) {
    irradiance.reference_distance_mm =
        distance->positive("the standard's distance from the projector's centre, mm");
  }
  if (const auto file = object.find("vignetting")) {
    irradiance.vignetting_file = file->file_name("an EXR on the projector's px");
  }
  if (!signal) return std::nullopt;
  irradiance.signal_per_us =
      read_bands(*signal, Sign::kPositive, "DN per microsecond from a perfect diffuse reflector");
  return irradiance;
}

std::vector<double> read_harmonics(const JsonValue& value) {
  const std::string what =
      "the optics' contrast at 1, 2, ... cycles per 40 projector px over that of no cycles: optics "
      "never add contrast (values up to 1.02 pass as noise)";
  std::vector<double> harmonics;
  for (const JsonValue& harmonic : value.elements(what)) {
    harmonics.push_back(harmonic.number_in(0, kLargestTransfer, what));
  }
  if (value.is_array() && harmonics.empty()) value.fail("a list of at least 1: " + what);
  return harmonics;
}

TransferByBand read_transfer_by_band(const JsonValue& value) {
  TransferByBand transfer;
  if (value.is_object()) {
    transfer.harmonics = {read_harmonics(value.at("R")), read_harmonics(value.at("G")),
                          read_harmonics(value.at("B"))};
  } else {
    transfer.harmonics.fill(read_harmonics(value));
  }
  return transfer;
}

TransferByDepth read_transfer_by_depth(const JsonValue& value) {
  TransferByDepth by_depth;
  for (const JsonValue& entry : value.elements("transfers by distance")) {
    by_depth.entries.push_back(
        {.distance_mm = entry.at("distance_mm").positive("the distance measured at, mm"),
         .transfer = read_transfer_by_band(entry.at("transfer"))});
  }
  std::ranges::sort(by_depth.entries, {}, &TransferByDepth::Entry::distance_mm);
  const auto twice =
      std::ranges::adjacent_find(by_depth.entries, {}, &TransferByDepth::Entry::distance_mm);
  if (twice != by_depth.entries.end()) value.fail("one entry for each distance_mm");
  return by_depth;
}

StripeTransfer read_stripe_transfer(const JsonValue& value) {
  if (value.is_text()) {
    return TransferFile{value.file_name("an EXR on the camera grid with channels R.1 R.2 ...")};
  }
  if (value.is_array()) {
    const std::vector<JsonValue> elements = value.elements("stripe transfer");
    if (!elements.empty() && elements.front().is_object()) return read_transfer_by_depth(value);
  }
  if (!value.is_array() && !value.is_object()) {
    value.fail(
        "the optics' contrast: [m1, m2, ...], {\"R\": [...], \"G\": [...], \"B\": [...]}, a list "
        "of {\"distance_mm\", \"transfer\"}, or the name of an EXR file");
    return TransferByBand{};
  }
  return read_transfer_by_band(value);
}

}  // namespace

Calibration read_calibration(const JsonValue& object) {
  Calibration calibration;
  calibration.camera = read_lens(object.at("camera"));
  const JsonValue projector = object.at("projector");
  calibration.projector = read_lens(projector);
  calibration.projector_from_camera = read_rotation(projector.at("R"));
  calibration.projector_from_camera_mm = read_translation(projector.at("t"));
  if (const auto irradiance = object.find("irradiance")) {
    calibration.irradiance = read_irradiance(*irradiance);
  }
  if (const auto black = object.find("projector_black")) {
    calibration.projector_black_dn_per_us =
        read_bands(*black, Sign::kNonNegative, "DN per microsecond under a black pattern");
  }
  if (const auto transfer = object.find("stripe_transfer")) {
    calibration.stripe_transfer = read_stripe_transfer(*transfer);
  }
  if (const auto matrix = object.find("color_matrix")) {
    calibration.color_matrix = matrix->matrix("the matrix from camera rgb to display rgb");
  }
  return calibration;
}

Result<Calibration> parse_calibration(std::string_view json, const std::string& file) {
  const Result<Json> document = parse_json(json, file);
  if (!document) return tl::unexpected(document.error());
  JsonErrors errors(file);
  Calibration calibration = read_calibration(JsonValue(*document, errors));
  if (errors.first()) return tl::unexpected(*errors.first());
  return calibration;
}

}  // namespace estimation
