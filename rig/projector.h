// A projector that shows one of a set of pictures with a sync square, as capture sees it. The real
// one is a GLFW window (rig/devices/glfw_projector.h), hw_sim has another; both pass
// tests/contract/projector_contract.h.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "estimation/base/image.h"
#include "rig/fault.h"

namespace rig {

enum class Corner { kTopLeft, kTopRight, kBottomLeft, kBottomRight };

struct SyncSquareSettings {
  int size_px = 64;
  Corner corner =
      Corner::kBottomRight;  // bottom: scanned last, so the picture is out when it flips
  bool is_inverted = false;  // true: the photodiode reads light as low
};

struct ProjectorSettings {
  std::string monitor;  // connector name, "HDMI-1"
  int width_px = 1024;  // of the monitor's present mode; never switched
  int height_px = 768;
  SyncSquareSettings sync_square;
  int timing_check_intervals = 50;  // swap intervals measured at start, at least 50
  // A display server that stays silent for so long is lost. A mode switch takes it seconds.
  std::chrono::milliseconds server_deadline{10'000};
};

// What the start-up check found.
struct DisplayReport {
  std::string monitor, renderer;
  int width_px = 0;
  int height_px = 0;
  double nominal_refresh_hz = 0;  // 0 where the monitor does not say
  double measured_refresh_hz = 0;
  double interval_sd_ms = 0;
  double interval_max_ms = 0;
  bool is_gamma_identity = false;
  bool is_vsynced = false;  // intervals are those of the monitor
  std::string text;         // one sentence for the operator
};

inline constexpr int kBlackPicture = -1;

struct ShowRequest {
  std::uint64_t show_id = 0;    // comes back in PictureShown
  int picture = kBlackPicture;  // index into the loaded pictures
  bool is_square_light = false;
};

// Posts PictureShown and DeviceFault{kProjector} to the EventSink given at opening. load, show and
// report are thread-safe; the window itself belongs to the main thread.
class Projector {
 public:
  virtual ~Projector() = default;

  virtual DisplayReport report() const = 0;

  // Replaces the pictures, [height_px][width_px] 0..255 each; black is shown until the first
  // show(). Errors: kOutOfRange if a size differs from the monitor's; kDisplayChanged.
  virtual Result<void> load(std::vector<estimation::Image<unsigned char>> pictures) = 0;

  // Asks for a picture and returns at once; PictureShown follows, or DeviceFault. PictureShown also
  // says that the monitor, its mode and its gamma ramp were as opened until this picture was drawn.
  // The square belongs to no picture and covers it. Requests are shown in order, each for at least
  // one refresh. Errors: kOutOfRange for a picture that is not loaded; kDisplayChanged.
  virtual Result<void> show(const ShowRequest& request) = 0;
};

}  // namespace rig
