#include "tests/console/browser.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <fstream>
#include <thread>

namespace console {
namespace {

using std::chrono::steady_clock;

int free_port() {
  const int probe = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  EXPECT_EQ(bind(probe, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  socklen_t size = sizeof address;
  getsockname(probe, reinterpret_cast<sockaddr*>(&address), &size);
  close(probe);
  return ntohs(address.sin_port);
}

std::string decode_base64(const std::string& text) {
  std::string bytes;
  unsigned buffer = 0;
  int bit_count = 0;
  for (const char c : text) {
    const char* alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const char* found = std::strchr(alphabet, c);
    if (found == nullptr || c == '\0') continue;
    buffer = buffer << 6 | static_cast<unsigned>(found - alphabet);
    bit_count += 6;
    if (bit_count >= 8) {
      bit_count -= 8;
      bytes.push_back(static_cast<char>(buffer >> bit_count & 0xff));
    }
  }
  return bytes;
}

}  // namespace

Browser::Browser() {
  const std::string port = std::to_string(free_port());
  driver_pid_ = fork();
  if (driver_pid_ == 0) {
    setpgid(0, 0);
    for (const char* name : {"LD_PRELOAD", "UMOCKDEV_DIR"})
      unsetenv(name);  // of a virtual rig around the test
    setenv("TMPDIR", profile_.path().c_str(), 1);
    const std::string argument = "--port=" + port;
    execlp("chromedriver", "chromedriver", argument.c_str(), "--log-level=OFF", nullptr);
    _exit(127);
  }
  driver_ = std::make_unique<httplib::Client>("127.0.0.1", std::stoi(port));
  driver_->set_read_timeout(60);
  const auto deadline = steady_clock::now() + std::chrono::seconds(30);
  while (!driver_->Get("/status") && steady_clock::now() < deadline)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  nlohmann::json arguments = {"--headless",
                              "--disable-gpu",
                              "--disable-quic",
                              "--no-first-run",
                              "--disable-background-networking",
                              "--disable-component-update",
                              "--disable-sync",
                              "--window-size=1200,1400",
                              "--user-data-dir=" + (profile_.path() / "profile").string()};
  if (geteuid() == 0) arguments.push_back("--no-sandbox");  // Chromium refuses its sandbox to root
  const nlohmann::json wish = {
      {"capabilities",
       {{"alwaysMatch",
         {{"browserName", "chrome"}, {"goog:chromeOptions", {{"args", arguments}}}}}}}};
  const nlohmann::json session = call("POST", "/session", wish);
  session_ = "/session/" + session.value("sessionId", "");
}

Browser::~Browser() {
  if (driver_pid_ <= 0) return;
  driver_->Delete(session_);
  kill(-driver_pid_, SIGTERM);
  waitpid(driver_pid_, nullptr, 0);
  kill(-driver_pid_, SIGKILL);  // Chromium may still be writing its profile
}

nlohmann::json Browser::call(const std::string& method, const std::string& path,
                             const nlohmann::json& body) {
  const auto response =
      method == "GET" ? driver_->Get(path) : driver_->Post(path, body.dump(), "application/json");
  if (!response) {
    ADD_FAILURE() << "ChromeDriver does not answer " << path;
    return {};
  }
  const nlohmann::json answer = nlohmann::json::parse(response->body, nullptr, false);
  if (response->status != 200) {
    ADD_FAILURE() << path << ": " << response->body.substr(0, 500);
    return {};
  }
  return answer.value("value", nlohmann::json());
}

void Browser::open(const std::string& url) { call("POST", session_ + "/url", {{"url", url}}); }

nlohmann::json Browser::value_of(const std::string& expression) {
  return call("POST", session_ + "/execute/sync",
              {{"script", "return " + expression + ";"}, {"args", nlohmann::json::array()}});
}

std::string Browser::element(const std::string& selector) {
  const nlohmann::json found =
      call("POST", session_ + "/element", {{"using", "css selector"}, {"value", selector}});
  return found.is_object() && !found.empty() ? found.begin().value().get<std::string>() : "";
}

void Browser::click(const std::string& selector) {
  call("POST", session_ + "/element/" + element(selector) + "/click", nlohmann::json::object());
}

void Browser::type(const std::string& selector, const std::string& text) {
  call("POST", session_ + "/element/" + element(selector) + "/value", {{"text", text}});
}

void Browser::resize(int width_px, int height_px) {
  call("POST", session_ + "/window/rect", {{"width", width_px}, {"height", height_px}});
}

void Browser::save_screenshot(const std::filesystem::path& png) {
  const nlohmann::json picture = call("GET", session_ + "/screenshot", {});
  if (picture.is_string())
    std::ofstream(png, std::ios::binary) << decode_base64(picture.get<std::string>());
}

bool Browser::wait_until(const std::string& expression, std::chrono::seconds limit) {
  const auto deadline = steady_clock::now() + limit;
  while (steady_clock::now() < deadline) {
    if (value_of("Boolean(" + expression + ")") == true) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  return false;
}

}  // namespace console
