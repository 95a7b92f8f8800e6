// An LD_PRELOAD library that gives llvmpipe a display clock: GLX_EXT_swap_control and
// GLX_OML_sync_control on the refresh of hw_sim/display/scanout_clock.h. Under a dummy X server GLX
// has neither, and swaps run free. GLFW and epoxy find libGLX with dlopen and dlsym, so dlsym is
// what we stand in for.
//   SSRIG_SIM_REFRESH_HZ    refresh, default 60
//   SSRIG_SIM_SKIP_EVERY    n: every n-th swap misses one refresh, as a late frame does
//   SSRIG_SIM_SKIP_FILE     a file of one 32-bit count: so many next swaps miss one refresh each
#include <GL/glx.h>
#include <X11/Xlib.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <ctime>
#include <string>
#include <string_view>

#include "hw_sim/display/scanout_clock.h"

namespace {

using hw_sim::ScanoutClock;
using Clock = std::chrono::steady_clock;
using AnyFunction = void (*)();

double number_from_environment(const char* name, double otherwise) {
  const char* text = std::getenv(name);
  const double value = text != nullptr ? std::strtod(text, nullptr) : 0;
  return value > 0 ? value : otherwise;
}

const ScanoutClock& scanout() {
  static const ScanoutClock clock(number_from_environment("SSRIG_SIM_REFRESH_HZ", 60));
  return clock;
}

void* real_dlsym(void* library, const char* name) {
  using Dlsym = void* (*)(void*, const char*);
  static const auto function = [] {
    void* found = dlvsym(RTLD_NEXT, "dlsym", "GLIBC_2.34");
    if (found == nullptr) found = dlvsym(RTLD_NEXT, "dlsym", "GLIBC_2.2.5");  // x86-64
    if (found == nullptr) found = dlvsym(RTLD_NEXT, "dlsym", "GLIBC_2.17");   // arm64
    return reinterpret_cast<Dlsym>(found);
  }();
  return function(library, name);
}

template <typename Function>
Function real_glx(const char* name) {
  static void* const library = dlopen("libGLX.so.0", RTLD_NOW | RTLD_GLOBAL);
  return reinterpret_cast<Function>(real_dlsym(library, name));
}

AnyFunction real_proc_address(const GLubyte* name) {
  static const auto function = real_glx<AnyFunction (*)(const GLubyte*)>("glXGetProcAddressARB");
  return function(name);
}

void gl_finish() {
  static const auto function = real_proc_address(reinterpret_cast<const GLubyte*>("glFinish"));
  function();
}

// What the one swapped window is at.
struct SwapState {
  std::atomic<int> interval{0};
  std::atomic<std::int64_t> swap_count{0};
  std::atomic<std::int64_t> last_blank{0};  // of the newest swap
};

SwapState& state() {
  static SwapState swap_state;
  return swap_state;
}

// To the blank itself, on the clock that it is defined on.
void wait_for_blank(std::int64_t blank) {
  const auto ns = scanout().time_of(blank).time_since_epoch().count();
  const timespec time{ns / 1'000'000'000, ns % 1'000'000'000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &time, nullptr) != 0) continue;
}

std::int64_t us_of(std::int64_t blank) {
  return scanout().time_of(blank).time_since_epoch().count() / 1000 + 1;  // not before the blank
}

// Shared with who plans the faults; nullptr without one.
std::atomic<std::int32_t>* planned_skips() {
  static auto* const count = []() -> std::atomic<std::int32_t>* {
    const char* path = std::getenv("SSRIG_SIM_SKIP_FILE");
    const int file = path != nullptr ? open(path, O_RDWR | O_CLOEXEC) : -1;
    if (file < 0) return nullptr;
    void* memory = mmap(nullptr, sizeof(std::atomic<std::int32_t>), PROT_READ | PROT_WRITE,
                        MAP_SHARED, file, 0);
    close(file);
    return memory == MAP_FAILED ? nullptr : static_cast<std::atomic<std::int32_t>*>(memory);
  }();
  return count;
}

bool take_planned_skip() {
  std::atomic<std::int32_t>* const count = planned_skips();
  if (count == nullptr || count->load() <= 0) return false;
  --*count;
  return true;
}

std::int64_t wait_for_swap_blank(int interval) {
  static const auto skip_every =
      static_cast<std::int64_t>(number_from_environment("SSRIG_SIM_SKIP_EVERY", 0));
  std::int64_t blank =
      std::max(scanout().blank_at(Clock::now()) + 1, state().last_blank.load() + interval);
  if (skip_every > 0 && (state().swap_count + 1) % skip_every == 0) ++blank;
  if (take_planned_skip()) ++blank;
  wait_for_blank(blank);
  return blank;
}

void swap_buffers(Display* display, GLXDrawable drawable) {
  static const auto real = real_glx<void (*)(Display*, GLXDrawable)>("glXSwapBuffers");
  gl_finish();
  const int interval = state().interval;
  const std::int64_t blank =
      interval > 0 ? wait_for_swap_blank(interval) : scanout().blank_at(Clock::now());
  real(display, drawable);
  gl_finish();
  XSync(display, False);  // the pixels are in the X server when we return
  // On a busy computer they may have missed the blank that was waited for, and are in the scan-out
  // since a later one: a driver tells of that.
  state().last_blank = std::max(blank, scanout().blank_at(Clock::now()));
  ++state().swap_count;
}

const char* extensions(Display* display, int screen) {
  static const auto real = real_glx<const char* (*)(Display*, int)>("glXQueryExtensionsString");
  static const std::string all =
      std::string(real(display, screen)) + " GLX_EXT_swap_control GLX_OML_sync_control";
  return all.c_str();
}

void set_interval(Display*, GLXDrawable, int interval) { state().interval = interval; }

Bool sync_values(Display*, GLXDrawable, std::int64_t* time_us, std::int64_t* blank,
                 std::int64_t* swap_count) {
  *blank = scanout().blank_at(Clock::now());
  *time_us = us_of(*blank);
  *swap_count = state().swap_count;
  return True;
}

Bool blank_rate(Display*, GLXDrawable, std::int32_t* numerator, std::int32_t* denominator) {
  *numerator = static_cast<std::int32_t>(1e12 / static_cast<double>(scanout().period().count()));
  *denominator = 1000;
  return True;
}

// Swaps are done when swap_buffers() returns, so there is never one to wait for.
Bool wait_for_swap(Display*, GLXDrawable, std::int64_t, std::int64_t* time_us, std::int64_t* blank,
                   std::int64_t* swap_count) {
  *blank = state().last_blank;
  *time_us = us_of(*blank);
  *swap_count = state().swap_count;
  return True;
}

AnyFunction proc_address(const GLubyte* name);

// nullptr: not ours.
void* find_ours(std::string_view name) {
  if (name == "glXGetProcAddress" || name == "glXGetProcAddressARB")
    return reinterpret_cast<void*>(proc_address);
  if (name == "glXSwapBuffers") return reinterpret_cast<void*>(swap_buffers);
  if (name == "glXQueryExtensionsString") return reinterpret_cast<void*>(extensions);
  if (name == "glXSwapIntervalEXT") return reinterpret_cast<void*>(set_interval);
  if (name == "glXGetSyncValuesOML") return reinterpret_cast<void*>(sync_values);
  if (name == "glXGetMscRateOML") return reinterpret_cast<void*>(blank_rate);
  if (name == "glXWaitForSbcOML") return reinterpret_cast<void*>(wait_for_swap);
  return nullptr;
}

AnyFunction proc_address(const GLubyte* name) {
  void* ours = find_ours(reinterpret_cast<const char*>(name));
  return ours != nullptr ? reinterpret_cast<AnyFunction>(ours) : real_proc_address(name);
}

}  // namespace

extern "C" __attribute__((visibility("default"))) void* dlsym(void* library,
                                                              const char* name) noexcept {
  if (void* ours = find_ours(name); ours != nullptr) return ours;
  return real_dlsym(library, name);
}
