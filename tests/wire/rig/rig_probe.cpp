// The three production drivers at work on a rig, without any of capture: rig_probe RIG_FILE shows
// twenty grey pictures and expects of each one edge, a pulse and a frame per bracket, and in each
// frame the light of that picture. Exit code 0 if so.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "rig/devices/aravis_camera.h"
#include "rig/devices/glfw_projector.h"
#include "rig/devices/libusb_trigger.h"
#include "rig/event.h"
#include "rig/rig_file.h"

namespace {

constexpr int kPictureCount = 20;
constexpr double kLevelTolerance_frac = 0.015;  // neighbours differ by 0.04 and more

int level_of(int picture) { return 60 + 10 * picture; }

// What came in answer to one show().
struct Answers {
  std::vector<rig::PictureShown> shown;
  std::vector<rig::EdgeSeen> edges;
  std::vector<rig::PulseEnded> pulses;
  std::vector<rig::Frame> frames;
  std::string trouble;  // of the first event that should not have come
};

void sort_in(rig::Event event, Answers& answers) {
  if (auto* shown = std::get_if<rig::PictureShown>(&event)) answers.shown.push_back(*shown);
  if (auto* edge = std::get_if<rig::EdgeSeen>(&event)) answers.edges.push_back(*edge);
  if (auto* pulse = std::get_if<rig::PulseEnded>(&event)) answers.pulses.push_back(*pulse);
  if (auto* frame = std::get_if<rig::FrameArrived>(&event))
    answers.frames.push_back(std::move(frame->frame));
  if (std::holds_alternative<rig::EdgeIgnored>(event)) answers.trouble = "an edge was ignored";
  if (auto* damaged = std::get_if<rig::FrameDamaged>(&event))
    answers.trouble = damaged->error.detail;
  if (auto* fault = std::get_if<rig::DeviceFault>(&event)) answers.trouble = fault->error.detail;
}

Answers collect(rig::EventSource& events, const rig::SequenceSettings& sequence) {
  const std::size_t bracket_count = sequence.exposures.size();
  const rig::HostTime deadline = events.now() + sequence.edge_deadline + sequence.frame_deadline;
  Answers answers;
  while (answers.trouble.empty() &&
         (answers.shown.empty() || answers.edges.empty() || answers.pulses.size() < bracket_count ||
          answers.frames.size() < bracket_count)) {
    std::optional<rig::Event> event = events.wait(deadline, {});
    if (!event) {
      answers.trouble = "the deadline passed with " + std::to_string(answers.shown.size()) +
                        " shown, " + std::to_string(answers.edges.size()) + " edges, " +
                        std::to_string(answers.pulses.size()) + " pulses, " +
                        std::to_string(answers.frames.size()) + " frames";
      break;
    }
    sort_in(std::move(*event), answers);
  }
  return answers;
}

// Mean of a frame above black, in DN/us.
double mean_rate(const rig::Frame& frame, double black_level_dn,
                 std::chrono::microseconds exposure) {
  double sum_dn = 0;
  const std::size_t count = frame.pixels.size() / 2;
  for (std::size_t i = 0; i < count; ++i) {
    std::uint16_t sample_dn = 0;
    std::memcpy(&sample_dn, &frame.pixels[2 * i], 2);
    sum_dn += sample_dn;
  }
  return (sum_dn / static_cast<double>(count) - black_level_dn) /
         static_cast<double>(exposure.count());
}

// What is wrong with the answers to picture number `picture`; empty: nothing. Adds the frames'
// light per grey level to `light_per_level`.
std::string check(const Answers& answers, int picture, const rig::RigFile& rig,
                  std::vector<double>& light_per_level) {
  const std::size_t bracket_count = rig.sequence.exposures.size();
  if (!answers.trouble.empty()) return answers.trouble;
  if (answers.shown.size() != 1 || answers.edges.size() != 1 ||
      answers.pulses.size() != bracket_count || answers.frames.size() != bracket_count)
    return "wrong number of answers";
  const rig::EdgeSeen& edge = answers.edges.front();
  if (edge.edge_number != static_cast<std::uint32_t>(picture + 1)) return "wrong edge number";
  if (edge.is_light != (picture % 2 == 0)) return "wrong edge level";
  for (std::size_t i = 0; i < bracket_count; ++i) {
    const auto number = static_cast<std::uint32_t>(picture) * bracket_count + i + 1;
    if (answers.pulses[i].pulse_number != number) return "wrong pulse number";
    if (answers.pulses[i].started < edge.time - std::chrono::milliseconds(1))
      return "pulse before its edge";
    if (answers.frames[i].block_id != number) return "wrong block id";
    if (answers.frames[i].trigger_count.value_or(number) != number) return "wrong trigger count";
    light_per_level.push_back(
        mean_rate(answers.frames[i], rig.sensor.black_level_dn, rig.sequence.exposures[i]) /
        level_of(picture));
  }
  return "";
}

bool complain(const std::string& what) {
  std::fprintf(stderr, "rig_probe: %s\n", what.c_str());
  return false;
}

// Every frame must have the same light per grey level: then each shows its own picture.
bool is_constant(std::vector<double> light_per_level) {
  std::vector<double> sorted = light_per_level;
  std::sort(sorted.begin(), sorted.end());
  const double median = sorted[sorted.size() / 2];
  if (median <= 0) return complain("the frames are dark");
  for (std::size_t i = 0; i < light_per_level.size(); ++i)
    if (std::abs(light_per_level[i] / median - 1) > kLevelTolerance_frac)
      return complain("frame " + std::to_string(i) + " shows another picture: light is " +
                      std::to_string(light_per_level[i] / median) + " of its level's");
  return true;
}

bool capture(rig::Projector& projector, rig::Trigger& trigger, rig::Camera& camera,
             rig::EventSource& events, const rig::RigFile& rig) {
  const std::vector<std::chrono::microseconds>& exposures = rig.sequence.exposures;
  std::vector<estimation::Image<unsigned char>> pictures;
  pictures.reserve(kPictureCount);
  for (int i = 0; i < kPictureCount; ++i)
    pictures.emplace_back(rig.projector.height_px, rig.projector.width_px, 1,
                          static_cast<unsigned char>(level_of(i)));
  if (const auto loaded = projector.load(std::move(pictures)); !loaded)
    return complain(loaded.error().detail);
  const int frame_count = kPictureCount * static_cast<int>(exposures.size());
  if (const auto armed = camera.arm(exposures, frame_count); !armed)
    return complain(armed.error().detail);
  if (const auto armed = trigger.arm(exposures, 1); !armed) return complain(armed.error().detail);

  std::vector<double> light_per_level;
  for (int i = 0; i < kPictureCount; ++i) {
    const auto shown = projector.show(
        {.show_id = static_cast<std::uint64_t>(i), .picture = i, .is_square_light = i % 2 == 0});
    if (!shown) return complain(shown.error().detail);
    const std::string wrong = check(collect(events, rig.sequence), i, rig, light_per_level);
    if (!wrong.empty()) return complain("picture " + std::to_string(i) + ": " + wrong);
  }
  trigger.disarm();
  camera.disarm();
  std::printf("rig_probe: %d pictures, %zu frames, each of its own picture\n", kPictureCount,
              light_per_level.size());
  return is_constant(std::move(light_per_level));
}

int run(const rig::RigFile& rig) {
  rig::EventQueue events;
  const auto projector = rig::GlfwProjector::open(rig.projector, events);
  if (!projector) return complain(projector.error().detail) ? 0 : 1;
  std::printf("rig_probe: %s\n", (*projector)->report().text.c_str());
  const auto trigger = rig::LibusbTrigger::open(rig.trigger, events);
  if (!trigger) return complain(trigger.error().detail) ? 0 : 1;
  const auto camera = rig::AravisCamera::open(rig.camera, events);
  if (!camera) return complain(camera.error().detail) ? 0 : 1;

  bool is_right = false;
  std::stop_source done;
  const std::jthread session([&] {
    is_right = capture(**projector, **trigger, **camera, events, rig);
    done.request_stop();
  });
  const auto ran = (*projector)->run(done.get_token());
  return ran && is_right ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return complain("usage: rig_probe RIG_FILE") ? 0 : 2;
  const auto rig = rig::read_rig_file(argv[1]);
  if (!rig) return complain(rig.error().detail) ? 0 : 2;
  return run(*rig);
}
