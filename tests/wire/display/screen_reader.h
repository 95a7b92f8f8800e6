// Touches the screen with the simplest means: XGetImage instead of hw_sim's grabber, a painted root
// window instead of the product.
#pragma once

#include <string>

#include "estimation/base/image.h"

namespace display_test {

// [height_px][width_px], three channels, as in the frame buffer, before any gamma ramp; empty if
// that part of the screen does not exist.
estimation::Image<unsigned char> read_screen(const std::string& display, int x_px, int y_px,
                                             int width_px, int height_px);

// Entry `index` of the red ramp of an output, 0..65535.
int read_gamma(const std::string& display, const std::string& output, int index);

void paint_screen_white(const std::string& display);

}  // namespace display_test
