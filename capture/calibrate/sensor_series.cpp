#include "capture/calibrate/sensor_series.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <utility>

#include "capture/calibrate/session_signals.h"
#include "estimation/session/frame_io.h"

namespace capture {

using estimation::InputError;
using estimation::InputFault;
using estimation::LightPair;
using estimation::Manifest;
using estimation::Result;
using estimation::SensorFit;

namespace {

// Beyond these a dark frame is not dark. A warm sensor's dark current is some electrons a second.
constexpr double kBrightAreaDn = 8;       // between the 95th and the 5th percentile of 8 x 8 means
constexpr double kDarkGrowthFrac = 0.01;  // of the range, from the shortest exposure to the longest
// A frame is clipped where more than this share of its samples is.
constexpr double kClippedFrac = 0.001;
// A pixel is of the lit field above this share of the brightest ones.
constexpr double kLitFrac = 0.3;

// What an even pattern asks of the projector; none for patterns that vary.
std::optional<double> even_drive(const estimation::PatternKind& kind,
                                 const estimation::ProjectorInfo& projector) {
  if (std::holds_alternative<estimation::White>(kind)) return 1.0;
  if (std::holds_alternative<estimation::Black>(kind)) return 0.0;
  const auto* fringe = std::get_if<estimation::Fringe>(&kind);
  if (!fringe) return std::nullopt;
  const double first = brightness(kind, 0, 0);
  const double last = brightness(kind, projector.height_px - 1, projector.width_px - 1);
  const bool is_wide = fringe->period_px > 4 * std::max(projector.width_px, projector.height_px);
  constexpr double kEvenFrac = 0.004;  // one of 256 levels
  if (!is_wide || std::abs(last - first) > kEvenFrac) return std::nullopt;
  return (first + last) / 2;
}

// Means of squares of 8 x 8 samples: noise is gone, light is not.
std::vector<double> area_means(const estimation::Image<std::uint16_t>& dn) {
  constexpr int kSide = 8;
  std::vector<double> means;
  for (int row = 0; row + kSide <= dn.height_px(); row += kSide)
    for (int col = 0; col + kSide <= dn.width_px(); col += kSide) {
      double sum = 0;
      for (int i = 0; i < kSide * kSide; ++i) sum += dn.at(row + i / kSide, col + i % kSide);
      means.push_back(sum / (kSide * kSide));
    }
  std::ranges::sort(means);
  return means;
}

struct Difference {
  double mean_dn = 0;      // of both frames, black removed
  double change_dn = 0;    // of the mean, by as much as the colour that changed most
  double scatter_dn = 0;   // of one frame's pixel, rms beyond its colour's change
  double expected_dn = 0;  // of that
  double highest_dn = 0;   // raw

  bool is_clipped_at(double saturation_dn) const { return highest_dn >= saturation_dn; }
};

// Over `field` alone: pixels that white lights.
Difference compare(const estimation::Image<std::uint16_t>& a,
                   const estimation::Image<std::uint16_t>& b, const std::vector<char>& field,
                   double black_dn, const SensorFit& sensor) {
  struct Sums {
    double a = 0, b = 0, count = 0;
    double ratio() const { return a > 0 && b > 0 ? a / b : 1; }
  };
  std::vector<Sums> sites(4 * static_cast<std::size_t>(a.channel_count()));
  Sums all;
  Difference d;
  const auto sa = a.samples(), sb = b.samples();
  const auto row_size =
      static_cast<std::size_t>(a.width_px()) * static_cast<std::size_t>(a.channel_count());
  const auto site_of = [&](std::size_t i) {
    return estimation::mosaic_site(static_cast<int>(i / row_size), i % row_size, a.channel_count());
  };
  for (std::size_t i = 0; i < field.size(); ++i) {
    if (!field[i]) continue;
    for (Sums* sums : {&all, &sites[site_of(i)]}) {
      sums->a += sa[i] - black_dn;
      sums->b += sb[i] - black_dn;
      ++sums->count;
    }
    d.highest_dn = std::max<double>(d.highest_dn, std::max(sa[i], sb[i]));
  }
  const double count = all.count;
  if (count == 0) return d;
  d.mean_dn = (all.a + all.b) / (2 * count);
  for (const Sums& site : sites) {
    if (site.count == 0) continue;
    const double level_dn = (site.a + site.b) / (2 * site.count);
    const double scale = level_dn > 0 ? std::max(d.mean_dn, 0.0) / level_dn : 1;
    const double change_dn = (site.b - site.a) / site.count * scale;
    if (std::abs(change_dn) > std::abs(d.change_dn)) d.change_dn = change_dn;
  }
  double squares = 0;
  for (std::size_t i = 0; i < field.size(); ++i) {
    if (!field[i]) continue;
    const double ratio = sites[site_of(i)].ratio();
    const double difference = (sa[i] - black_dn) - ratio * (sb[i] - black_dn);
    squares += difference * difference / (1 + ratio * ratio);
  }
  d.scatter_dn = std::sqrt(squares / count);
  const double read_dn = sensor.read_noise_e.value / sensor.gain_e_per_dn.value;
  d.expected_dn = std::sqrt(std::max(d.mean_dn, 0.0) / sensor.gain_e_per_dn.value +
                            read_dn * read_dn + 1.0 / 12);
  return d;
}

}  // namespace

Result<void> SensorSeries::read(const std::filesystem::path& session, const Manifest& manifest,
                                const std::string& file, double exposure_us,
                                std::optional<double> drive_frac) {
  auto frame = estimation::read_frame(session, manifest, file);
  if (!frame) return tl::unexpected(frame.error());
  const bool is_other =
      !frames_.empty() && (frames_.front().dn.width_px() != frame->width_px() ||
                           frames_.front().dn.height_px() != frame->height_px() ||
                           frames_.front().dn.channel_count() != frame->channel_count());
  if (is_other)
    return tl::unexpected(InputError{InputFault::kInvalid, session.string(), file,
                                     "its size is not that of the sessions before"});
  frames_.push_back({exposure_us, drive_frac, std::move(*frame)});
  return {};
}

Result<void> SensorSeries::add_dark(const std::filesystem::path& session) {
  const auto manifest = estimation::read_manifest(session);
  if (!manifest) return tl::unexpected(manifest.error());
  saturation_dn_ = saturation_of(*manifest);
  for (const estimation::FrameRecord& record : manifest->frames)
    if (const auto added = read(session, *manifest, record.file, record.exposure_us, std::nullopt);
        !added)
      return added;
  return {};
}

Result<void> SensorSeries::add_lit(const std::filesystem::path& session) {
  const auto manifest = estimation::read_manifest(session);
  if (!manifest) return tl::unexpected(manifest.error());
  camera_ = manifest->camera;
  saturation_dn_ = saturation_of(*manifest);
  for (const estimation::DarkFrame& dark : manifest->camera.dark_frames)
    if (const auto added = read(session, *manifest, dark.file, dark.exposure_us, std::nullopt);
        !added)
      return added;
  for (const estimation::FrameRecord& record : manifest->frames) {
    const estimation::Pattern* pattern = manifest->find_pattern(record.pattern);
    const auto drive_frac = pattern ? even_drive(pattern->kind, manifest->projector) : std::nullopt;
    if (!drive_frac) continue;
    if (const auto added = read(session, *manifest, record.file, record.exposure_us, drive_frac);
        !added)
      return added;
  }
  return {};
}

Result<void> SensorSeries::check_dark() const {
  const auto light = [](const std::string& what) {
    return tl::unexpected(
        InputError{InputFault::kInsufficient, "", "",
                   "the frames are not dark: " + what + "; cap the lens and darken the room"});
  };
  const Frame *shortest = nullptr, *longest = nullptr;
  for (const Frame& frame : frames_) {
    if (frame.drive_frac) continue;
    if (!shortest || frame.exposure_us < shortest->exposure_us) shortest = &frame;
    if (!longest || frame.exposure_us > longest->exposure_us) longest = &frame;
  }
  if (!longest) return light("there is none");
  const std::vector<double> least = area_means(shortest->dn), most = area_means(longest->dn);
  if (most.empty()) return {};  // a few pixels tell nothing
  const double step_dn = most[most.size() * 19 / 20] - most[most.size() / 20];
  if (step_dn > kBrightAreaDn)
    return light("areas differ by " + std::to_string(std::lround(step_dn)) + " DN");
  const double growth_dn = most[most.size() / 2] - least[least.size() / 2];
  if (growth_dn > kDarkGrowthFrac * saturation_dn_)
    return light("the longest exposure is " + std::to_string(std::lround(growth_dn)) +
                 " DN above the shortest");
  return {};
}

// The more exposures are unclipped the more is known of the sensor; of equals the brightest.
double SensorSeries::fullest_drive() const {
  std::map<double, std::set<double>> exposures_us;  // by drive
  for (const Frame& frame : frames_) {
    if (!frame.drive_frac || *frame.drive_frac == 0) continue;
    const auto samples = frame.dn.samples();
    const auto clipped =
        std::ranges::count_if(samples, [this](std::uint16_t dn) { return dn >= saturation_dn_; });
    auto& unclipped = exposures_us[*frame.drive_frac];
    if (static_cast<double>(clipped) <= kClippedFrac * static_cast<double>(samples.size()))
      unclipped.insert(frame.exposure_us);
  }
  double drive = 1;
  std::size_t most = 0;
  for (const auto& [each, unclipped] : exposures_us)
    if (unclipped.size() >= most) {
      drive = each;
      most = unclipped.size();
    }
  return drive;
}

std::vector<estimation::SeriesFrame> SensorSeries::frames() const {
  std::vector<estimation::SeriesFrame> frames;
  const double drive = fullest_drive();
  for (const Frame& frame : frames_)
    if (!frame.drive_frac || *frame.drive_frac == drive)
      frames.push_back({frame.exposure_us, !frame.drive_frac, frame.dn.view()});
  return frames;
}

// The pixels that white lights, the same for every exposure: of the longest exposure under white
// that clips nothing (else of the shortest, without what it clips).
std::vector<char> SensorSeries::lit_field(double black_dn) const {
  const Frame* chosen = nullptr;
  bool is_whole = false;
  for (const Frame& frame : frames_) {
    if (frame.drive_frac != 1) continue;
    const bool clips = std::ranges::any_of(frame.dn.samples(),
                                           [&](std::uint16_t dn) { return dn >= saturation_dn_; });
    const bool is_better =
        !chosen || (clips ? !is_whole && frame.exposure_us < chosen->exposure_us
                          : !is_whole || frame.exposure_us > chosen->exposure_us);
    if (!is_better) continue;
    chosen = &frame;
    is_whole = !clips;
  }
  if (!chosen) return {};
  std::vector<std::uint16_t> sorted;
  for (const std::uint16_t dn : chosen->dn.samples())
    if (dn < saturation_dn_) sorted.push_back(dn);
  if (sorted.empty()) return {};
  const auto bright = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() * 19 / 20);
  std::nth_element(sorted.begin(), bright, sorted.end());
  const double least_dn = black_dn + kLitFrac * (*bright - black_dn);
  std::vector<char> field;
  for (const std::uint16_t dn : chosen->dn.samples())
    field.push_back(dn > least_dn && dn < saturation_dn_ ? 1 : 0);
  return field;
}

std::vector<LightPair> SensorSeries::pairs(const SensorFit& sensor) const {
  std::vector<LightPair> pairs;
  const std::vector<char> field = lit_field(sensor.black_level_dn.value);
  if (std::ranges::count(field, 1) == 0) return pairs;
  double white_rate = 0, white_count = 0;
  for (std::size_t i = 0; i < frames_.size(); ++i) {
    const Frame& first = frames_[i];
    if (!first.drive_frac) continue;
    const auto is_equal = [&](const Frame& other) {
      return other.drive_frac == first.drive_frac && other.exposure_us == first.exposure_us;
    };
    const auto here = frames_.begin() + static_cast<std::ptrdiff_t>(i);
    const auto second = std::find_if(here + 1, frames_.end(), is_equal);
    const bool is_second = std::count_if(frames_.begin(), here, is_equal) % 2 != 0;
    if (is_second || second == frames_.end()) continue;
    const double black_dn =
        sensor.black_level_dn.value + sensor.dark_signal_dn_per_us.value * first.exposure_us;
    const Difference d = compare(first.dn, second->dn, field, black_dn, sensor);
    if (d.is_clipped_at(saturation_dn_)) continue;
    pairs.push_back({.drive_frac = *first.drive_frac,
                     .exposure_us = first.exposure_us,
                     .rate_dn_per_us = d.mean_dn / first.exposure_us,
                     .change_frac = d.change_dn / first.exposure_us,
                     .scatter_frac = d.scatter_dn / first.exposure_us,
                     .expected_frac = d.expected_dn / first.exposure_us});
    if (*first.drive_frac != 1) continue;
    white_rate += pairs.back().rate_dn_per_us;
    ++white_count;
  }
  if (white_count == 0) return {};
  white_rate /= white_count;
  for (LightPair& pair : pairs) {
    pair.change_frac /= white_rate;
    // Of its own level; of a black picture, of a hundredth of white.
    const double level = std::max(pair.rate_dn_per_us, 0.01 * white_rate);
    pair.scatter_frac /= level;
    pair.expected_frac /= level;
  }
  return pairs;
}

}  // namespace capture
