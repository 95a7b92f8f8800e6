#include "estimation/session/verify.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <map>
#include <set>
#include <system_error>
#include <tuple>

#include "estimation/session/file_reading.h"
#include "estimation/session/frame_decode.h"
#include "estimation/session/frame_io.h"
#include "estimation/session/image_file.h"
#include "estimation/session/manifest.h"
#include "estimation/session/maps.h"
#include "estimation/session/transfer_file.h"

namespace estimation {
namespace {

namespace fs = std::filesystem;

std::string joined(const std::set<int>& numbers) {
  std::string text;
  for (const int number : numbers) text += (text.empty() ? "" : ", ") + std::to_string(number);
  return text;
}

// Goes through what a manifest names and gathers what is wrong and what is worth knowing.
class Verification {
 public:
  Verification(const fs::path& session, const Manifest& manifest)
      : session_(session), manifest_(manifest) {
    report_.state = to_string(manifest.state);
  }

  VerifyReport run() {
    check_frames();
    check_calibration_files();
    check_pattern_pictures();
    note_state();
    note_outputs();
    note_patterns_without_frame();
    note_stray_files();
    return std::move(report_);
  }

 private:
  // An error about a file gets the pointer of the key that names it.
  void add_problem(InputError error, const std::string& pointer) {
    if (error.place != pointer) {
      error.place = error.place.empty() ? pointer : pointer + ", " + error.place;
    }
    report_.problems.push_back(std::move(error));
  }
  void note(const std::string& text) { report_.notes.push_back(text); }

  Result<std::vector<std::byte>> read_named(const std::string& name, const std::string& pointer,
                                            std::uint64_t max_byte_count) const {
    const auto path = resolve_in_session(session_, name, pointer);
    if (!path) return tl::unexpected(path.error());
    return read_file(*path, max_byte_count);
  }

  std::string full_name(const std::string& name) const { return (session_ / name).string(); }

  // True if the file is there and holds a frame of the camera.
  bool check_camera_frame(const std::string& name, const std::string& pointer,
                          const std::optional<std::string>& sha256) {
    const auto bytes = read_named(name, pointer, largest_frame_file(manifest_.camera));
    if (!bytes) {
      add_problem(bytes.error(), pointer);
      return false;
    }
    if (sha256 && !check_hash(*bytes, *sha256, name, pointer)) return false;
    const auto frame = decode_frame(*bytes, manifest_.camera, full_name(name));
    if (!frame) add_problem(frame.error(), pointer);
    return frame.has_value();
  }

  bool check_hash(const std::vector<std::byte>& bytes, const std::string& expected,
                  const std::string& name, const std::string& pointer) {
    const std::string found = sha256_hex(bytes);
    if (found == expected) {
      ++report_.checked_hash_count;
      return true;
    }
    add_problem({InputFault::kUnreadable, full_name(name), "",
                 "has SHA-256 " + found + "; expected " + expected +
                     " as the manifest says: the file was changed since it was captured"},
                pointer);
    return false;
  }

  void check_frames() {
    for (std::size_t i = 0; i < manifest_.frames.size(); ++i) {
      const FrameRecord& frame = manifest_.frames[i];
      const std::string pointer = "/frames/" + std::to_string(i) + "/file";
      if (!check_camera_frame(frame.file, pointer, frame.sha256)) continue;
      ++report_.frame_count;
      captured_.insert(frame.pattern);
    }
    const auto& dark_frames = manifest_.camera.dark_frames;
    for (std::size_t i = 0; i < dark_frames.size(); ++i) {
      check_camera_frame(dark_frames[i].file, "/camera/dark_frames/" + std::to_string(i) + "/file",
                         std::nullopt);
    }
  }

  // The channels of an EXR file of the given size; nullopt if there is a problem.
  std::optional<std::map<std::string, Image<float>>> check_exr(const std::string& name,
                                                               const std::string& pointer,
                                                               int width_px, int height_px) {
    const auto path = resolve_in_session(session_, name, pointer);
    if (!path) {
      add_problem(path.error(), pointer);
      return std::nullopt;
    }
    auto channels = read_exr(*path);
    if (!channels) {
      add_problem(channels.error(), pointer);
      return std::nullopt;
    }
    for (const auto& [channel, image] : *channels) {
      if (image.width_px() == width_px && image.height_px() == height_px) continue;
      add_problem(
          {InputFault::kInvalid, full_name(name), "",
           "is " + std::to_string(image.width_px()) + " x " + std::to_string(image.height_px()) +
               " px; expected " + std::to_string(width_px) + " x " + std::to_string(height_px)},
          pointer);
      return std::nullopt;
    }
    return std::move(*channels);
  }

  // One channel of factors around 1; how many of them cannot be divided by. Nullopt if there is a
  // problem.
  std::optional<std::ptrdiff_t> check_factors(const std::string& name, const std::string& pointer,
                                              int width_px, int height_px) {
    const auto channels = check_exr(name, pointer, width_px, height_px);
    if (!channels) return std::nullopt;
    if (channels->size() != 1) {
      add_problem({InputFault::kInvalid, full_name(name), "",
                   "has " + std::to_string(channels->size()) + " channels; expected 1"},
                  pointer);
      return std::nullopt;
    }
    return std::ranges::count_if(channels->begin()->second.samples(), [](float factor) {
      return !(std::isfinite(factor) && factor > 0);
    });
  }

  // The estimator takes pixels without a response for damaged ones and goes on with the others.
  void check_flat_field(const std::string& name) {
    const CameraInfo& camera = manifest_.camera;
    const std::string pointer = "/camera/flat_field";
    const auto damaged = check_factors(name, pointer, camera.width_px, camera.height_px);
    if (!damaged || *damaged == 0) return;
    const std::ptrdiff_t pixel_count = std::ptrdiff_t{camera.width_px} * camera.height_px;
    if (*damaged == pixel_count) {
      add_problem({InputFault::kInvalid, full_name(name), "",
                   "has no pixel that is finite and above 0; expected factors around 1"},
                  pointer);
      return;
    }
    note(std::to_string(*damaged) + " of " + std::to_string(pixel_count) +
         " pixels are damaged, as /camera/flat_field says: not finite or not above 0 there; they "
         "get no estimate");
  }

  void check_vignetting(const std::string& name) {
    const ProjectorInfo& projector = manifest_.projector;
    const std::string pointer = "/calibration/irradiance/vignetting";
    const auto unusable = check_factors(name, pointer, projector.width_px, projector.height_px);
    if (unusable.value_or(0) == 0) return;
    add_problem({InputFault::kInvalid, full_name(name), "",
                 "has pixels that are not finite or not above 0; expected factors around 1"},
                pointer);
  }

  void check_transfer_file(const TransferFile& transfer) {
    const std::string pointer = "/calibration/stripe_transfer";
    const CameraInfo& camera = manifest_.camera;
    const auto channels = check_exr(transfer.file, pointer, camera.width_px, camera.height_px);
    if (!channels) return;
    if (const auto problem = transfer_file_problem(*channels, camera))
      add_problem({InputFault::kInvalid, full_name(transfer.file), "", *problem}, pointer);
  }

  void check_calibration_files() {
    const Calibration& calibration = manifest_.calibration;
    if (manifest_.camera.flat_field_file) check_flat_field(*manifest_.camera.flat_field_file);
    if (calibration.irradiance && calibration.irradiance->vignetting_file)
      check_vignetting(*calibration.irradiance->vignetting_file);
    if (calibration.stripe_transfer) {
      if (const auto* file = std::get_if<TransferFile>(&*calibration.stripe_transfer)) {
        check_transfer_file(*file);
      }
    }
  }

  Result<void> check_picture(const std::string& name, const std::string& pointer) const {
    constexpr std::uint64_t kLargestPictureBytes = std::uint64_t{512} << 20U;
    const auto bytes = read_named(name, pointer, kLargestPictureBytes);
    if (!bytes) return tl::unexpected(bytes.error());
    const auto header = probe_image(*bytes, full_name(name));
    if (!header) return tl::unexpected(header.error());
    const ProjectorInfo& projector = manifest_.projector;
    if (header->width_px != projector.width_px || header->height_px != projector.height_px) {
      return tl::unexpected(InputError{
          InputFault::kInvalid, full_name(name), "",
          "is " + std::to_string(header->width_px) + " x " + std::to_string(header->height_px) +
              " px; expected the projector's " + std::to_string(projector.width_px) + " x " +
              std::to_string(projector.height_px)});
    }
    const auto picture = decode_image(*bytes, *header, full_name(name));
    if (!picture) return tl::unexpected(picture.error());
    return {};
  }

  void check_pattern_pictures() {
    for (std::size_t i = 0; i < manifest_.patterns.size(); ++i) {
      const auto* picture = std::get_if<ImageFile>(&manifest_.patterns[i].kind);
      if (picture == nullptr) continue;
      const std::string pointer = "/patterns/" + std::to_string(i) + "/file";
      const auto checked = check_picture(picture->file, pointer);
      if (!checked) add_problem(checked.error(), pointer);
    }
  }

  void note_state() {
    if (manifest_.state == SessionState::kComplete) return;
    std::string text = "the capture is not complete: its state is " + report_.state;
    if (manifest_.failure) {
      text += " (" + manifest_.failure->code + ": " + manifest_.failure->text + ")";
    }
    note(text);
  }

  void note_outputs() {
    const CameraInfo& camera = manifest_.camera;
    std::vector<std::string> missing;
    if (!manifest_.calibration.irradiance) {
      missing.emplace_back("/calibration/irradiance/signal_per_us");
    }
    if (!camera.black_level_dn && camera.dark_frames.empty()) {
      missing.emplace_back("/camera/black_level (or /camera/dark_frames)");
    }
    if (!camera.saturation_level_dn) missing.emplace_back("/camera/saturation_level");
    for (const std::string& key : missing) {
      note("geometry alone can be estimated: " + key + " is missing");
    }
    if (!camera.gain_e_per_dn || !camera.read_noise_e) {
      note(
          "the noise is estimated from the data and uncertainties are marked so: "
          "/camera/gain_e_per_dn or /camera/read_noise_e is missing");
    }
    const double largest = std::exp2(camera.pixel_format.bit_depth) - 1;
    if (camera.saturation_level_dn.value_or(0) > largest) {
      note("no sample counts as clipped: /camera/saturation_level is above the largest sample of " +
           to_string(camera.pixel_format));
    }
    note_stripes();
    note_gray_code(Axis::kColumn, manifest_.projector.width_px);
    note_gray_code(Axis::kRow, manifest_.projector.height_px);
  }

  // Stripes are used as evenly shifted sets: a set with a gap is worth knowing.
  void note_stripes() {
    std::map<std::tuple<Axis, int, int>, std::set<int>> shifts;
    for (const Pattern& pattern : manifest_.patterns) {
      const auto* stripes = std::get_if<Stripes>(&pattern.kind);
      if (stripes == nullptr || !captured_.contains(pattern.index)) continue;
      const int phase_px =
          (stripes->shift_px % stripes->period_px + stripes->period_px) % stripes->period_px;
      shifts[{stripes->axis, stripes->period_px, stripes->width_px}].insert(phase_px);
    }
    if (shifts.empty()) note("no scattering can be estimated: no stripes have frames");
    for (const auto& [set, phases] : shifts) {
      const auto& [axis, period_px, width_px] = set;
      if (is_evenly_spaced(phases, period_px)) continue;
      note("stripes " + std::string(axis == Axis::kColumn ? "column " : "row ") +
           std::to_string(period_px) + "/" + std::to_string(width_px) +
           " are not evenly shifted; frames exist for shifts " + joined(phases));
    }
  }

  static bool is_evenly_spaced(const std::set<int>& phases, int period_px) {
    const auto count = static_cast<int>(phases.size());
    if (period_px % count != 0) return false;
    const int step_px = period_px / count;
    return std::ranges::all_of(
        phases, [&](int phase_px) { return phase_px % step_px == *phases.begin() % step_px; });
  }

  void note_gray_code(Axis axis, int side_px) {
    const auto bit_count = static_cast<int>(std::bit_width(static_cast<unsigned>(side_px - 1)));
    std::set<int> missing;
    for (int bit = 0; bit < bit_count; ++bit) missing.insert(bit);
    bool has_fringe = false;
    std::map<std::pair<double, int>, std::set<double>> shifts;  // [period, width (0: fringe)]
    for (const Pattern& pattern : manifest_.patterns) {
      if (!captured_.contains(pattern.index)) continue;
      const auto* gray = std::get_if<GrayCode>(&pattern.kind);
      if (gray != nullptr && gray->axis == axis) missing.erase(gray->bit);
      const auto* fringe = std::get_if<Fringe>(&pattern.kind);
      has_fringe = has_fringe || (fringe != nullptr && fringe->axis == axis);
      const auto* stripes = std::get_if<Stripes>(&pattern.kind);
      if (fringe != nullptr && fringe->axis == axis)
        shifts[{fringe->period_px, 0}].insert(fringe->shift_px);
      if (stripes != nullptr && stripes->axis == axis)
        shifts[{stripes->period_px, stripes->width_px}].insert(stripes->shift_px);
    }
    // Three shifts give a phase, which tells apart what lies within its period.
    double period_px = 0;
    for (const auto& [set, phases] : shifts)
      if (phases.size() >= 3) period_px = std::max(period_px, set.first);
    const bool has_bits = static_cast<int>(missing.size()) < bit_count;
    if (has_bits) std::erase_if(missing, [&](int bit) { return std::exp2(bit + 1) <= period_px; });
    if (missing.empty()) return;
    const std::string along = axis == Axis::kColumn ? "columns" : "rows";
    if (static_cast<int>(missing.size()) == bit_count && has_fringe) return;
    note("projector " + along + " cannot be told apart by Gray code: no frames of bit " +
         joined(missing) + " of " + std::to_string(bit_count) + " bits");
  }

  void note_patterns_without_frame() {
    std::set<int> without;
    for (const Pattern& pattern : manifest_.patterns) {
      if (!captured_.contains(pattern.index)) without.insert(pattern.index);
    }
    if (!without.empty()) note("no readable frame of pattern " + joined(without));
  }

  void note_stray_files() {
    std::set<fs::path> named;
    const auto add = [&](const std::string& name) {
      if (!named.insert(fs::path(name).lexically_normal()).second) {
        note("the file " + name + " serves more than one frame");
      }
    };
    for (const FrameRecord& frame : manifest_.frames) add(frame.file);
    for (const DarkFrame& dark : manifest_.camera.dark_frames) add(dark.file);
    std::error_code error;
    int stray_count = 0;
    for (fs::directory_iterator it(session_ / "frames", error), end; !error && it != end;
         it.increment(error)) {
      if (!named.contains(fs::path("frames") / it->path().filename())) ++stray_count;
    }
    if (stray_count > 0) {
      note(std::to_string(stray_count) + " files in frames/ are not named by the manifest");
    }
  }

  const fs::path& session_;
  const Manifest& manifest_;
  std::set<int> captured_;  // patterns with a readable frame
  VerifyReport report_;
};

}  // namespace

Result<VerifyReport> verify_session(const fs::path& session) {
  const Result<Manifest> manifest = read_manifest(session);
  if (!manifest) return tl::unexpected(manifest.error());
  return Verification(session, *manifest).run();
}

}  // namespace estimation
