// What a request to the daemon says, and why one is refused. Knows no HTTP library, so that
// tests/fuzz runs the same code as the server.
#pragma once

#include <string>
#include <string_view>
#include <tl/expected.hpp>

#include "capture/daemon/command_desk.h"

namespace capture {

// How a request is answered that is not carried out.
struct RequestProblem {
  int status = 400;  // of HTTP
  std::string text;  // one sentence for the operator
};

// Protects against pages of other sites and DNS rebinding: the browser says whom it thinks it talks
// to (`host`) and whose page asks (`origin`; null where the request has no such header).
bool is_own_origin(std::string_view host, const std::string* origin, int port);

// The command of a POST; its request_id is never empty, its directory and resume empty or absolute.
// Errors: 415 unless the body is declared as JSON, 400 for any other body than the object of
// http_server.h.
tl::expected<CaptureRequest, RequestProblem> parse_command(std::string_view content_type,
                                                           std::string_view body);

}  // namespace capture
