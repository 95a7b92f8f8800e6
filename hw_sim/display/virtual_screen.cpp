#include "hw_sim/display/virtual_screen.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iomanip>
#include <sstream>
#include <vector>

#include "hw_sim/display/x_connection.h"

namespace hw_sim {
namespace {

constexpr const char* kServer = "/usr/lib/xorg/Xorg";  // /usr/bin/Xorg insists on a console
constexpr int kOperatorWidth_px = 1920;
constexpr int kOperatorHeight_px = 1080;
constexpr const char* kProjectorMode = "projector";
constexpr const char* kHalfRateMode = "half-rate";
constexpr int kStartLimit_ms = 30'000;  // half a second when idle

// Made up in the manner of reduced blanking; only the rate has to come out right.
std::string modeline(const std::string& name, int width_px, int height_px, double refresh_hz) {
  const int total_width_px = width_px + 160;
  const int total_height_px = height_px + 30;
  std::ostringstream line;
  line << "  Modeline \"" << name << "\" " << std::fixed << std::setprecision(3)
       << refresh_hz * total_width_px * total_height_px / 1e6 << ' ' << width_px << ' '
       << width_px + 48 << ' ' << width_px + 80 << ' ' << total_width_px << ' ' << height_px << ' '
       << height_px + 3 << ' ' << height_px + 8 << ' ' << total_height_px << " +hsync +vsync\n";
  return line.str();
}

std::string configuration(const VirtualScreenSettings& settings) {
  const int width_px = kOperatorWidth_px + settings.projector_width_px;
  const int height_px = std::max(kOperatorHeight_px, settings.projector_height_px);
  const int video_ram_kb = width_px * height_px * 4 / 1024 + 65'536;
  const std::string ranges = "  HorizSync 5.0-1000.0\n  VertRefresh 5.0-500.0\n";
  std::ostringstream text;
  text << "Section \"ServerFlags\"\n"
          "  Option \"AutoAddDevices\" \"false\"\n"
          "  Option \"AutoAddGPU\" \"false\"\n"
          "  Option \"DontVTSwitch\" \"true\"\n"
          "  Option \"BlankTime\" \"0\"\n"
          "EndSection\n"
          "Section \"Monitor\"\n  Identifier \"operator\"\n"
       << ranges << modeline("operator", kOperatorWidth_px, kOperatorHeight_px, 60)
       << "  Option \"PreferredMode\" \"operator\"\n"
          "EndSection\n"
          "Section \"Monitor\"\n  Identifier \"projector\"\n"
       << ranges
       << modeline(kProjectorMode, settings.projector_width_px, settings.projector_height_px,
                   settings.refresh_hz)
       << modeline(kHalfRateMode, settings.projector_width_px, settings.projector_height_px,
                   settings.refresh_hz / 2)
       << "  Option \"Enable\" \"true\"\n"
          "  Option \"RightOf\" \"DUMMY0\"\n"
          "  Option \"PreferredMode\" \"projector\"\n"
          "EndSection\n"
          "Section \"Device\"\n  Identifier \"dummy\"\n  Driver \"dummy\"\n  VideoRam "
       << video_ram_kb
       << "\n  Option \"Monitor-DUMMY0\" \"operator\"\n"
          "  Option \"Monitor-DUMMY1\" \"projector\"\n"
          "EndSection\n"
          "Section \"Screen\"\n  Identifier \"screen\"\n  Device \"dummy\"\n"
          "  Monitor \"operator\"\n  DefaultDepth 24\n"
          "  SubSection \"Display\"\n    Depth 24\n    Modes \"operator\"\n    Virtual "
       << width_px << ' ' << height_px << "\n  EndSubSection\nEndSection\n";
  return text.str();
}

// The server makes this folder itself only as root.
void make_socket_folder() {
  if (mkdir("/tmp/.X11-unix", 01777) == 0) chmod("/tmp/.X11-unix", 01777);
}

// The number of the display, written by the server when clients can connect; empty if it ended or
// was too slow.
std::string read_display_number(int pipe_end, int server_ended) {
  std::string digits;
  const auto deadline = rig::HostClock::now() + std::chrono::milliseconds(kStartLimit_ms);
  while (digits.find('\n') == std::string::npos) {
    std::array<pollfd, 2> sources{{{pipe_end, POLLIN, 0}, {server_ended, POLLIN, 0}}};
    const auto left =
        std::chrono::ceil<std::chrono::milliseconds>(deadline - rig::HostClock::now());
    if (left.count() <= 0) return "";
    if (poll(sources.data(), sources.size(), static_cast<int>(left.count())) < 0 && errno == EINTR)
      continue;
    std::array<char, 16> bytes{};
    const ssize_t count =
        (sources[0].revents & POLLIN) != 0 ? read(pipe_end, bytes.data(), bytes.size()) : 0;
    if (count <= 0) return "";
    digits.append(bytes.data(), static_cast<std::size_t>(count));
  }
  return digits.substr(0, digits.find('\n'));
}

std::string error_lines(const std::filesystem::path& log) {
  std::ifstream file(log);
  std::string lines;
  for (std::string line; std::getline(file, line);)
    if (line.find("(EE)") != std::string::npos) lines += (lines.empty() ? "" : "; ") + line;
  return lines.empty() ? "its log has no errors" : lines;
}

tl::unexpected<rig::Error> refused(const std::string& what) {
  return rig::failure(rig::Fault::kUnsupported, "the virtual screen refused to " + what);
}

XConnection connect(const std::string& display) {
  return XConnection(XOpenDisplay(display.c_str()));
}

RRMode find_mode(const XRRScreenResources& resources, const std::string& name) {
  for (int i = 0; i < resources.nmode; ++i)
    if (name == resources.modes[i].name) return resources.modes[i].id;
  return None;
}

RRCrtc find_free_crtc(Display* display, XRRScreenResources* resources, RROutput output) {
  const XrrOutputInfo info(XRRGetOutputInfo(display, resources, output));
  for (int i = 0; i < info->ncrtc; ++i) {
    const XrrCrtcInfo crtc(XRRGetCrtcInfo(display, resources, info->crtcs[i]));
    if (crtc && crtc->noutput == 0) return info->crtcs[i];
  }
  return None;
}

}  // namespace

rig::Result<std::unique_ptr<VirtualScreen>> VirtualScreen::start(
    const VirtualScreenSettings& settings) {
  std::string folder = (std::filesystem::temp_directory_path() / "ssrig-screen.XXXXXX").string();
  if (mkdtemp(folder.data()) == nullptr)
    return rig::failure(rig::Fault::kNotFound,
                        "cannot make " + folder + ": " + std::strerror(errno));
  std::unique_ptr<VirtualScreen> screen(new VirtualScreen);
  screen->settings_ = settings;
  screen->folder_ = folder;
  std::ofstream(screen->folder_ / "xorg.conf") << configuration(settings);
  make_socket_folder();

  std::array<int, 2> number_pipe{};
  if (pipe2(number_pipe.data(), O_CLOEXEC) != 0)
    return rig::failure(rig::Fault::kNotFound, "no pipe: " + std::string(std::strerror(errno)));
  const std::filesystem::path log = screen->folder_ / "xorg.log";
  rig::Result<ChildProcess> server = ChildProcess::start(
      {.argv = {kServer, "-config", (screen->folder_ / "xorg.conf").string(), "-noreset",
                "-novtswitch", "-sharevts", "-nolisten", "tcp", "-logfile", log.string(),
                "-displayfd", std::to_string(number_pipe[1])},
       .environment = {{"LD_PRELOAD", ""}, {"UMOCKDEV_DIR", ""}},  // the real /sys, no shims
       .output = screen->folder_ / "output",
       .is_own_session = true,
       .inherited_descriptor = number_pipe[1]});
  close(number_pipe[1]);
  std::string number;
  if (server) {
    screen->server_ = std::make_unique<ChildProcess>(std::move(*server));
    number = read_display_number(number_pipe[0], screen->server_->descriptor());
  }
  close(number_pipe[0]);
  if (!server)
    return rig::failure(
        rig::Fault::kNotFound,
        server.error().detail + "; install xserver-xorg-core and xserver-xorg-video-dummy");
  if (number.empty())
    return rig::failure(rig::Fault::kNotFound, "the virtual screen did not start (" +
                                                   error_lines(log) +
                                                   "); is xserver-xorg-video-dummy installed?");
  screen->display_ = ":" + number;
  return screen;
}

VirtualScreen::~VirtualScreen() {
  if (server_) server_->send(SIGCONT);
  server_.reset();
  std::error_code ignored;
  std::filesystem::remove_all(folder_, ignored);
}

rig::Result<void> VirtualScreen::unplug_projector() {
  const XConnection display = connect(display_);
  if (!display) return refused("be talked to");
  const XrrResources resources = screen_resources(display.get());
  const XOutput output = find_output(display.get(), resources.get(), kProjectorOutput);
  if (output.crtc == None) return {};
  if (XRRSetCrtcConfig(display.get(), resources.get(), output.crtc, CurrentTime, 0, 0, None,
                       RR_Rotate_0, nullptr, 0) != RRSetConfigSuccess)
    return refused("unplug the projector");
  return {};
}

rig::Result<void> VirtualScreen::plug_projector_in() {
  const XConnection display = connect(display_);
  if (!display) return refused("be talked to");
  const XrrResources resources = screen_resources(display.get());
  XOutput output = find_output(display.get(), resources.get(), kProjectorOutput);
  if (output.crtc != None) return {};
  const RRCrtc crtc = find_free_crtc(display.get(), resources.get(), output.id);
  const RRMode mode = find_mode(*resources, kProjectorMode);
  if (crtc == None || mode == None ||
      XRRSetCrtcConfig(display.get(), resources.get(), crtc, CurrentTime, kOperatorWidth_px, 0,
                       mode, RR_Rotate_0, &output.id, 1) != RRSetConfigSuccess)
    return refused("plug the projector in");
  return {};
}

rig::Result<void> VirtualScreen::set_projector_gamma(double exponent) {
  const XConnection display = connect(display_);
  if (!display) return refused("be talked to");
  const XrrResources resources = screen_resources(display.get());
  const XOutput output = find_output(display.get(), resources.get(), kProjectorOutput);
  if (output.crtc == None) return refused("set the gamma of an unplugged projector");
  const int size = XRRGetCrtcGammaSize(display.get(), output.crtc);
  const XrrGamma ramp(XRRAllocGamma(size));
  for (int i = 0; i < size; ++i) {
    const double value_frac = std::pow(static_cast<double>(i) / (size - 1), exponent);
    ramp->red[i] = ramp->green[i] = ramp->blue[i] =
        static_cast<unsigned short>(std::lround(65535 * value_frac));
  }
  XRRSetCrtcGamma(display.get(), output.crtc, ramp.get());
  XSync(display.get(), False);
  return {};
}

rig::Result<void> VirtualScreen::set_projector_mode(const std::string& mode_name) {
  const XConnection display = connect(display_);
  if (!display) return refused("be talked to");
  const XrrResources resources = screen_resources(display.get());
  XOutput output = find_output(display.get(), resources.get(), kProjectorOutput);
  const RRMode mode = find_mode(*resources, mode_name);
  if (output.crtc == None || mode == None ||
      XRRSetCrtcConfig(display.get(), resources.get(), output.crtc, CurrentTime, kOperatorWidth_px,
                       0, mode, RR_Rotate_0, &output.id, 1) != RRSetConfigSuccess)
    return refused("set the projector's mode " + mode_name);
  return {};
}

rig::Result<void> VirtualScreen::halve_projector_rate() {
  return set_projector_mode(kHalfRateMode);
}

rig::Result<void> VirtualScreen::restore_projector_rate() {
  return set_projector_mode(kProjectorMode);
}

void VirtualScreen::freeze() { server_->send(SIGSTOP); }

void VirtualScreen::crash() {
  server_->send(SIGKILL);
  server_->wait(rig::HostClock::now() + std::chrono::seconds(5));
}

}  // namespace hw_sim
