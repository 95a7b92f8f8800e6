// A real browser for tests: headless Chromium, driven through ChromeDriver's WebDriver protocol.
#pragma once

#include <httplib.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/temporary_folder.h"

namespace console {

// Not thread-safe. A failed call records a test failure and returns an empty value.
class Browser {
 public:
  Browser();
  ~Browser();
  Browser(const Browser&) = delete;
  Browser& operator=(const Browser&) = delete;

  void open(const std::string& url);
  // The value of a JavaScript expression in the page.
  nlohmann::json value_of(const std::string& expression);
  // A real mouse click on the element that the CSS selector names.
  void click(const std::string& selector);
  void type(const std::string& selector, const std::string& text);
  void save_screenshot(const std::filesystem::path& png);
  void resize(int width_px, int height_px);

  // Polls until the expression is true; false at the deadline.
  bool wait_until(const std::string& expression, std::chrono::seconds limit);

 private:
  nlohmann::json call(const std::string& method, const std::string& path,
                      const nlohmann::json& body);
  std::string element(const std::string& selector);

  int driver_pid_ = -1;
  test_support::TemporaryFolder profile_;  // and what the browser else leaves lying
  std::unique_ptr<httplib::Client> driver_;
  std::string session_;  // "/session/ID"
};

}  // namespace console
