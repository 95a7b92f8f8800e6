#include "capture/daemon/http_request.h"

#include <filesystem>
#include <nlohmann/json.hpp>

namespace capture {
namespace {

constexpr std::size_t kTextLimit = 200;   // of a subject or a request id
constexpr std::size_t kPathLimit = 4096;  // of Linux

bool is_own_host(std::string_view host, int port) {
  for (const char* name : {"127.0.0.1", "localhost", "[::1]"})
    if (host == std::string(name) + ":" + std::to_string(port)) return true;
  return false;
}

std::string text_member(const nlohmann::json& body, const char* key) {
  const auto found = body.find(key);
  return found != body.end() && found->is_string() ? found->get<std::string>() : std::string();
}

// Why the member is refused; empty if it is not.
std::string objection_to_member(const std::string& key, const nlohmann::json& value) {
  if (key != "request_id" && key != "subject" && key != "directory" && key != "resume")
    return "unknown key \"" + key + "\"; known are request_id, subject, directory and resume";
  const bool is_path = key == "directory" || key == "resume";
  const std::size_t limit = is_path ? kPathLimit : kTextLimit;
  if (!value.is_string() || value.get_ref<const std::string&>().size() > limit)
    return "\"" + key + "\" must be text of at most " + std::to_string(limit) + " bytes";
  // The system would take a path for one that ends there.
  if (value.get_ref<const std::string&>().find('\0') != std::string::npos)
    return "\"" + key + "\" must not hold a zero byte";
  return {};
}

}  // namespace

bool is_own_origin(std::string_view host, const std::string* origin, int port) {
  if (!is_own_host(host, port)) return false;
  if (origin == nullptr) return true;
  constexpr std::string_view kScheme = "http://";
  return origin->starts_with(kScheme) &&
         is_own_host(std::string_view(*origin).substr(kScheme.size()), port);
}

tl::expected<CaptureRequest, RequestProblem> parse_command(std::string_view content_type,
                                                           std::string_view body) {
  if (!content_type.starts_with("application/json"))
    return tl::unexpected(RequestProblem{415, "send Content-Type: application/json"});
  const auto refuse = [](const std::string& text) {
    return tl::unexpected(RequestProblem{400, text});
  };
  const nlohmann::json json = nlohmann::json::parse(body, nullptr, false);
  if (!json.is_object() || text_member(json, "request_id").empty())
    return refuse("expected a JSON object with a text \"request_id\"");
  for (const auto& [key, value] : json.items())
    if (const std::string objection = objection_to_member(key, value); !objection.empty())
      return refuse(objection);
  CaptureRequest request{.request_id = text_member(json, "request_id"),
                         .subject = text_member(json, "subject"),
                         .directory = text_member(json, "directory"),
                         .resume = text_member(json, "resume")};
  if (!request.directory.empty() && !std::filesystem::path(request.directory).is_absolute())
    return refuse("\"directory\" must be an absolute path");
  if (!request.resume.empty() && !std::filesystem::path(request.resume).is_absolute())
    return refuse("\"resume\" must be an absolute path");
  return request;
}

}  // namespace capture
