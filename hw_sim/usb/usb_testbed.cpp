#include "hw_sim/usb/usb_testbed.h"

#include <umockdev.h>

#include <cstdlib>

namespace hw_sim {
namespace {

constexpr const char* kPreloadLibrary = "libumockdev-preload.so.0";

std::string appended(const char* variable, const std::string& value) {
  const char* const present = std::getenv(variable);
  if (present == nullptr || *present == '\0') return value;
  return std::string(present) + ":" + value;
}

}  // namespace

rig::Result<std::unique_ptr<UsbTestbed>> UsbTestbed::open() {
  std::unique_ptr<UsbTestbed> testbed(new UsbTestbed);
  // Only now: umockdev remembers its first answer, and before the testbed that is no.
  if (!umockdev_in_mock_environment()) {
    return rig::failure(rig::Fault::kUnsupported,
                        std::string("simulated USB needs ") + kPreloadLibrary +
                            " in this program: link umockdev_preload, or set LD_PRELOAD");
  }
  return testbed;
}

UsbTestbed::UsbTestbed() : testbed_(umockdev_testbed_new()) {
  gchar* const root = umockdev_testbed_get_root_dir(testbed_);
  root_ = root;
  g_free(root);
}

UsbTestbed::~UsbTestbed() { g_object_unref(testbed_); }

std::vector<std::pair<std::string, std::string>> UsbTestbed::child_environment() const {
  return {{"UMOCKDEV_DIR", root_},
          // Last: the runtime of a sanitizer, if there is one, has to stay first.
          {"LD_PRELOAD", appended("LD_PRELOAD", kPreloadLibrary)},
          {"ASAN_OPTIONS", appended("ASAN_OPTIONS", "verify_asan_link_order=0")}};
}

}  // namespace hw_sim
