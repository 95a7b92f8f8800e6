// How long after the last frame of a capture its verdict on motion is told, from the
// last step of the capture before it: whole captures in process, of a scene that costs next
// to nothing, with the estimator and the disk at work beside it as ever.
//   verdict-time RIG FOLDER [--captures N]
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "capture/capture_job.h"
#include "hw_sim/devices/in_process_rig.h"
#include "hw_sim/world.h"
#include "rig/rig_file.h"

namespace {

namespace fs = std::filesystem;
using std::chrono::steady_clock;

// A wall with a texture, lit by what the projector shows; noise from a hash.
class Wall final : public hw_sim::World {
 public:
  explicit Wall(const rig::RigFile& rig_file)
      : height_px_(rig_file.camera.height_px),
        width_px_(rig_file.camera.width_px),
        texture_(height_px_, width_px_) {
    for (int row = 0; row < height_px_; ++row)
      for (int col = 0; col < width_px_; ++col)
        texture_.at(row, col) = static_cast<float>(1 + 0.1 * std::sin(0.03 * col + 0.02 * row) *
                                                           std::cos(0.04 * row - 0.01 * col));
  }
  int width_px() const override { return width_px_; }
  int height_px() const override { return height_px_; }
  int channel_count() const override { return 1; }
  void expose(const hw_sim::Exposure& exposure,
              estimation::ImageView<std::uint16_t> frame_dn) const override {
    constexpr float kDnPerMs = 40;
    const auto& picture = exposure.light.back().picture->brightness;
    const float scale = kDnPerMs * static_cast<float>(exposure.duration.count()) / 1000 / 255;
    auto state = static_cast<std::uint32_t>(exposure.trigger_number * 2654435761U + 1);
    for (int row = 0; row < height_px_; ++row) {
      const int v = row * picture.height_px() / height_px_;
      for (int col = 0; col < width_px_; ++col) {
        const int u = col * picture.width_px() / width_px_;
        state = state * 1664525U + 1013904223U;
        const float noise = static_cast<float>(state >> 24U) / 8 - 16;
        const float dn = 80 + noise + scale * texture_.at(row, col) * picture.at(v, u);
        frame_dn.at(row, col) = static_cast<std::uint16_t>(std::min(dn, 4095.0F));
      }
    }
  }

 private:
  int height_px_, width_px_;
  estimation::Image<float> texture_;
};

std::optional<double> verdict_ms(const rig::RigFile& rig_file) {
  capture::CaptureOptions options;
  options.directory = rig_file.storage.directory;
  options.created = std::chrono::system_clock::now();
  options.estimator.is_geometry_only = true;
  const auto job = capture::CaptureJob::prepare(rig_file, options);
  if (!job) {
    std::fprintf(stderr, "verdict-time: %s\n", job.error().message.c_str());
    return std::nullopt;
  }
  const Wall wall(rig_file);
  hw_sim::InProcessOptions rig_options;
  rig_options.projector = rig_file.projector;
  rig_options.trigger = rig_file.trigger;
  rig_options.camera = rig_file.camera;
  hw_sim::InProcessRig rig(wall, rig_options);
  // The devices' clock is a virtual one: this takes the wall's.
  steady_clock::time_point last_slot, told;
  const auto watch = [&](const capture::CaptureProgress& progress) {
    if (progress.motion.empty())
      last_slot = steady_clock::now();
    else if (told == steady_clock::time_point())
      told = steady_clock::now();
  };
  const auto result =
      job->run({rig.projector(), rig.trigger(), rig.camera(), rig.timeline()}, {}, watch);
  fs::remove_all(result.session);
  if (told == steady_clock::time_point()) {
    std::fprintf(stderr, "verdict-time: %s\n", result.message.c_str());
    return std::nullopt;
  }
  std::printf("%s\n", result.motion.c_str());
  return std::chrono::duration<double, std::milli>(told - last_slot).count();
}

}  // namespace

// NOLINTNEXTLINE(bugprone-exception-escape): CLI11 would only throw about our own options' names
int main(int argc, char** argv) {
  std::string rig_path, folder;
  int capture_count = 3;
  CLI::App program("from the last frame to the verdict on motion");
  program.add_option("rig", rig_path, "a rig file")->required();
  program.add_option("folder", folder, "for the sessions, which are removed")->required();
  program.add_option("--captures", capture_count)->capture_default_str();
  CLI11_PARSE(program, argc, argv);
  auto rig_file = rig::read_rig_file(rig_path);
  if (!rig_file) {
    std::fprintf(stderr, "verdict-time: %s\n", rig_file.error().detail.c_str());
    return 1;
  }
  rig_file->storage.directory = folder;
  std::vector<double> times_ms;
  for (int i = 0; i < capture_count; ++i) {
    const auto time_ms = verdict_ms(*rig_file);
    if (!time_ms) return 1;
    times_ms.push_back(*time_ms);
  }
  std::sort(times_ms.begin(), times_ms.end());
  std::printf("%d x %d px: verdict %.0f to %.0f ms after the last frame\n",
              rig_file->camera.width_px, rig_file->camera.height_px, times_ms.front(),
              times_ms.back());
  return 0;
}
