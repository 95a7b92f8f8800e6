#include "tests/wire/display/screen_reader.h"

#include <X11/Xutil.h>

#include "hw_sim/display/x_connection.h"

namespace display_test {

estimation::Image<unsigned char> read_screen(const std::string& display, int x_px, int y_px,
                                             int width_px, int height_px) {
  const hw_sim::XConnection connection(XOpenDisplay(display.c_str()));
  XImage* image = XGetImage(connection.get(), DefaultRootWindow(connection.get()), x_px, y_px,
                            static_cast<unsigned>(width_px), static_cast<unsigned>(height_px),
                            AllPlanes, ZPixmap);
  if (image == nullptr) return {};
  estimation::Image<unsigned char> pixels(height_px, width_px, 3);
  for (int row = 0; row < height_px; ++row)
    for (int col = 0; col < width_px; ++col) {
      const unsigned long pixel = XGetPixel(image, col, row);
      pixels.at(row, col, 0) = static_cast<unsigned char>(pixel >> 16);
      pixels.at(row, col, 1) = static_cast<unsigned char>(pixel >> 8);
      pixels.at(row, col, 2) = static_cast<unsigned char>(pixel);
    }
  XDestroyImage(image);
  return pixels;
}

int read_gamma(const std::string& display, const std::string& output, int index) {
  const hw_sim::XConnection connection(XOpenDisplay(display.c_str()));
  const hw_sim::XrrResources resources = hw_sim::screen_resources(connection.get());
  const hw_sim::XOutput found = hw_sim::find_output(connection.get(), resources.get(), output);
  const hw_sim::XrrGamma ramp(XRRGetCrtcGamma(connection.get(), found.crtc));
  return ramp->red[index];
}

void paint_screen_white(const std::string& display) {
  const hw_sim::XConnection connection(XOpenDisplay(display.c_str()));
  XSetWindowBackground(connection.get(), DefaultRootWindow(connection.get()), 0xffffff);
  XClearWindow(connection.get(), DefaultRootWindow(connection.get()));
  XSync(connection.get(), False);
}

}  // namespace display_test
