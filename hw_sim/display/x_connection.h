// A connection to an X server, closed with its owner. Internal to hw_sim/display.
#pragma once

#include <X11/Xlib.h>
#include <X11/extensions/Xrandr.h>

#include <memory>
#include <string>

namespace hw_sim {

struct XDisplayCloser {
  void operator()(Display* display) const { XCloseDisplay(display); }
};
using XConnection = std::unique_ptr<Display, XDisplayCloser>;  // one thread at a time

// Deletes what an XRRGet... call returned.
template <auto kFree>
struct XFree {
  template <typename T>
  void operator()(T* object) const {
    kFree(object);
  }
};
using XrrResources = std::unique_ptr<XRRScreenResources, XFree<XRRFreeScreenResources>>;
using XrrOutputInfo = std::unique_ptr<XRROutputInfo, XFree<XRRFreeOutputInfo>>;
using XrrCrtcInfo = std::unique_ptr<XRRCrtcInfo, XFree<XRRFreeCrtcInfo>>;
using XrrGamma = std::unique_ptr<XRRCrtcGamma, XFree<XRRFreeGamma>>;

struct XOutput {
  RROutput id = None;
  RRCrtc crtc = None;  // None: nothing is shown on it
};

inline XrrResources screen_resources(Display* display) {
  return XrrResources(XRRGetScreenResourcesCurrent(display, DefaultRootWindow(display)));
}

inline XOutput find_output(Display* display, XRRScreenResources* resources,
                           const std::string& name) {
  for (int i = 0; i < resources->noutput; ++i) {
    const XrrOutputInfo info(XRRGetOutputInfo(display, resources, resources->outputs[i]));
    if (info && name == info->name) return {resources->outputs[i], info->crtc};
  }
  return {};
}

}  // namespace hw_sim
