#include "tests/contract/trigger_contract.h"

#include <gtest/gtest.h>

#include <memory>

#include "tests/wire/usb/wire_trigger_rig.h"

namespace {

std::unique_ptr<trigger_contract::TriggerRig> make_wire_rig() {
  auto rig = WireTriggerRig::plug_in({.drift_ppm = 60});
  if (rig == nullptr) return nullptr;
  if (const auto opened = rig->open(trigger_contract::settings()); !opened) {
    ADD_FAILURE() << opened.error().detail;
    return nullptr;
  }
  return rig;
}

}  // namespace

INSTANTIATE_TEST_SUITE_P(Wire, TriggerContract, testing::Values(&make_wire_rig));
