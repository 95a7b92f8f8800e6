// The operator's page (page.html), compiled in.
#pragma once

namespace capture {

extern const char* const kPage;

}  // namespace capture
