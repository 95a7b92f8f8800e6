// main() of the display tests: the X server first, then the tests.
#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>

#include "tests/wire/display/display_fixture.h"

namespace {
hw_sim::VirtualScreen* the_screen = nullptr;
}

hw_sim::VirtualScreen& display_test::screen() { return *the_screen; }

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  auto screen = hw_sim::VirtualScreen::start(display_test::screen_settings());
  if (!screen) {
    std::fprintf(stderr, "%s\n", screen.error().detail.c_str());
    return 1;
  }
  the_screen = screen->get();
  setenv("DISPLAY", the_screen->display().c_str(), 1);
  return RUN_ALL_TESTS();
}
