#include "hw_sim/app/saboteur.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <utility>

namespace hw_sim {
namespace {

constexpr std::chrono::microseconds kStrayPulse{1000};
constexpr auto kLookPeriod = std::chrono::seconds(1);  // when nothing else wakes the thread

void report(const rig::Result<void>& done) {
  if (!done) std::fprintf(stderr, "ssrig-sim: %s\n", done.error().detail.c_str());
}

}  // namespace

SharedCount::SharedCount(const std::filesystem::path& file) {
  const int opened = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  if (opened < 0) return;
  if (ftruncate(opened, sizeof(std::atomic<std::int32_t>)) == 0) {
    void* memory = mmap(nullptr, sizeof(std::atomic<std::int32_t>), PROT_READ | PROT_WRITE,
                        MAP_SHARED, opened, 0);
    if (memory != MAP_FAILED) count_ = static_cast<std::atomic<std::int32_t>*>(memory);
  }
  close(opened);
}

SharedCount::~SharedCount() {
  if (count_ != nullptr) munmap(count_, sizeof(std::atomic<std::int32_t>));
}

void SharedCount::add_one() {
  if (count_ != nullptr) ++*count_;
}

Saboteur::Saboteur(FaultSchedule& faults, Victims victims)
    : faults_(faults),
      victims_(victims),
      thread_([this](const std::stop_token& stop) { run(stop); }) {}

void Saboteur::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    const rig::HostTime look = rig::HostClock::now() + kLookPeriod;
    const rig::HostTime due = undos_.empty() ? look : std::min(look, undos_.begin()->first);
    faults_.wait_for_progress(due, stop);
    undo_what_is_over();
    if (!stop.stop_requested()) act();
  }
}

void Saboteur::act() {
  if (faults_.take_skipped_blank()) victims_.skipped_blanks.add_one();
  if (!faults_.is_armed() && faults_.showing() == kIdle) act_at_rest();
  if (const auto stuck = faults_.take(FaultKind::kPhotodiodeStuck)) {
    victims_.grabber.stick_photodiode(true);
    undo_after(stuck->duration, [this] { victims_.grabber.stick_photodiode(false); });
  }
  if (const auto dim = faults_.take(FaultKind::kPhotodiodeDim)) {
    victims_.grabber.dim_photodiode(dim->level_frac);
    undo_after(dim->duration, [this] { victims_.grabber.dim_photodiode(1); });
  }
  if (const auto out =
          victims_.box != nullptr ? faults_.take(FaultKind::kUsbUnplugged) : std::nullopt) {
    victims_.box->unplug();
    undo_after(out->duration, [this] { victims_.box->replug(); });
  }
  if (const auto off = faults_.take(FaultKind::kCameraRebooted)) {
    victims_.camera.power_off();
    undo_after(off->duration, [this] { report(victims_.camera.power_on()); });
  }
  if (const auto out = faults_.take(FaultKind::kCablePulled)) {
    victims_.camera.change([](GigeFaults& faults) { faults.is_mute = true; });
    undo_after(out->duration, [this] {
      victims_.camera.change([](GigeFaults& faults) { faults.is_mute = false; });
    });
  }
  if (const auto stolen = faults_.take(FaultKind::kControlStolen)) {
    victims_.camera.change([](GigeFaults& faults) {
      faults.is_control_taken = true;
      faults.is_control_kicked = true;
    });
    undo_after(stolen->duration, [this] {
      victims_.camera.change([](GigeFaults& faults) { faults.is_control_taken = false; });
    });
  }
  if (const auto gone = faults_.take(FaultKind::kProjectorGone)) {
    report(victims_.screen.unplug_projector());
    undo_after(gone->duration, [this] { report(victims_.screen.plug_projector_in()); });
  }
  if (const auto gamma = faults_.take(FaultKind::kGammaWrong)) {
    report(victims_.screen.set_projector_gamma(gamma->gamma_exponent));
    undo_after(gamma->duration, [this] { report(victims_.screen.set_projector_gamma(1)); });
  }
}

// What else a rig at rest can suffer; a capture's showings have theirs from the devices themselves.
void Saboteur::act_at_rest() {
  if (faults_.take(FaultKind::kTriggerDoubled))
    victims_.camera.pulse(rig::HostClock::now(), kStrayPulse);
  if (victims_.box == nullptr) return;
  if (faults_.take(FaultKind::kUsbStall)) victims_.box->stall_in();
  if (faults_.take(FaultKind::kUsbGap)) victims_.box->drop_next_record();
}

void Saboteur::undo_after(std::chrono::milliseconds duration, std::function<void()> undo) {
  if (duration.count() > 0) undos_.emplace(rig::HostClock::now() + duration, std::move(undo));
}

void Saboteur::undo_what_is_over() {
  while (!undos_.empty() && undos_.begin()->first <= rig::HostClock::now()) {
    const std::function<void()> undo = std::move(undos_.begin()->second);
    undos_.erase(undos_.begin());
    undo();
  }
}

}  // namespace hw_sim
